"""Groceries: bottles, cans and cartons stored lying on their backs, and flat packets."""

from mjcf import Part, Thing, Vector, turn

RED, DARK_RED, BROWN, DARK_BROWN = (
    (0.75, 0.07, 0.05, 1),
    (0.45, 0.05, 0.03, 1),
    (0.42, 0.2, 0.09, 1),
    (0.2, 0.09, 0.04, 1),
)
WHITE, CREAM, SILVER, YELLOW = (0.95, 0.95, 0.93, 1), (0.93, 0.87, 0.7, 1), (0.75, 0.75, 0.77, 1), (0.95, 0.75, 0.12, 1)
BLUE, GREEN, DARK_GREEN, ORANGE = (0.13, 0.3, 0.65, 1), (0.15, 0.5, 0.18, 1), (0.1, 0.25, 0.1, 1), (0.95, 0.5, 0.07, 1)


def groceries() -> list[Thing]:
    return [
        _can("alphabet_soup", "A blue can of soup.", 0.02585, (BLUE, YELLOW, SILVER), -0.04, 0.04, 0.0036),
        _can("tomato_sauce", "A red can of tomato sauce.", 0.02663, (RED, GREEN, SILVER), -0.06, 0.04, 0.0033),
        _packet("butter", "A packet of butter.", 0.00525, (0.0381, 0.0198, 0.0087), (ORANGE, YELLOW), 0.02, 0.02),
        _packet(
            "cream_cheese", "A packet of cream cheese.", 0.00619, (0.0406, 0.0213, 0.0089), (BLUE, WHITE), 0.025, 0.03
        ),
        _pudding(),
        _ketchup(),
        _bbq_sauce(),
        _salad_dressing(),
        _carton("milk", "A red and white carton of milk.", (WHITE, RED)),
        _carton("orange_juice", "An orange carton of juice.", (ORANGE, GREEN)),
    ]


def _grocery(name: str, about: str, mass: float, bottom: float, top: float, radius: float) -> Thing:
    path = f"stable_hope_objects/{name}/{name}.xml"
    return Thing(path, about, mass=mass, bottom=bottom, top=top, radius=radius)


def _can(
    name: str, about: str, mass: float, colours: tuple[Vector, Vector, Vector], bottom: float, top: float, aside: float
) -> Thing:
    label, band, metal = colours
    thing = _grocery(name, about, mass, bottom, top, 0.025)
    can = thing.object.lying()
    can.drum("wall", 12, 0.031, -0.0384, 0.0372, (0, aside))
    can.can(0.0312, -0.0384, 0.0372, metal, (0, aside))
    can.can(0.0316, -0.035, 0.0337, label, (0, aside))
    can.can(0.0318, -0.012, 0.01, band, (0, aside))
    can.can(0.0285, 0.0365, 0.0374, [0.85 * c for c in metal[:3]] + [1], (0, aside))
    return thing


def _packet(
    name: str, about: str, mass: float, size: Vector, colours: tuple[Vector, Vector], end: float, radius: float
) -> Thing:
    x, y, z = size
    thing = _grocery(name, about, mass, -end, end, radius)
    thing.object.block("box", (-x, -y, -z), (x, y, z), colours[0])
    thing.object.paint((-0.45 * x, -y - 2e-4, -z - 2e-4), (0.45 * x, y + 2e-4, z + 2e-4), colours[1])
    return thing


def _pudding() -> Thing:
    thing = _grocery("chocolate_pudding", "A box of chocolate pudding.", 0.01019, -0.06, 0.04, 0.025)
    box = thing.object
    box.block("box", (-0.0406, -0.0232, -0.0131), (0.0396, 0.0232, 0.0143), BROWN)
    box.paint((-0.0408, -0.0234, -0.004), (0.0398, 0.0234, 0.005), DARK_BROWN)
    box.paint((-0.012, -0.012, 0.014), (0.012, 0.012, 0.0146), CREAM)
    return thing


def _ketchup() -> Thing:
    thing = _grocery("ketchup", "A red squeeze bottle.", 0.02322, -0.06, 0.04, 0.025)
    bottle = thing.object.lying()
    bottle.block("belly", (-0.0281, -0.0172, -0.0724), (0.0281, 0.0172, -0.0063))
    bottle.block("shoulder", (-0.0239, -0.0183, -0.0076), (0.0239, 0.0183, 0.015))
    bottle.block("neck", (-0.0187, -0.0183, 0.0139), (0.0187, 0.0183, 0.0364))
    bottle.drum("cap", 8, 0.0172, 0.0362, 0.0732)
    bottle.oval(0.0281, 0.0172, -0.0724, -0.0063, RED)
    bottle.oval(0.0284, 0.0175, -0.055, -0.022, WHITE)
    bottle.oval(0.0286, 0.0177, -0.044, -0.033, RED)
    bottle.oval(0.0239, 0.0183, -0.0063, 0.015, RED)
    bottle.oval(0.0205, 0.0183, 0.015, 0.026, RED)
    bottle.can(0.0183, 0.026, 0.0364, RED)
    _cap(bottle, 0.0172, 0.0364, 0.0732, WHITE)
    return thing


