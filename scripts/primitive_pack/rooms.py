"""The rooms: floor, walls, lights and cameras, the table of each, and a little to look at behind the robot."""

import math
import xml.etree.ElementTree as ET

from mjcf import GRIPPY, Model, Part, Vector, times, turn

WOOD, PALE_WOOD, DARK_WOOD, METAL = (
    (0.55, 0.35, 0.18, 1),
    (0.82, 0.72, 0.6, 1),
    (0.3, 0.17, 0.12, 1),
    (0.6, 0.6, 0.62, 1),
)
WHITE, LEAF, CLAY = (0.9, 0.9, 0.88, 1), (0.2, 0.42, 0.15, 1), (0.6, 0.33, 0.22, 1)
FLOOR, WALLS = "floorplane", "walls_mat"
UPRIGHT = turn("x", math.pi / 2)


def rooms() -> list[Model]:
    return [_floor(), _tabletop(), _kitchen(), _living_room(), _study()]


def _floor() -> Model:
    room = _room("libero_floor_base_style", "A floor to work on.", "light-gray-floor-tile", "light-gray-plaster")
    room.world.body("floor").plane("floor", FLOOR)
    return room


def _tabletop() -> Model:
    room = _room("libero_tabletop_base_style", "A table of LIBERO-Goal.", "light-gray-floor-tile", "light-gray-plaster")
    room.world.plane("floor", FLOOR)
    _table(room.world)
    return room


def _kitchen() -> Model:
    room = _room("libero_kitchen_tabletop_base_style", "A kitchen.", "gray_ceramic_tile", "yellow_linen_wall_texture")
    room.world.plane("floor", FLOOR)
    _table(room.world)
    world = room.world
    world.paint((-2, -1.6, 0), (-1.5, 2.6, 0.86), WHITE)
    world.paint((-2, -1.6, 0.86), (-1.47, 2.6, 0.9), DARK_WOOD)
    for y in (-1.05, -0.5, 0.05, 0.6, 1.15, 1.7, 2.25):
        world.paint((-1.5, y - 0.005, 0.05), (-1.495, y + 0.005, 0.84), METAL)
    world.paint((-2, -2.8, 0), (-1.4, -1.7, 1.75), METAL)
    world.can(0.12, 0.9, 1.06, METAL, (-1.7, 0.75))
    return room


def _living_room() -> Model:
    name = "libero_living_room_tabletop_base_style"
    room = _room(name, "A living room.", "seamless_wood_planks_floor", "light-gray-plaster", **GRIPPY)
    room.world.body("floor").plane("floor", FLOOR)
    table = room.world.body("living_room_table")
    table.block("top", (-0.694, -0.619, 0.4131), (0.194, 0.724, 0.4368), DARK_WOOD)
    table.block("top_back", (-0.825, -0.362, 0.4131), (-0.694, 0.473, 0.4368), DARK_WOOD)
    table.block("top_front", (0.194, -0.362, 0.4131), (0.339, 0.473, 0.4368), DARK_WOOD)
    table.block("top_right", (-0.667, -0.821, 0.4131), (0.167, -0.619, 0.4368), DARK_WOOD)
    table.block("top_left", (-0.667, 0.724, 0.4131), (0.167, 0.901, 0.4368), DARK_WOOD)
    table.block("foot", (-0.662, -0.185, 0), (0.162, 0.685, 0.413), WOOD)
    world = room.world
    world.paint((-1.95, 0.15, 0.96), (-1.94, 1.01, 1.96), (0.2, 0.3, 0.4, 1))
    world.paint((-1.94, 0.25, 1.06), (-1.938, 0.91, 1.86), (0.85, 0.6, 0.3, 1))
    world.paint((-2, -1.4, 0), (-1.6, -0.2, 0.5), WOOD)
    world.paint((-1.9, -1.2, 0.5), (-1.85, -0.4, 1.05), (0.05, 0.05, 0.06, 1))
    return room


def _study() -> Model:
    room = _room("libero_study_base_style", "A study.", "light-gray-floor-tile", "light-gray-plaster", **GRIPPY)
    room.world.plane("floor", FLOOR)
    desk = room.world.body("study_table")
    desk.block("top", (-0.6894, -1.3927, 0.8135), (0.6894, 1.3927, 0.8851), WOOD)
    for end, y in (("right", -0.69), ("left", 0.7122)):
        desk.block(f"{end}_back_leg", (-0.5205, y - 0.05, 0.0003), (-0.4805, y + 0.05, 0.7884), DARK_WOOD)
        desk.block(f"{end}_front_leg", (0.4762, y - 0.05, 0.0003), (0.5162, y + 0.05, 0.7884), DARK_WOOD)
        desk.block(f"{end}_foot", (-0.5175, y - 0.05, 0.0053), (0.5077, y + 0.05, 0.0453), DARK_WOOD)
        desk.paint((-0.52, y - 0.05, 0.788), (0.516, y + 0.05, 0.8135), DARK_WOOD)
    _bookcase(room.world)
    _plant(room.world, (-1.85, 0.55))
    room.world.paint((-1.99, 0.0, 1.3), (-1.97, 0.9, 1.95), DARK_WOOD)
    room.world.paint((-1.97, 0.05, 1.35), (-1.965, 0.85, 1.9), (0.75, 0.8, 0.85, 1))
    return room


