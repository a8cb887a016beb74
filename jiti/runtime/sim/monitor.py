"""Watches the predicates of a task's ITCs at every step of an episode, and judges it in the end."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from jiti.errors import UsageError
from jiti.runtime.sim.predicates import Predicate, bind
from jiti.runtime.sim.scene import Scene
from jiti.runtime.sim.world import GRIPPER
from jiti.tasks.goal import GRASP, Atom, Goal, atoms, parse_goal
from jiti.tasks.judge import GAP, Trace, Verdict, judge


@dataclass(frozen=True, slots=True)
class Outcome:
    """How an episode went."""

    success: bool
    """Whether LIBERO's own predicate held at any step: its evaluation ends there."""
    verdicts: Mapping[str, Verdict]
    """By ITC id. Steps count from the first state, 0, to the last, which no action follows."""
    steps: int
    """States that were seen."""

    @property
    def elegant(self) -> bool:
        """Success, and every ITC satisfied (main paper)."""
        return self.success and all(v.satisfied for v in self.verdicts.values())

    def to_json(self) -> dict[str, Any]:
        """As it stands in recordings and `--json`."""
        verdicts = {itc_id: asdict(verdict) for itc_id, verdict in self.verdicts.items()}
        return {"success": self.success, "elegant": self.elegant, "steps": self.steps, "itcs": verdicts}


class Monitor:
    """Call `begin` after a reset, `look` after every step, `outcome` when the episode is over."""

    def __init__(self, scene: Scene) -> None:
        """Raises UsageError when an ITC of the task has no goal, or its goal speaks of what the scene does not have."""
        self._scene = scene
        self._goals: dict[str, Goal] = {}
        for itc in scene.task.itcs:
            if not itc.goal:
                raise UsageError(
                    f"{itc.itc_id} has no `goal`, so the simulator cannot decide it; add one to its task file"
                )
            self._goals[itc.itc_id] = parse_goal(itc.goal)
        watched = dict.fromkeys(atom for goal in self._goals.values() for atom in atoms(goal))
        # The release of what the task is about says when its pose at the end was decided.
        carried = [Atom(GRASP, (name,)) for name in scene.interest if name in scene.world.names.objects]
        self._predicates: dict[str, Predicate] = {
            str(atom): bind(scene, atom) for atom in dict.fromkeys((*watched, *carried))
        }
        self._neighbours = {
            f"{atom} {GAP}": atom.arguments[0] for atom in watched if atom.predicate == "PositionUnchanged"
        }
        self.begin()

    @property
    def predicates(self) -> tuple[str, ...]:
        """Names of the columns of `holds`."""
        return tuple(self._predicates)

    @property
    def measures(self) -> tuple[str, ...]:
        """Names of the columns of `measured`."""
        return (*(f"{name} {p.measure}" for name, p in self._predicates.items()), *self._neighbours)

    def begin(self) -> None:
        """Start an episode at the present state, which is its step 0."""
        self._holds: list[list[bool]] = []
        self._measured: list[list[float]] = []
        self._success = False
        for predicate in self._predicates.values():
            predicate.begin()
        self.look()

    def look(self) -> None:
        """Add the present state as the next step."""
        measured = [predicate.look() for predicate in self._predicates.values()]
        self._holds.append([p.holds(m) for p, m in zip(self._predicates.values(), measured, strict=True)])
        self._measured.append([*measured, *self._gaps_m()])
        self._success = self._success or self._scene.succeeded()

    @property
    def success(self) -> bool:
        """Whether LIBERO's own predicate has held since `begin`."""
        return self._success

    @property
    def holds(self) -> list[bool]:
        """The last step's predicates."""
        return self._holds[-1]

    @property
    def measured(self) -> list[float]:
        """The last step's measures."""
        return self._measured[-1]

    def trace(self) -> Trace:
        """Everything since `begin`."""
        holds, measured = np.array(self._holds, dtype=bool).T, np.array(self._measured).T
        return Trace(dict(zip(self.predicates, holds, strict=True)), dict(zip(self.measures, measured, strict=True)))

    def outcome(self) -> Outcome:
        """The verdicts on the episode as it stands."""
        trace = self.trace()
        verdicts = {itc_id: judge(goal, trace) for itc_id, goal in self._goals.items()}
        return Outcome(self._success, verdicts, len(self._holds))

    def _gaps_m(self) -> list[float]:
        """How near the hand, and what it touches or holds, is to each thing that should stay as it is."""
        if not self._neighbours:
            return []
        world = self._scene.world
        things = [n for n in self._scene.interest if n in world.names.objects]
        contacts = world.contacts((*things, GRIPPER))
        moved = [GRIPPER, *(n for n in things if (GRIPPER, n) in contacts)]
        return [min(world.gap_m(n, stays) for n in moved if n != stays) for stays in self._neighbours.values()]
