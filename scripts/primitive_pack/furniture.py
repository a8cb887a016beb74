"""What stands still on a table: cabinets, the stove, the microwave, the shelf, wine rack and desk caddy; and books."""

import math

from mjcf import GRIPPY, Part, Thing, Vector, turn

BLACK, DARK, GREY, SILVER = (0.05, 0.05, 0.06, 1), (0.14, 0.13, 0.13, 1), (0.45, 0.45, 0.47, 1), (0.75, 0.75, 0.77, 1)
WHITE, PAGES = (0.93, 0.93, 0.92, 1), (0.93, 0.9, 0.82, 1)
LIGHT_WOOD, RED_WOOD, DARK_WOOD = (0.8, 0.64, 0.42, 1), (0.45, 0.17, 0.1, 1), (0.33, 0.2, 0.12, 1)
ON_ITS_SIDE = turn("y", math.pi / 2)
CADDY_STEPS = (
    (-0.0706, 0.0119, 0.0785),
    (-0.035, 0.0785, 0.09),
    (-0.015, 0.09, 0.104),
    (0.005, 0.104, 0.118),
    (0.025, 0.118, 0.132),
    (0.045, 0.132, 0.146),
)
"""Where a step of the caddy's sloping sides begins in x, and its lower and upper end in z."""


def furniture() -> list[Thing]:
    return [
        _cabinet("wooden_cabinet", "Three drawers in dark wood.", (0.24, 0.15, 0.1, 1), (0.3, 0.19, 0.13, 1), SILVER),
        _cabinet("white_cabinet", "Three white drawers.", (0.86, 0.86, 0.84, 1), WHITE, GREY),
        _stove(),
        _microwave(),
        _shelf(),
        _wine_rack(),
        _caddy(),
        _book("black_book", "A black book.", 0.04255, (-0.0148, -0.0673, 0.0022), (0.0139, 0.043, 0.1366), BLACK),
        _book(
            "yellow_book",
            "A yellow book.",
            0.02812,
            (-0.0101, -0.0488, 0.002),
            (0.0134, 0.049, 0.1242),
            (0.9, 0.7, 0.1, 1),
        ),
    ]


def _cabinet(name: str, about: str, rgba: Vector, front: Vector, metal: Vector) -> Thing:
    path = f"articulated_objects/{name}.xml"
    thing = Thing(path, about, mass=0.176, bottom=-0.045, top=0.045, radius=0.045, **GRIPPY)
    base = thing.object.body("base")
    base.block("left", (-0.1174, -0.0792, 0.0084), (-0.107, 0.1117, 0.2201), rgba)
    base.block("right", (0.1138, -0.0792, 0.0084), (0.1242, 0.1117, 0.2201), rgba)
    base.block("back", (-0.1170, 0.1071, 0.0084), (0.1212, 0.1117, 0.2201), rgba)
    base.block("floor", (-0.1188, -0.0733, 0.0047), (0.1268, 0.1060, 0.0089), rgba)
    base.block("top", (-0.1234, -0.0783, 0.2201), (0.1312, 0.1099, 0.223), rgba)
    for number, z in ((1, 0.0793), (2, 0.1494)):
        base.block(f"board_{number}", (-0.1079, -0.0707, z - 0.0008), (0.1155, 0.1080, z + 0.0008), rgba)
    base.site("top_side", "box", (0.12534, 0.09438, 0.00147), (0.00354, 0.01567, 0.22152))
    for level, z, site_z in (("top", 0.18358, 0.18563), ("middle", 0.11387, 0.1169), ("bottom", 0.04525, 0.04701)):
        drawer = base.body(f"cabinet_{level}")
        drawer.inertia(3, 1)
        drawer.joint(f"{level}_level", "slide", (0, 1, 0), (-0.16, 0.01), 50)
        _drawer(drawer, level, z, rgba, front, metal)
        drawer.site(f"{level}_region", "box", (0.02993, 0.07561, 0.10224), (0.00328, 0.01128, site_z), ON_ITS_SIDE)
    return thing