def _bookcase(world: Part) -> None:
    low, high = (-1.87, -1.6), (-1.56, -0.4)
    world.paint((low[0], low[1], 0), (low[0] + 0.01, high[1], 1.8), WHITE)
    for y in (low[1], high[1] - 0.03):
        world.paint((low[0], y, 0), (high[0], y + 0.03, 1.8), WHITE)
    colours = ((0.5, 0.1, 0.1, 1), (0.1, 0.2, 0.45, 1), (0.8, 0.65, 0.2, 1), (0.15, 0.35, 0.2, 1), (0.1, 0.1, 0.1, 1))
    for shelf, z in enumerate((0.05, 0.48, 0.91, 1.34, 1.77)):
        world.paint((low[0], low[1], z), (high[0], high[1], z + 0.03), WHITE)
        for book in range(9 if z < 1.7 else 0):
            y, height = low[1] + 0.1 + 0.1 * book + 0.05 * (shelf % 2), 0.22 + 0.03 * ((book * 3 + shelf) % 4)
            colour = colours[(book * 2 + shelf) % len(colours)]
            world.paint((low[0] + 0.08, y, z + 0.03), (high[0] - 0.03, y + 0.045, z + 0.03 + height), colour)


def _plant(world: Part, place: Vector) -> None:
    world.can(0.16, 0, 0.35, CLAY, place)
    for leaf in range(12):
        angle, lean = 2.4 * leaf, 0.25 + 0.05 * (leaf % 5)
        quat = times(turn("z", angle), turn("y", lean))
        reach, height = 0.35 * math.sin(lean), 0.35 + 0.35 * math.cos(lean)
        pos = (place[0] + reach * math.cos(angle), place[1] + reach * math.sin(angle), height)
        world.look("ellipsoid", (0.012, 0.05, 0.38), pos, LEAF, quat)


def _table(world: Part) -> None:
    """LIBERO sets sizes and places of these by name, so the numbers here only serve a viewer that opens this file."""
    table = world.body("table", (0, 0, 0.875))
    table.solid("table_collision", "box", (0.5, 0.6, 0.025), (0, 0, 0))
    table.look("box", (0.5, 0.6, 0.025), (0, 0, 0), PALE_WOOD, name="table_visual")
    table.site("table_top", "sphere", (0.001,), (0, 0, 0.025))
    for number, (x, y) in enumerate(((0.4, 0.5), (-0.4, 0.5), (-0.4, -0.5), (0.4, -0.5)), 1):
        table.look("cylinder", (0.025, 0.4375), (x, y, -0.4375), METAL, name=f"table_leg{number}_visual")


def _room(name: str, about: str, floor: str, wall: str, **solid: str) -> Model:
    """Four walls, the two textures whose files LIBERO replaces by name, two lights and the cameras that it asks for."""
    room = Model(f"scenes/{name}.xml", about, **solid)
    assets = ET.Element("asset")
    room.root.insert(2, assets)
    ET.SubElement(
        assets,
        "texture",
        type="skybox",
        builtin="gradient",
        rgb1="0.9 0.9 1",
        rgb2="0.2 0.3 0.4",
        width="64",
        height="384",
    )
    for texture, file, material in (("texplane", floor, FLOOR), ("tex-wall", wall, WALLS)):
        ET.SubElement(assets, "texture", name=texture, type="2d", file=f"../textures/{file}.png")
        ET.SubElement(
            assets, "material", name=material, texture=texture, texrepeat="3 3", texuniform="true", specular="0.1"
        )
    for side, size, pos, quat in (
        ("rear", (3, 1.5, 0.01), (-2, 0, 1.5), times(turn("z", math.pi / 2), UPRIGHT)),
        ("front", (3, 1.5, 0.01), (3, 0, 1.5), times(turn("z", -math.pi / 2), UPRIGHT)),
        ("left", (2.5, 1.5, 0.01), (0.5, 3, 1.5), UPRIGHT),
        ("right", (2.5, 1.5, 0.01), (0.5, -3, 1.5), turn("x", -math.pi / 2)),
    ):
        room.world.look("box", size, pos, None, quat, name=f"wall_{side}_visual", material=WALLS)
    world = room.world.element
    for number, pos in ((1, "1 1 4"), (2, "-3 -3 4")):
        ET.SubElement(
            world,
            "light",
            name=f"light{number}",
            pos=pos,
            dir="0 -0.15 -1",
            directional="false",
            castshadow="false",
            diffuse="0.8 0.8 0.8",
            specular="0.3 0.3 0.3",
        )
    for camera, pos, quat in (
        ("frontview", "1 0 1.45", "0.56 0.43 0.43 0.56"),
        ("birdview", "-0.2 0 3", "0.7071 0 0 0.7071"),
        ("agentview", "0.5 0 1.35", "0.653 0.271 0.271 0.653"),
        ("sideview", "-0.05 1.28 1.49", "0.0099 0.0069 0.5912 0.8064"),
    ):
        ET.SubElement(world, "camera", name=camera, mode="fixed", pos=pos, quat=quat)
    return room
