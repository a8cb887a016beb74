"""The paper's five predicates (supplement B.2) and one of ours, on the state of the simulation.

Each measures one number and holds while that is within a tolerance. Those that compare with the start of an episode
remember it in `begin`. LIBERO's own predicates (`In`, `On`, `Close`, ...) are used as they are, see `LiberoPredicate`.
"""

from collections.abc import Callable
from typing import ClassVar, Protocol

import numpy as np

from jiti.errors import UsageError
from jiti.nearest import nearest
from jiti.runtime.sim.scene import Scene
from jiti.runtime.sim.world import LEFT, RIGHT
from jiti.tasks.goal import Atom
from jiti.tasks.rotation import angle_between, angle_to_box, rotation_vector
from jiti.tasks.tolerance import ARM_M, TILT_RAD, TOLERANCE


class Predicate(Protocol):
    """One predicate of a goal, bound to the things of a scene."""

    measure: ClassVar[str]
    """Name of what `look` gives, with its unit: `clearance_m`."""

    def begin(self) -> None:
        """Take the present state as the start of an episode."""
        ...

    def look(self) -> float:
        """The measured number now."""
        ...

    def holds(self, measured: float) -> bool:
        """Whether the predicate holds at that number."""
        ...


class _Within:
    """Holds while what is measured is at most `tolerance`."""

    arity: ClassVar[int] = 1
    measure: ClassVar[str]
    default: ClassVar[float]

    def __init__(self, scene: Scene, arguments: tuple[str, ...], tolerance: float | None) -> None:
        if len(arguments) != self.arity:
            name = type(self).__name__
            raise UsageError(f"{name} takes {self.arity} things and got {len(arguments)}: {' '.join(arguments)}")
        self.scene, self.world, self.arguments = scene, scene.world, arguments
        self.tolerance = self.default if tolerance is None else tolerance
        for name in arguments:
            self.world.position(name)  # says so when the scene has no such thing
        self.begin()

    def begin(self) -> None:
        return

    def look(self) -> float:
        raise NotImplementedError

    def holds(self, measured: float) -> bool:
        return measured <= self.tolerance


class IsGrasping(_Within):
    """`(IsGrasping OBJECT)`: the hand holds the object; "securely grasped until the intended release moment".

    Geometry: both fingers, with their pads or beside them, are in contact with the object's collision shapes. Measured
    is the number of fingers that do not touch it (0, 1, 2); it holds at 0. One finger alone pushes and does not hold.
    robosuite's `_check_grasp` asks for the pads, but a rim may be held by what is behind them. The judge bridges
    flickers of contact (`jiti.tasks.judge`), this does not.
    """

    measure = "open_fingers"
    default = TOLERANCE["IsGrasping"]

    def look(self) -> float:
        (thing,) = self.arguments
        contacts = self.world.contacts((thing, LEFT, RIGHT))
        return float(sum((finger, thing) not in contacts for finger in (LEFT, RIGHT)))


class IsOnBottomOf(_Within):
    """`(IsOnBottomOf OBJECT SUPPORT)`: the object rests on the support or is so close above it that it cannot drop.

    Geometry: height, along the world's z, of the object's lowest point over the support's surface on the vertical
    through the object's origin; infinite where that vertical misses the support. Measured in m, it holds up to 0.020 m:
    a fall of 2 cm takes 64 ms, about one control step at 20 Hz, and ends at 0.63 m/s. The fingers lose a thing 5 to 8
    steps after they were told to open, so who lets go while lowering still passes. A prototype's elegant releases were
    6 to 21 mm over rest, its sloppy ones 41 to 126 mm.
    """

    arity = 2
    measure = "clearance_m"
    default = TOLERANCE["IsOnBottomOf"]

    def look(self) -> float:
        thing, support = self.arguments
        low, high = self.world.bounds(thing)
        start = self.world.position(thing)
        # From its middle down: shapes of the support above that, as a rim or a handle, do not carry it.
        start[2] = (low[2] + high[2]) / 2
        floor = self.world.floor_m(support, start)
        return float("inf") if floor is None else self.world.lowest_m(thing) - floor


class IsPreciselyOn(_Within):
    """`(IsPreciselyOn OBJECT TARGET [TOLERANCE_M])`: the object stands in the middle of the target, level.

    Geometry: horizontal distance between the object's origin and the target's (a body's origin, or the middle of a
    region), both in the world's frame; infinite unless the two touch and the object's axis that pointed up at the start
    of the episode is within 0.1 rad of where it pointed. Measured in m, it holds up to 0.010 m or the goal's own
    tolerance. LIBERO's `On` already asks for 0.03 m between bowl and plate; a third of that is visibly concentric. On
    the stove, whose burner is a square of 15 cm, the goal says 0.02 m. 0.1 rad is 5.7 degrees: a bowl of 11 cm then
    stands with one side of its rim 11 mm higher.
    """

    arity = 2
    measure = "offset_m"
    default = TOLERANCE["IsPreciselyOn"]

    def begin(self) -> None:
        self._up = self.world.rotation(self.arguments[0])[2]  # the world's z in the object's axes

    def look(self) -> float:
        thing, target = self.arguments
        tilt = angle_between(self.world.rotation(thing) @ self._up, np.array([0.0, 0.0, 1.0]))
        if tilt > TILT_RAD or not self.world.touching(thing, target):
            return float("inf")
        return float(np.linalg.norm((self.world.position(thing) - self.world.position(target))[:2]))


