"""What is asked of a person about an episode: success, then each ITC of the task, by one key each."""

from dataclasses import dataclass
from pathlib import Path

from jiti.runtime.robot.panel import Panel, Shown
from jiti.tasks.task import Task

YES, NO, UNSURE, BACK = "y", "n", "s", "u"
_ANSWERS = {YES: True, NO: False, UNSURE: None}


@dataclass(frozen=True, slots=True)
class Answers:
    """None for what the person could not tell: success is always told."""

    success: bool
    itcs: dict[str, bool | None]


def ask(panel: Panel, task: Task, recording: Path, title: str) -> Answers:
    """Ask all of it; `u` goes back to the question before. Raises Stopped, and nothing is answered then."""
    success = Shown(
        "asking",
        f"Did it succeed? “{task.instruction}”",
        f"The recording is {recording}",
        title,
        {YES: "yes", NO: "no"},
        recording,
    )
    questions = [success] + [
        Shown("asking", itc.statement, itc.check, title, {YES: "yes", NO: "no", UNSURE: "cannot tell"}, recording)
        for itc in task.itcs
    ]
    given: list[bool | None] = []
    while len(given) < len(questions):
        question = questions[len(given)]
        back = {BACK: "back to the question before"} if given else {}
        key = panel.ask(
            Shown(question.phase, question.text, question.detail, title, {**question.keys, **back}, question.recording)
        )
        if key == BACK:
            given.pop()
        else:
            given.append(_ANSWERS[key])
    first, *others = given
    return Answers(bool(first), {itc.itc_id: answer for itc, answer in zip(task.itcs, others, strict=True)})
