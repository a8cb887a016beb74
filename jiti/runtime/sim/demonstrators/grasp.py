"""Where to take a thing from above: across its thinner side, or by its rim, with room for the hand beside it."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np

from jiti.runtime.sim.world import World
from jiti.tasks.rotation import hand_down

PALM_M, TIP_M = 0.031, 0.009
"""How far the palm lies over the point between the fingertips, and the tips below it. These are the collision shapes
of the Panda's hand in robosuite 1.4.0, and so are the two below."""
HAND_M = (0.032, 0.104)
"""Half of what the hand takes up across the line between the fingers and along it."""
PARTS_M = ((-TIP_M, 0.011, 0.066), (PALM_M, 0.021, 0.101), (0.076, *HAND_M))
"""The same of the open fingers, the palm and the back of the hand, after the height at which each begins over the point
between the fingertips."""
HEIGHT_M = 0.123
"""Where the hand ends over the point between the fingertips."""
OPENING_M = 0.072
"""The widest that is taken between the fingers, which open 0.076 m. Our choice: 2 mm to spare on either side."""
ACROSS_BELOW_M, RIM_BELOW_M = (0.012, 0.016), (0.002, 0.005)
"""How far under the top of a thing the point between the fingertips comes, for either way to take it. The pads reach
0.004 m lower and 0.012 m higher. A bowl's wall slants, and pads that grip it lower creep down along it."""
FLOOR_M = 0.003
"""What the tips keep clear of what a thing stands on. Our choice, for the arm's noise."""
ROOM_M = 0.012
"""Room beside the hand beyond which more is not better. Our choice: more than the arm ever strays."""
ASIDE = (0.0, -0.5, 0.5, -1.0, 1.0)
"""Where along a thing it may be taken: shares of the way from its middle to where the fingers still grip in full."""
SKEWS_RAD = (0.0, -0.15, 0.15, -0.3, 0.3)
"""How far the fingers may stand from square to its sides, which they straighten as they close. Our choice: up to 17
degrees; more would need more of their opening."""


_GRID = np.array(np.meshgrid(np.linspace(-1, 1, 5), np.linspace(-1, 1, 11))).reshape(2, -1).T


@dataclass(frozen=True, slots=True)
class Grasp:
    """A pose of the hand around a thing, and how good it is."""

    place: np.ndarray
    """(3,) m: the point between the fingertips."""
    yaw_rad: float
    width_m: float
    """Of what is between the fingers."""
    aside_m: float = 0.0
    """From the middle of the thing."""
    skew_rad: float = 0.0
    """From square to its sides."""


def choose_grasp(world: World, thing: str, target: str, *, depth: float, hand_yaw_rad: float) -> Grasp:
    """The best of several ways to take a thing that stands or lies, and to put it onto a target as it is held then.

    `depth` is the share, 0 to 1, of the range of heights at which it may be taken.
    """
    others = [n for n in (*world.names.objects, *world.names.fixtures) if n not in (thing, target)]
    obstacles = [world.bounds(name) for name in others]
    candidates, (least, most) = list(_across(world, thing)), ACROSS_BELOW_M
    if not candidates:
        candidates, (least, most) = list(_rim(world, thing)), RIM_BELOW_M
    below_top_m = least + depth * (most - least)
    height = max(world.bounds(thing)[1][2] - below_top_m, world.lowest_m(thing) + TIP_M + FLOOR_M)
    way = world.position(target) - world.position(thing)

    def cost(grasp: Grasp) -> tuple[float, float]:
        """Room comes first; with enough of it, the thinnest side, in its middle, square, without turning the hand."""
        room = min(_room(obstacles, place, grasp.yaw_rad) for place in (grasp.place, grasp.place + way))
        turn = abs(half_turn(grasp.yaw_rad - hand_yaw_rad))
        return -min(room, ROOM_M), grasp.width_m + grasp.aside_m + 0.1 * abs(grasp.skew_rad) + 0.01 * turn

    for grasp in candidates:
        grasp.place[2] = height
    return min(candidates, key=cost)


def half_turn(yaw_rad: float) -> float:
    """The same line between the fingers, turned by less than a right angle: -pi/2 to pi/2."""
    return float((yaw_rad + np.pi / 2) % np.pi - np.pi / 2)


def _across(world: World, thing: str) -> Iterator[Grasp]:
    """Between two opposite sides of a thing that is narrow enough, in the middle or towards an end."""
    low, high = world.extent(thing)
    pose = world.pose(thing)
    middle = pose[:3, 3] + pose[:3, :3] @ ((low + high) / 2)
    upright = int(np.argmax(np.abs(pose[2, :3])))
    level = [axis for axis in range(3) if axis != upright]
    for across, along in (level, level[::-1]):
        width = high[across] - low[across]
        if width > OPENING_M:
            continue
        line = pose[:2, across] / np.linalg.norm(pose[:2, across])
        square = float(np.arctan2(line[0], -line[1]))
        spare = max(0.0, (high[along] - low[along]) / 2 - PARTS_M[0][1])
        for aside, skew in product(ASIDE, SKEWS_RAD):
            place = middle + aside * spare * pose[:3, along]
            yield Grasp(place, half_turn(square + skew), float(width), abs(aside * spare), skew)


def _rim(world: World, thing: str) -> Iterator[Grasp]:
    """One finger inside and one outside of the rim of a hollow thing, on any side of it."""
    low, high = world.bounds(thing)
    middle = world.position(thing)
    reach = float(max(high[:2] - low[:2])) / 2
    radii = np.arange(0.6 * reach, 1.1 * reach, 0.001)
    for angle in np.linspace(0, 2 * np.pi, 16, endpoint=False):
        out = np.array([np.cos(angle), np.sin(angle), 0.0])
        points = [middle + radius * out for radius in radii]
        heights = [world.floor_m(thing, np.array([*point[:2], high[2] + 0.01])) or -np.inf for point in points]
        # The rim is where the thing is as high as anywhere on this side, to 1 mm.
        rim = np.isclose(heights, max(heights), atol=0.001)
        yield Grasp(np.mean(points, axis=0, where=rim[:, None]), half_turn(float(np.arctan2(out[0], -out[1]))), 0.0)


def _room(obstacles: list[tuple[np.ndarray, np.ndarray]], place: np.ndarray, yaw_rad: float) -> float:
    """Least distance, seen from above, of the hand from other things that reach up to it."""
    room = np.inf
    for begins_m, *half in PARTS_M:
        points = place[:2] + _GRID * half @ hand_down(yaw_rad)[:2, :2].T
        for low, high in obstacles:
            if low[2] < place[2] + HEIGHT_M and high[2] > place[2] + begins_m:
                apart = np.maximum(0, np.maximum(low[:2] - points, points - high[:2]))
                room = min(room, float(np.linalg.norm(apart, axis=1).min()))
    return room
