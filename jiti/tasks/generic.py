"""The task of an episode that no catalogue knows: one ITC for each Elegance Criterion."""

from jiti.tasks.task import ITC, Criterion, Task

GENERIC = "generic"

_MEANING = {
    Criterion.TASK_SEQUENCE_INTEGRITY: (
        "The execution respects the intended ordering and timing of key actions without premature releases, "
        "unnecessary pauses, or unintended reversals.",
        "Around grasps and releases. Pass: every action comes when it should, once. Fail: something is let go too "
        "early, waited for or done again.",
    ),
    Criterion.TARGET_POSE_ACCURACY: (
        "The manipulated object reaches the correct final position within a tight spatial tolerance.",
        "From the object's approach to its target until it rests. Pass: it is where it should be, centred. "
        "Fail: it is visibly off.",
    ),
    Criterion.POSE_ALIGNMENT: (
        "The object's final orientation matches the desired orientation for stable insertion or placement.",
        "From the object's approach to its target until it rests. Pass: it is turned as it should be and stands "
        "by itself. Fail: it leans or is turned.",
    ),
    Criterion.COLLISION_FREE_EXECUTION: (
        "The trajectory avoids unintended contact with the environment or nearby objects.",
        "While the arm moves near other things. Pass: none of them is touched. Fail: one is touched or moved.",
    ),
}
"""Statements after the definitions of supplement B.2, and how to decide them."""


def generic_task(instruction: str | None = None) -> Task:
    """A task that any recording can be labelled for, under the instruction that it was recorded with."""
    itcs = [ITC(f"{GENERIC}/{name}", statement, name, check) for name, (statement, check) in _MEANING.items()]
    return Task(GENERIC, instruction or "", tuple(itcs), "supplement, B.2")