class IsOrientationAligned(_Within):
    """`(IsOrientationAligned OBJECT REGION [TOLERANCE_RAD])`: the object stands parallel to the walls around a region.

    Geometry: the smallest turn, about any axis, that makes the axes of the object's box parallel to those of the
    region, whichever to whichever (24 ways); both frames are read in the world. Measured in rad, 0 to 1.10, it holds up
    to 0.10 rad, 5.7 degrees: a book of 13.5 cm that leans by that much is 13 mm out of the vertical at its top, half of
    the play that a book of 29 mm has in the caddy's back compartment of 56 mm.
    """

    arity = 2
    measure = "turned_rad"
    default = TOLERANCE["IsOrientationAligned"]

    def look(self) -> float:
        thing, region = self.arguments
        return angle_to_box(self.world.rotation(thing), self.world.rotation(region))


class PositionUnchanged(_Within):
    """`(PositionUnchanged OBJECT)`: the object is where it was at the start of the episode and turned as it was.

    Geometry: how far its origin has moved in the world since the start, after settling, plus how far it has turned, at
    0.05 m a radian, so that one number says both: 5 mm, or 0.1 rad, or half of each. Measured in m, it holds up to
    0.005 m: resting objects creep by less than 1 mm in an episode, and a touch that can be seen moves them by more.
    """

    measure = "moved_m"
    default = TOLERANCE["PositionUnchanged"]

    def begin(self) -> None:
        self._at, self._turn = self.world.position(self.arguments[0]), self.world.rotation(self.arguments[0])

    def look(self) -> float:
        (thing,) = self.arguments
        moved = np.linalg.norm(self.world.position(thing) - self._at)
        turned = np.linalg.norm(rotation_vector(self._turn, self.world.rotation(thing)))
        return float(moved + ARM_M * turned)


class MovesGently(_Within):
    """`(MovesGently PART [TOLERANCE])`: a drawer or a door is not slammed. Ours: the paper has no predicate for its
    articulated tasks (G.4); Table 7, Task 5 asks for "closed smoothly and fully".

    Geometry: the greatest speed of the part's joint at the end of each control step, in its own unit, m/s for a drawer
    and rad/s for a door. It holds up to 0.10, or the goal's own tolerance. Gentle pushes by our scripts make at most
    0.06 m/s, and slams at least 0.15; the microwave's door, 0.26 m wide, turns with 0.3 to 0.5 and 1.3 to 1.4 rad/s,
    and its goal says 0.8.
    """

    measure = "speed"
    default = TOLERANCE["MovesGently"]

    def begin(self) -> None:
        if not len(self.world.joint_speeds(self.arguments[0])):
            raise UsageError(f"{self.arguments[0]} has no moving part, so MovesGently cannot speak of it")

    def look(self) -> float:
        return float(np.abs(self.world.joint_speeds(self.arguments[0])).max(initial=0.0))


class LiberoPredicate:
    """One of LIBERO's own: measured is 1 while it holds and 0 while it does not."""

    measure: ClassVar[str] = "holds"

    def __init__(self, scene: Scene, atom: Atom) -> None:
        if len(atom.arguments) != LIBEROS[atom.predicate]:
            count = LIBEROS[atom.predicate]
            raise UsageError(f"LIBERO's {atom.predicate} takes {count} things and got {len(atom.arguments)}: {atom}")
        if atom.tolerance is not None:
            raise UsageError(f"LIBERO's {atom.predicate} takes no tolerance: {atom}")
        self._look: Callable[[], bool] = lambda: scene.holds(atom.predicate, *atom.arguments)
        self._look()  # says so when the scene has no such thing

    def begin(self) -> None:
        return

    def look(self) -> float:
        return float(self._look())

    def holds(self, measured: float) -> bool:
        return measured > 0


PREDICATES: dict[str, type[_Within]] = {
    kind.__name__: kind
    for kind in (IsGrasping, IsOnBottomOf, IsPreciselyOn, IsOrientationAligned, PositionUnchanged, MovesGently)
}
LIBEROS = {"In": 2, "On": 2, "Up": 1, "Open": 1, "Close": 1, "Turnon": 1, "Turnoff": 1}
"""LIBERO's own predicates, and of how many things each speaks."""


def bind(scene: Scene, atom: Atom) -> Predicate:
    """The predicate of a goal, on the things of a scene. Raises UsageError for one that neither knows."""
    if atom.predicate in PREDICATES:
        return PREDICATES[atom.predicate](scene, atom.arguments, atom.tolerance)
    if atom.predicate in LIBEROS:
        return LiberoPredicate(scene, atom)
    known = nearest(atom.predicate, [*PREDICATES, *LIBEROS])
    raise UsageError(f"there is no predicate {atom.predicate!r}; {known}.")