def _bbq_sauce() -> Thing:
    thing = _grocery("bbq_sauce", "A small brown bottle.", 0.01218, -0.06, 0.06, 0.015)
    bottle = thing.object
    bottle.block("belly", (-0.0235, -0.0145, -0.0546), (0.0235, 0.0145, -0.001))
    bottle.block("shoulder", (-0.0181, -0.0143, -0.0023), (0.0181, 0.0143, 0.0269))
    bottle.drum("cap", 8, 0.013, 0.0257, 0.0525)
    bottle.oval(0.0235, 0.0145, -0.0546, -0.001, DARK_RED)
    bottle.oval(0.0237, 0.0147, -0.042, -0.012, YELLOW)
    bottle.oval(0.0238, 0.0148, -0.034, -0.02, BROWN)
    bottle.oval(0.0181, 0.0143, -0.001, 0.014, DARK_RED)
    bottle.can(0.0143, 0.014, 0.0269, DARK_RED)
    _cap(bottle, 0.013, 0.0269, 0.0525, ORANGE)
    return thing


def _salad_dressing() -> Thing:
    thing = _grocery("salad_dressing", "A dark green bottle, wide in the middle.", 0.02178, -0.06, 0.04, 0.025)
    bottle = thing.object.lying()
    for name, half_x, bottom, top, colour in (
        ("foot", 0.0178, -0.0727, -0.0628, DARK_GREEN),
        ("low", 0.0222, -0.0628, -0.052, DARK_GREEN),
        ("belly", 0.0262, -0.052, -0.0104, CREAM),
        ("high", 0.0229, -0.0104, 0.0013, DARK_GREEN),
        ("shoulder", 0.0175, 0.0013, 0.0128, DARK_GREEN),
    ):
        bottle.block(name, (-half_x, -0.0173, bottom), (half_x, 0.0173, top))
        bottle.oval(half_x, 0.0173, bottom, top, colour)
    bottle.oval(0.0264, 0.0175, -0.038, -0.024, GREEN)
    bottle.block("neck", (-0.0132, -0.0149, 0.0128), (0.0132, 0.0149, 0.0358))
    bottle.can(0.0149, 0.0128, 0.0358, DARK_GREEN)
    bottle.drum("cap", 8, 0.0162, 0.0356, 0.0728)
    bottle.can(0.0162, 0.0356, 0.0728, GREEN)
    return thing


def _carton(name: str, about: str, colours: tuple[Vector, Vector]) -> Thing:
    paper, ink = colours
    thing = _grocery(name, about, 0.03167, -0.06, 0.04, 0.03 if name == "milk" else 0.025)
    carton = thing.object.lying()
    carton.block("box", (-0.0263, -0.0263, -0.0698), (0.0263, 0.0263, 0.0398), paper)
    carton.paint((-0.0265, -0.0265, -0.055), (0.0265, 0.0265, -0.01), ink)
    carton.paint((-0.015, -0.0267, -0.045), (0.015, 0.0267, -0.02), paper)
    carton.paint((-0.0267, -0.015, -0.045), (0.0267, 0.015, -0.02), paper)
    for number, half_y, bottom, top in (
        (1, 0.021, 0.0398, 0.0455),
        (2, 0.0125, 0.0455, 0.0512),
        (3, 0.006, 0.0512, 0.056),
    ):
        carton.block(f"roof_{number}", (-0.0261, -half_y, bottom), (0.0261, half_y, top), paper)
    for side in (-1, 1):
        carton.look("box", (0.0263, 0.0152, 0.0012), (0, side * 0.0145, 0.048), ink, turn("x", -side * 0.67))
    carton.block("crest", (-0.0265, -0.003, 0.055), (0.0265, 0.003, 0.0614), paper)
    return thing


def _cap(bottle: Part, radius: float, bottom: float, top: float, rgba: Vector) -> None:
    """A cap that narrows to a nozzle; its round lower half is hidden in the bottle."""
    bottle.look("ellipsoid", (radius, radius, 0.95 * (top - bottom)), (0, 0, bottom), rgba)
    bottle.can(0.25 * radius, (bottom + top) / 2, top, rgba)
