"""What was asked of the robot, and what was left unsaid: Task, ITC, Elegance Criterion."""

from dataclasses import dataclass
from enum import StrEnum


class Criterion(StrEnum):
    """The four Elegance Criteria (supplement B.2)."""

    TASK_SEQUENCE_INTEGRITY = "task_sequence_integrity"
    TARGET_POSE_ACCURACY = "target_pose_accuracy"
    POSE_ALIGNMENT = "pose_alignment"
    COLLISION_FREE_EXECUTION = "collision_free_execution"


@dataclass(frozen=True, slots=True)
class ITC:
    """An Implicit Task Constraint: how a task must be done, beyond its success condition."""

    itc_id: str
    """Unique in a catalogue: `elegant/T2/centered`."""
    statement: str
    criterion: Criterion
    check: str = ""
    """How a person decides it."""
    goal: str = ""
    """How the simulator decides it, in BDDL (`jiti.tasks.goal`); empty for tasks that are not simulated."""


@dataclass(frozen=True, slots=True)
class Task:
    """An instruction and the ITCs that tell an elegant execution from a successful one."""

    task_id: str
    """`elegant/T2`, `rq3/seen-A`, `g4/close-microwave`, `so100/T4`."""
    instruction: str
    itcs: tuple[ITC, ...]
    source: str = ""
    """Where it is defined: `supplement, Table 4`."""
    bddl: str | None = None
    """LIBERO's BDDL file, `suite/name`, for tasks in simulation."""
    aliases: tuple[str, ...] = ()
    """Other wordings under which recordings have it."""
