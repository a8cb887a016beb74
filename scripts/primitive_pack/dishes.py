"""Bowls, mugs, the plate, the frying pan, the basket, the tray and the wine bottle."""

import math

from mjcf import Part, Thing, Vector, turn

BLACK, GREY, WHITE = (0.07, 0.07, 0.08, 1), (0.3, 0.3, 0.32, 1), (0.93, 0.93, 0.92, 1)
YELLOW, WOOD, DARK_WOOD = (0.92, 0.75, 0.15, 1), (0.72, 0.55, 0.32, 1), (0.55, 0.4, 0.22, 1)


def dishes() -> list[Thing]:
    return [
        _black_bowl(),
        _white_bowl(),
        _plate(),
        _frying_pan(),
        _basket(),
        _tray(),
        _yellow_mug(),
        _white_mug(),
        _wine(),
    ]


def _scanned(name: str, about: str, mass: float) -> Thing:
    path = f"stable_scanned_objects/{name}/{name}.xml"
    return Thing(path, about, mass=mass, bottom=-0.06, top=0.04, radius=0.025)


def _modelled(name: str, about: str, mass: float) -> Thing:
    path = f"turbosquid_objects/{name}/{name}.xml"
    return Thing(path, about, mass=mass, bottom=-0.06, top=0.04, radius=0.025)


def _floor(part: Part, radius: float, bottom: float, top: float, rgba: Vector, center: Vector = (0, 0)) -> None:
    part.drum("floor", 12, radius, bottom, top, center)
    part.can(radius, bottom, top, rgba, center)


def _black_bowl() -> Thing:
    thing = _scanned("akita_black_bowl", "A black bowl: a floor and two rings of boards that lean outwards.", 0.00559)
    _floor(thing.object, 0.0236, 0.0016, 0.0067, BLACK)
    thing.object.ring("low", 16, (0.0233, 0.0039), (0.0439, 0.0158), 0.0016, BLACK)
    thing.object.ring("high", 16, (0.0424, 0.0155), (0.0519, 0.0518), 0.0026, BLACK)
    return thing


def _white_bowl() -> Thing:
    thing = _scanned("white_bowl", "A small white bowl, built like the black one.", 0.00209)
    _floor(thing.object, 0.0172, 0.0006, 0.0042, WHITE)
    thing.object.ring("low", 16, (0.0166, 0.0028), (0.0313, 0.0113), 0.0014, WHITE)
    thing.object.ring("high", 16, (0.0321, 0.0105), (0.0393, 0.0348), 0.002, WHITE)
    return thing


def _plate() -> Thing:
    thing = _scanned("plate", "A white plate: a foot and a flat ring that rises outwards.", 0.01152)
    _floor(thing.object, 0.034, -0.0025, 0.0052, WHITE)
    thing.object.ring("rim", 16, (0.0305, 0.0015), (0.0664, 0.0139), 0.0046, WHITE)
    thing.object.can(0.03, 0.0052, 0.0055, (0.8, 0.84, 0.9, 1))
    return thing


def _frying_pan() -> Thing:
    thing = _scanned("chefmate_8_frypan", "A frying pan with its handle along x.", 0.05025)
    pan, center = thing.object, (0.0072, 0.0)
    _floor(pan, 0.0755, 0.0008, 0.0125, GREY, center)
    pan.ring("wall", 16, (0.0788, 0.0041), (0.0997, 0.0405), 0.0071, BLACK, center)
    pan.bar("bracket", (0.102, 0, 0.022), (0.133, 0, 0.036), 0.0104, 0.006, BLACK)
    pan.bar("handle", (0.1267, 0, 0.0355), (0.2586, 0, 0.0527), 0.0127, 0.0062, BLACK)
    return thing


def _basket() -> Thing:
    thing = _scanned("basket", "A square basket: a floor and four boards that lean outwards.", 0.13611)
    basket = thing.object
    basket.block("floor", (-0.074, -0.0724, 0.0046), (0.079, 0.0724, 0.0216), DARK_WOOD)
    for name, turned, reach, height, lean in (
        ("back", math.pi, 0.0727, 0.0764, 0.0756),
        ("front", 0.0, 0.0756, 0.0764, 0.05),
    ):
        x = reach * math.cos(turned)
        quat = turn("y", lean * math.cos(turned))
        basket.both(name, "box", (0.0067, 0.0724, 0.0637), (x, 0, height), WOOD, quat)
        for z in (0.05, 0.085, 0.12):
            slope = math.tan(lean) * math.cos(turned)
            basket.look("box", (0.0071, 0.073, 0.004), (x + slope * (z - height), 0, z), DARK_WOOD, quat)
    for name, side in (("left", 1), ("right", -1)):
        quat = turn("x", -side * 0.045)
        basket.both(name, "box", (0.0724, 0.0067, 0.0637), (0.001, side * 0.0688, 0.0817), WOOD, quat)
        for z in (0.05, 0.085, 0.12):
            y = side * (0.0688 + 0.045 * (z - 0.0817))
            basket.look("box", (0.073, 0.0071, 0.004), (0.001, y, z), DARK_WOOD, quat)
    basket.site("contain_region", "box", (0.06108, 0.06108, 0.06949), (0, 0, 0.07185), (0, 0, 0, 1))
    return thing


