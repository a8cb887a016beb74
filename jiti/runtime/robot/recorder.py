"""Demonstrations on an arm, one after another: wait for a person, record, and record anew what is not liked."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from jiti.runtime.robot.demonstrations import delete
from jiti.runtime.robot.keys import ANEW, Keys
from jiti.runtime.robot.loop import prompt
from jiti.runtime.robot.panel import Panel, Shown
from jiti.runtime.robot.recording import Recording
from jiti.runtime.robot.safe_arm import SafeArm
from jiti.runtime.robot.scripted import Scripted
from jiti.runtime.robot.stops import NEXT
from jiti.runtime.robot.take import GIVEN_UP, Take
from jiti.runtime.robot.ways import Way


@dataclass
class Recorder:
    """Of an open arm."""

    arm: SafeArm
    way: Way
    keys: Keys
    hand: Scripted | None
    """Who demonstrates, where it is no person."""
    lay_out: Callable[[int], None]
    """Puts things where a seed says; does nothing where a person does that."""
    panel: Panel
    path: Callable[[int], Path]
    """Of a seed's recording."""
    open: Callable[[int, str], Recording]
    """For a seed, and the manner in which the hand demonstrates; empty for a person."""

    def record(self, seeds: Sequence[int], seconds: float) -> Exception | None:
        """What ended it before the last: Stopped, or an error. What was recorded until then is kept."""
        done, redoable = 0, False
        try:
            while seeds:
                if self._is_to_be_anew(seeds, done, redoable=redoable):
                    done, redoable = done - 1, False  # one at a time: a key may be held down
                    delete(self.path(seeds[done]))
                    self.panel.remark(f"{self.path(seeds[done]).name} is deleted.")
                elif done == len(seeds):
                    break
                else:
                    redoable = self._one(seeds[done], seconds)
                    done += redoable
        except Exception as problem:
            return problem
        return None

    def _is_to_be_anew(self, seeds: Sequence[int], done: int, *, redoable: bool) -> bool:
        """Wait for Enter; whether the episode before is to be recorded anew instead."""
        if done < len(seeds):
            self.lay_out(seeds[done])
        if not self.keys.keys:
            return False
        left = done < len(seeds)
        text = f"{self.path(seeds[done]).name} is next." if left else "All are there."
        keys = {NEXT: "begin" if left else "end"}
        keys |= {ANEW: f"record {self.path(seeds[done - 1]).name} anew"} if redoable else {}
        return self.panel.ask(Shown("ready", text, "Lay the things out." if left else "", keys=keys)) == ANEW

    def _one(self, seed: int, seconds: float) -> bool:
        """Whether there is a recording: not where it was given up, or nothing could be read. Raises what stopped it,
        when it is saved."""
        with self.keys.guarded():
            recording = self.open(seed, self.hand.plan(seed) if self.hand else "")
            take = Take(self.arm, self.way, self.keys, recording, self.hand.over if self.hand else lambda: False)
            ended, problem = self._take(take, seconds)
            kept = take.read > 0 and ended != GIVEN_UP
            try:
                if not kept:
                    recording.discard()
                else:
                    self.way.finish(recording)
                    recording.finish(ended or str(problem))
                    self._tell(recording, ended or str(problem))
            except Exception as error:
                problem = problem or error
            if problem is not None:
                raise problem
        if self.hand is not None:
            self.hand.wait(self.keys)
        return kept

    def _take(self, take: Take, seconds: float) -> tuple[str, Exception | None]:
        """What ended it, and what stopped it or kept the arm from going back; the arm is at rest in any case."""
        ended = ""
        try:
            with prompt():
                try:
                    self.panel.tell(Shown("running", "Getting ready."))
                    self.way.begin(self.keys)
                    if self.hand is not None:
                        self.hand.begin()
                    told = "Recording: Enter ends it, r records it anew, Space stops everything at once."
                    self.panel.tell(Shown("running", told, keys={NEXT: "end it", ANEW: "record it anew"}))
                    ended = take.run(seconds)
                    if self.hand is not None:
                        self.hand.go_home()
                    self.way.end(self.keys)
                except BaseException as error:
                    self.arm.stop(error)
                    raise
        except Exception as error:
            return ended, error
        return ended, None

    def _tell(self, recording: Recording, told: str) -> None:
        ticks = recording.ticks
        lasted_s = (ticks[-1]["time_ns"] - ticks[0]["time_ns"]) / 1e9
        periods_ms = np.diff([tick["time_ns"] for tick in ticks]) / 1e6
        rate = f"a step took {np.median(periods_ms):.1f} ms, {periods_ms.max():.0f} at most" if len(ticks) > 1 else ""
        name = recording.path.name if recording.path else ""
        self.panel.remark(f"{name}: {lasted_s:.1f} s, {len(ticks)} steps, ended: {told}; {rate}.")