def _drawer(drawer: Part, level: str, z: float, rgba: Vector, front: Vector, metal: Vector) -> None:
    """A tray of boards, closed at the joint's zero; its handle points to -y, the cabinet's front."""
    drawer.block(f"{level}_front", (-0.106, -0.078, z - 0.0348), (0.1127, -0.0725, z + 0.0338), front)
    drawer.block(f"{level}_inner", (-0.1034, -0.0725, z - 0.0321), (0.1101, -0.0648, z + 0.0321), rgba)
    drawer.block(f"{level}_back", (-0.1034, 0.0872, z - 0.0321), (0.1101, 0.0943, z + 0.0321), rgba)
    drawer.block(f"{level}_left", (-0.1043, -0.0704, z - 0.0317), (-0.0995, 0.0925, z + 0.0317), rgba)
    drawer.block(f"{level}_right", (0.1065, -0.0704, z - 0.0314), (0.1113, 0.0925, z + 0.0314), rgba)
    drawer.block(f"{level}_floor", (-0.1035, -0.0705, z - 0.0324), (0.1104, 0.0914, z - 0.0244), rgba)
    drawer.block(f"{level}_handle", (-0.0472, -0.1093, z - 0.0077), (0.0417, -0.0940, z + 0.0077), metal)
    for side, x in (("left", -0.0356), ("right", 0.0292)):
        drawer.block(
            f"{level}_{side}_post", (x - 0.0051, -0.0941, z - 0.0055), (x + 0.0051, -0.0729, z + 0.0055), metal
        )


def _stove() -> Thing:
    path = "articulated_objects/flat_stove.xml"
    about = "A hot plate, and a knob that turns about z; the site `burner` glows while LIBERO takes it to be on."
    thing = Thing(path, about, mass=1.48, bottom=-0.045, top=0.045, radius=0.045)
    base = thing.object.body("base")
    burner = base.body("burner", (0.15, 0, 0))
    burner.block("stand", (-0.095, -0.095, -0.02), (0.095, 0.095, 0.02), SILVER)
    burner.block("plate", (-0.095, -0.095, 0.02), (0.095, 0.095, 0.0255))
    burner.paint((-0.088, -0.088, 0.02), (0.088, 0.088, 0.0205), WHITE)
    burner.site("cook_region", "box", (0.075, 0.075, 0.0025), (0, 0, 0))
    burner.site("burner", "cylinder", (0.0625, 0.0005), (0, 0, 0.022), rgba=(0.9, 0.05, 0.05, 1))
    plate = burner.body("burner_plate")
    plate.can(0.0655, 0.02, 0.021, GREY)
    plate.can(0.012, 0.021, 0.0253, DARK)
    for radius in (0.025, 0.043, 0.061):
        plate.ring(None, 20, (radius, 0.021), (radius, 0.0253), 0.009, DARK)
    knob = base.body("button", quat=turn("z", math.pi / 2))
    knob.inertia(3, 1)
    knob.joint("button", "hinge", (0, 0, 1), (-0.005, 2.1), 1)
    center = (0.0013, 0.0045)
    knob.drum("dial", 12, 0.0452, 0.0004, 0.0128, center)
    knob.can(0.0455, 0.0004, 0.0128, DARK, center)
    knob.block("grip", (-0.0108, -0.033, 0.0014), (0.0135, 0.0519, 0.05), BLACK)
    knob.block("grip_end", (-0.0108, -0.0406, 0.0014), (0.0135, -0.033, 0.0337), BLACK)
    knob.paint((0.0003, 0.03, 0.05), (0.0023, 0.0519, 0.0503), WHITE)
    return thing


