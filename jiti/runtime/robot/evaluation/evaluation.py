"""An evaluation from turn to turn: lay out, play, judge, and so on, whenever it was left."""

import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from jiti.runtime.guidance import Guidance
from jiti.runtime.robot.evaluation.judged import Judged, Kept
from jiti.runtime.robot.evaluation.questions import BACK, ask
from jiti.runtime.robot.evaluation.schedule import Slot, schedule
from jiti.runtime.robot.evaluation.verdicts import save_verdicts
from jiti.runtime.robot.panel import Panel, Shown
from jiti.runtime.robot.run import Recorded
from jiti.runtime.robot.stops import NEXT
from jiti.runtime.robot.turn import Turn
from jiti.runtime.rollout.result import RECORDING_SUFFIX
from jiti.tasks.task import Task

RECORDINGS = "judged"
"""Folder of the recordings, whose names do not tell the guidance."""


class Evaluation:
    """`kept` is what is on the disk at any moment."""

    def __init__(
        self, kept: Kept, task: Task, guidances: Mapping[str, Guidance], annotator: str, panel: Panel, *, blind: bool
    ) -> None:
        """`blind`: a person is not told which guidance it is."""
        self.kept, self._task, self._annotator, self._panel = kept, task, annotator, panel
        self._guidances, self._blind = guidances, blind
        layouts = kept.planned // len(guidances)
        self._slots = {slot.number: slot for slot in schedule(sorted(guidances), layouts, kept.salt)}
        self.folder = kept.path.parent / RECORDINGS

    def turns(self) -> list[Turn]:
        """What is still to be played."""
        played = {row.number for row in self.kept.rows}
        return [self._turn(slot) for slot in self._slots.values() if slot.number not in played]

    def judge_waiting(self) -> None:
        """What was played before and not judged. Raises Stopped."""
        for row in self.kept.waiting:
            self._judge(row)

    def before(self, turn: Turn) -> None:
        """Wait until the things are laid out; the last verdict can still be changed. Raises Stopped."""
        slot = self._slots[turn.number]
        first = sum(s.layout == slot.layout for s in self._slots.values() if s.number < slot.number) == 0
        how = "Lay the things out anew." if first else "Lay the things out as they lay before."
        self._wait(how, f"Layout {slot.layout + 1}; keep clear of the arm.", self.title(turn.number), "begin")

    def keep(self, recorded: Recorded) -> None:
        """That it was played, and is to be judged. Raises SaveFailed."""
        slot, path = self._slots[recorded.turn.number], recorded.turn.path
        row = Judged(
            slot.number, self._task.task_id, slot.layout, slot.label, path.name, recorded.ended, time.time_ns()
        )
        self.kept = self.kept.with_row(row)

    def after(self, _recorded: Recorded) -> None:
        """Have it judged. Raises Stopped."""
        self.judge_waiting()

    def finish(self) -> None:
        """Before all is told, the last verdict can still be changed. Raises Stopped."""
        self._wait("All episodes are judged.", "Then it is told which guidance did what.", "", "tell")

    def _wait(self, text: str, detail: str, title: str, does: str) -> None:
        """For Enter; the last verdict can be changed until then."""
        while True:
            last = max((row for row in self.kept.rows if row.judged_at), key=_judged_at, default=None)
            keys = {NEXT: does, **({BACK: "judge the last one again"} if last else {})}
            if self._panel.ask(Shown("ready", text, detail, title, keys)) == NEXT or last is None:
                return
            self._judge(last)

    def _judge(self, row: Judged) -> None:
        path = self.folder / row.recording
        answers = ask(self._panel, self._task, path, self.title(row.number))
        judged = replace(
            row, success=answers.success, itcs=answers.itcs, annotator=self._annotator, judged_at=time.time_ns()
        )
        self.kept = self.kept.with_row(judged)
        save_verdicts(path, self._task, answers, self._annotator)

    def _turn(self, slot: Slot) -> Turn:
        return Turn(slot.number, slot.layout, self._guidances[slot.label], self._free_path(slot.number))

    def _free_path(self, number: int) -> Path:
        """An episode that was stopped is played again, and its recording stays."""
        stem, again = f"{self._task.task_id.replace('/', '-')}_{number:04d}", 1
        path = self.folder / f"{stem}{RECORDING_SUFFIX}"
        while path.exists():
            again += 1
            path = self.folder / f"{stem}-again{again}{RECORDING_SUFFIX}"
        return path

    def title(self, number: int) -> str:
        """Which one, and what guides it where that is no secret."""
        label = "" if self._blind else f", {self._slots[number].label}"
        return f"Episode {number + 1} of {self.kept.planned}{label}"


def _judged_at(row: Judged) -> int:
    return row.judged_at or 0