def _tray() -> Thing:
    thing = _modelled("wooden_tray", "A long tray with a rail on posts at either end.", 0.05715)
    tray = thing.object
    tray.block("floor", (-0.1365, -0.0851, -0.0008), (0.1525, 0.0747, 0.0071), WOOD)
    tray.block("back", (-0.1416, -0.0833, 0.0053), (-0.1369, 0.0724, 0.0545), DARK_WOOD)
    tray.block("front", (0.1509, -0.0833, 0.0053), (0.1555, 0.0724, 0.0545), DARK_WOOD)
    tray.block("right", (-0.1362, -0.0868, 0.0038), (0.1518, -0.0822, 0.0626), WOOD)
    tray.block("left", (-0.1362, 0.0735, 0.0028), (0.1518, 0.0781, 0.0596), WOOD)
    for end, x, rail in (("back", -0.1321, -0.1335), ("front", 0.1453, 0.1471)):
        for side, y in (("right", -0.0785), ("left", 0.0685)):
            tray.block(
                f"{end}_{side}_post", (x - 0.0055, y - 0.0062, 0.0017), (x + 0.0055, y + 0.0062, 0.08), DARK_WOOD
            )
        tray.block(f"{end}_rail", (rail - 0.0067, -0.0835, 0.0785), (rail + 0.0067, 0.0737, 0.0809), DARK_WOOD)
    quat = turn("y", math.pi / 2)
    tray.site("contain_region", "box", (0.04038, 0.07839, 0.13549), (0.00863, -0.00471, 0.04255), quat)
    return thing


def _yellow_mug() -> Thing:
    thing = _modelled("white_yellow_mug", "A yellow mug with a white foot, its handle along x.", 0.03091)
    mug, center = thing.object, (-0.0185, 0.0)
    _floor(mug, 0.026, 0.0001, 0.0052, WHITE, center)
    mug.ring("foot", 12, (0.0273, 0.0023), (0.0373, 0.0189), 0.0078, WHITE, center)
    mug.ring("wall", 20, (0.0371, 0.0161), (0.0485, 0.1026), 0.0082, YELLOW, center)
    mug.bar("handle_low", (0.0158, 0, 0.0214), (0.0646, 0, 0.0312), 0.0088, 0.0041, YELLOW)
    mug.block("handle", (0.06, -0.0088, 0.0267), (0.0682, 0.0088, 0.0852), YELLOW)
    mug.bar("handle_high", (0.0248, 0, 0.082), (0.068, 0, 0.0773), 0.0088, 0.0041, YELLOW)
    return thing


def _white_mug() -> Thing:
    thing = _modelled("porcelain_mug", "A white mug, its handle along -x.", 0.01646)
    mug, center = thing.object, (0.0158, -0.001)
    _floor(mug, 0.025, 0.0024, 0.0128, WHITE, center)
    mug.ring("foot", 12, (0.0265, 0.0066), (0.0434, 0.0412), 0.003, WHITE, center)
    mug.ring("wall", 12, (0.0434, 0.0412), (0.0436, 0.1085), 0.0048, WHITE, center)
    mug.bar("handle_low", (-0.0589, 0, 0.0381), (-0.0243, 0, 0.0191), 0.008, 0.0038, WHITE)
    mug.block("handle", (-0.0633, -0.008, 0.0363), (-0.0558, 0.008, 0.0758), WHITE)
    mug.bar("handle_high", (-0.0625, 0, 0.0722), (-0.0301, 0, 0.0946), 0.008, 0.0038, WHITE)
    return thing


def _wine() -> Thing:
    glass, label, cap = (0.05, 0.13, 0.06, 1), (0.9, 0.86, 0.74, 1), (0.5, 0.06, 0.08, 1)
    thing = _modelled("wine_bottle", "An upright bottle of wine.", 0.01539)
    bottle = thing.object
    bottle.drum("belly", 12, 0.0205, 0.0011, 0.0734)
    bottle.drum("shoulder", 8, 0.0125, 0.0734, 0.0881)
    bottle.drum("throat", 8, 0.0085, 0.0881, 0.1001)
    bottle.drum("neck", 8, 0.0072, 0.1001, 0.158)
    bottle.can(0.0208, 0.0011, 0.0734, glass)
    bottle.can(0.0211, 0.012, 0.055, label)
    bottle.can(0.0212, 0.03, 0.036, cap)
    for radius, low, high in ((0.0185, 0.0734, 0.079), (0.0145, 0.079, 0.0855), (0.0105, 0.0855, 0.094)):
        bottle.can(radius, low, high, glass)
    bottle.can(0.0074, 0.094, 0.134, glass)
    bottle.can(0.0078, 0.134, 0.158, cap)
    return thing