def _microwave() -> Thing:
    path = "articulated_objects/microwave.xml"
    about = "A microwave oven; its door turns about z, closed at zero, and opens towards -y."
    thing = Thing(
        path,
        about,
        mass=3,
        bottom=-0.06,
        top=0.06,
        radius=0.015,
        friction="1 0.005 0.0001",
        solimp="0.8 0.9 0.01",
        margin="0.001",
        contype="0",
    )
    oven, shell, inside = thing.object, (0.16, 0.16, 0.17, 1), (0.6, 0.6, 0.62, 1)
    oven.block("left", (-0.1725, -0.0880, 0), (-0.1435, 0.111, 0.187), shell)
    oven.block("right", (0.0635, -0.0880, 0), (0.1725, 0.111, 0.187), shell)
    oven.block("back", (-0.144, 0.0805, 0), (0.063, 0.1105, 0.187), shell)
    oven.block("top", (-0.1435, -0.0880, 0.168), (0.0635, 0.081, 0.187), shell)
    oven.block("bottom", (-0.1435, -0.0880, 0), (0.0635, 0.080, 0.024), shell)
    oven.block("panel", (0.0875, -0.1105, 0), (0.1725, -0.0865, 0.187), shell)
    oven.paint((-0.1435, 0.079, 0.024), (0.0635, 0.0805, 0.168), inside)
    oven.paint((-0.1435, -0.08, 0.024), (-0.1425, 0.08, 0.168), inside)
    oven.paint((0.0625, -0.08, 0.024), (0.0635, 0.08, 0.168), inside)
    oven.paint((-0.1435, -0.08, 0.024), (0.0635, 0.08, 0.0245), inside)
    oven.look("cylinder", (0.065, 0.002), (-0.04, -0.002, 0.027), WHITE)
    oven.paint((0.1, -0.1115, 0.145), (0.16, -0.1105, 0.17), (0.1, 0.55, 0.35, 1))
    for row in range(4):
        for column in range(3):
            x, z = 0.105 + 0.02 * column, 0.06 + 0.02 * row
            oven.paint((x, -0.1115, z), (x + 0.013, -0.1105, z + 0.012), SILVER)
    oven.paint((0.1, -0.1125, 0.015), (0.16, -0.1105, 0.04), GREY)
    oven.site("top_side", "box", (0.12, 0.0835, 0.005), (0, 0.01, 0.2))
    oven.site("heating_region", "box", (0.12, 0.0835, 0.08), (0, 0.01, 0.096))
    door = oven.body("microdoorroot", (-0.1725, -0.088, 0.096))
    door.inertia(0.26, 0.004)
    door.joint("microjoint", "hinge", (0, 0, 1), (-2.094, 0), 0.5)
    door.block("door", (0, -0.025, -0.0925), (0.259, -0.001, 0.0925))
    for low, high in (
        ((0, -0.025, -0.0925), (0.04, -0.001, 0.0925)),
        ((0.215, -0.025, -0.0925), (0.259, -0.001, 0.0925)),
        ((0.04, -0.025, 0.06), (0.215, -0.001, 0.0925)),
        ((0.04, -0.025, -0.0925), (0.215, -0.001, -0.06)),
    ):
        door.paint(low, high, shell)
    door.paint((0.04, -0.016, -0.06), (0.215, -0.01, 0.06), (0.25, 0.3, 0.33, 0.5))
    door.both("handle", "capsule", (0.01, 0.065), (0.2375, -0.054, 0), SILVER)
    for name, z in (("handle_high", 0.065), ("handle_low", -0.065)):
        door.both(name, "capsule", (0.01, 0.015), (0.2375, -0.0375, z), SILVER, turn("x", math.pi / 2))
    return thing


def _shelf() -> Thing:
    name, rgba = "wooden_two_layer_shelf", (0.27, 0.18, 0.13, 1)
    thing = _modelled(name, "An open shelf of two layers; its back is at +y.", 0.20633)
    shelf = thing.object
    shelf.block("left", (-0.1609, -0.0792, 0.0002), (-0.1467, 0.1117, 0.206), rgba)
    shelf.block("right", (0.156, -0.0792, 0.0002), (0.1702, 0.1117, 0.206), rgba)
    shelf.block("back", (-0.1604, 0.1071, 0.0002), (0.1662, 0.1117, 0.206), [0.8 * c for c in rgba[:3]] + [1])
    shelf.block("top", (-0.1706, -0.0787, 0.206), (0.1806, 0.1114, 0.2103), rgba)
    shelf.block("middle", (-0.148, -0.0707, 0.0692), (0.1584, 0.108, 0.0709), rgba)
    shelf.site("top_side", "box", (0.17557, 0.09438, 0.00147), (0.00496, 0.01567, 0.20688))
    quat = turn("y", -math.pi / 2)
    shelf.site("top_region", "box", (0.06739, 0.08564, 0.15093), (0.00538, 0.01687, 0.13672), quat)
    shelf.site("bottom_region", "box", (0.03528, 0.08564, 0.1558), (0.00555, 0.01687, 0.01407), ON_ITS_SIDE)
    return thing


def _wine_rack() -> Thing:
    thing = _modelled("wine_rack", "Two slanted boards with stops, on a leaning post.", 0.15275)
    rack, slope = thing.object, 0.546
    rack.both("high_board", "box", (0.1344, 0.0789, 0.0045), (0, -0.0061, 0.2512), LIGHT_WOOD, turn("x", slope))
    rack.both("low_board", "box", (0.1344, 0.0789, 0.0045), (0, -0.0427, 0.1273), LIGHT_WOOD, turn("x", slope))
    for x in range(-4, 5):
        for y, z in ((-0.0061, 0.2512), (-0.0427, 0.1273)):
            rack.look("box", (0.0012, 0.0792, 0.0048), (0.0294 * x, y, z), RED_WOOD, turn("x", slope))
    rack.both("high_stop", "box", (0.1322, 0.0011, 0.0087), (0, -0.0748, 0.2207), RED_WOOD, turn("x", slope))
    rack.both("low_stop", "box", (0.1322, 0.0011, 0.0087), (0, -0.1091, 0.0974), RED_WOOD, turn("x", slope))
    rack.block("foot", (-0.093, -0.1244, 0), (0.093, 0.1295, 0.0111), RED_WOOD)
    rack.block("ridge", (-0.0905, -0.0141, 0.0111), (0.0905, 0.0141, 0.025), RED_WOOD)
    rack.both("post", "box", (0.0076, 0.009, 0.1616), (0, 0.0089, 0.1703), RED_WOOD, turn("x", -0.2765))
    rack.site("top_region", "box", (0.10087, 0.022, 0.00251), (0, -0.08003, 0.21745), turn("x", -1.0909))
    return thing


def _caddy() -> Thing:
    thing = _modelled("desk_caddy", "A desk caddy of four compartments; its high back is at +x.", 0.27796)
    caddy, rgba, inner = thing.object, DARK_WOOD, (0.4, 0.25, 0.16, 1)
    caddy.block("floor", (-0.0755, -0.2169, 0.0014), (0.0755, 0.2169, 0.0138), rgba)
    caddy.block("back", (0.0628, -0.2098, 0.0053), (0.0708, 0.2098, 0.1683), rgba)
    caddy.block("right", (-0.0706, -0.2156, 0.0026), (0.0706, -0.2032, 0.1674), rgba)
    caddy.block("right_divider", (-0.0706, -0.0742, 0.0026), (0.0706, -0.0618, 0.1674), inner)
    caddy.block("front", (-0.0709, -0.2098, 0.0050), (-0.0628, 0.2098, 0.0741), rgba)
    caddy.block("right_front", (-0.0709, -0.2156, 0.0111), (-0.0628, -0.0618, 0.1643), rgba)
    caddy.block("middle_divider", (-0.0056, -0.0668, 0.0118), (0.0025, 0.0705, 0.0987), inner)
    for name, y, colour in (("left", 0.2086, rgba), ("left_divider", 0.0706, inner)):
        for step, (x, bottom, top) in enumerate(CADDY_STEPS, 1):
            caddy.block(f"{name}_{step}", (x, y - 0.0036, bottom), (0.0668, y + 0.0036, top), colour)
    half, flip = 0.06216, (0, 0, 1, 0)
    caddy.site("right_contain_region", "box", (0.06196, half, 0.06046), (0.00631, -0.14339, 0.06558), flip)
    caddy.site("left_contain_region", "box", (0.06196, half, 0.06046), (0.00631, 0.14551, 0.06558), flip)
    caddy.site("back_contain_region", "box", (0.02775, half, 0.06046), (0.03364, -0.00064, 0.08558), flip)
    root = math.sqrt(0.5)
    caddy.site(
        "front_contain_region", "box", (0.02775, 0.03595, half), (-0.03102, -0.00064, 0.04054), (0, 0, root, -root)
    )
    return thing


def _book(name: str, about: str, mass: float, low: Vector, high: Vector, cover: Vector) -> Thing:
    thing = _modelled(name, f"{about} It stands upright; its spine is at -y.", mass)
    book, thick, inset = thing.object, 0.002, 0.003
    book.block("book", low, high)
    (x0, y0, z0), (x1, y1, z1) = low, high
    book.paint((x0, y0, z0), (x0 + thick, y1, z1), cover)
    book.paint((x1 - thick, y0, z0), (x1, y1, z1), cover)
    book.paint((x0, y0, z0), (x1, y0 + thick, z1), cover)
    book.paint((x0 + thick, y0 + thick, z0 + inset), (x1 - thick, y1 - inset, z1 - inset), PAGES)
    book.paint((x0 + 0.006, y0 - 2e-4, z1 - 0.05), (x1 - 0.006, y0, z1 - 0.02), PAGES)
    book.paint((x1, y0 + 0.02, z1 - 0.05), (x1 + 2e-4, y1 - 0.02, z1 - 0.03), PAGES)
    book.paint((x0 - 2e-4, y0 + 0.02, z1 - 0.05), (x0, y1 - 0.02, z1 - 0.03), PAGES)
    return thing


def _modelled(name: str, about: str, mass: float) -> Thing:
    path = f"turbosquid_objects/{name}/{name}.xml"
    return Thing(path, about, mass=mass, bottom=-0.06, top=0.04, radius=0.025)
