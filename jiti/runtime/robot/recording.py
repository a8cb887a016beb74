"""An episode of an arm as MCAP, and beside it two tables: what each step and each decision took.

Pictures are compressed and written by a thread of its own, so that the loop waits for neither. However an episode ends,
what it was until then is kept.
"""

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from queue import Full, Queue
from threading import Thread
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from jiti.durable import replacing
from jiti.episodes.mcap_contents import METADATA_NAME
from jiti.episodes.mcap_writer import McapWriter
from jiti.errors import RobotError
from jiti.runtime.robot.live import LiveArm
from jiti.runtime.robot.tick import Arrived, Tick, Watcher, state_of
from jiti.runtime.rollout.recorder import write_decision
from jiti.runtime.rollout.result import choice_of, without_nan
from jiti.runtime.sim.pictures import jpeg

JOINTS, ACTION, ASKED = "/joints", "/action", "/action_asked"
"""Topics, in lerobot's units: where the joints were, where they were sent, and what the policy asked for."""
WAITING = 150
"""Steps that may wait to be written, five seconds: 280 MB with two cameras of 640 x 480. Our choice."""
TICKS, DECISIONS = ".ticks.parquet", ".decisions.parquet"
"""Suffixes of the tables."""


class Recording(Watcher):
    """`path` takes its name at `finish`. Without a path nothing is kept but the tables, for the report."""

    def __init__(
        self,
        path: Path | None,
        joints: tuple[str, ...],
        cameras: tuple[str, ...],
        *,
        instruction: str = "",
        about: Mapping[str, str] | None = None,
        shown: LiveArm | None = None,
    ) -> None:
        """`shown` is told of all of it in the writer's thread."""
        self.path, self._joints, self._cameras, self._shown = path, joints, cameras, shown
        self._names = [f"{joint}.pos" for joint in joints]
        self._writer = McapWriter(path, instruction=instruction, metadata=about) if path else None
        self._times: dict[int, int] = {}
        self.ticks: list[dict[str, Any]] = []
        self.decisions: list[dict[str, Any]] = []
        self._queue: Queue[Tick | Arrived | None] = Queue(WAITING)
        self._error: Exception | None = None
        self._thread = Thread(target=self._write_all, name="recording", daemon=True)
        self._thread.start()

    def ticked(self, tick: Tick) -> None:
        self._put(tick)

    def arrived(self, arrived: Arrived) -> None:
        self._put(arrived)

    def finish(self, ended: str) -> None:
        """Write what is left, with how the episode ended, and the tables. Raises SaveFailed."""
        self._queue.put(None)
        self._thread.join()
        with ExitStack() as last:  # in reverse order, each whatever those before it raise
            if self._shown is not None:
                last.callback(self._shown.close)
            if self._writer is not None and self.path is not None:
                last.callback(self._write_table, self.path.with_suffix(DECISIONS), self.decisions)
                last.callback(self._write_table, self.path.with_suffix(TICKS), self.ticks)
                last.callback(self._writer.close)
                self._writer.write_metadata(METADATA_NAME, {"ended": ended, "steps": str(len(self.ticks))})
        if self._error is not None:
            raise self._error

    def discard(self) -> None:
        """Leave nothing behind."""
        self._queue.put(None)
        self._thread.join()
        if self._shown is not None:
            self._shown.close()
        if self._writer is not None:
            self._writer.discard()

    def _write_table(self, path: Path, rows: list[dict[str, Any]]) -> None:
        if rows:
            with replacing(path) as temporary:
                pq.write_table(pa.Table.from_pylist(rows), temporary)

    def _put(self, given: Tick | Arrived) -> None:
        if self._error is not None:
            raise self._error
        try:
            self._queue.put_nowait(given)
        except Full:
            raise RobotError(
                f"the disk is {WAITING} steps behind: record to another one (--out), with smaller pictures, or not at "
                "all (--no-record)."
            ) from None

    def _write_all(self) -> None:
        while (given := self._queue.get()) is not None:
            if self._error is not None:
                continue
            try:
                if isinstance(given, Tick):
                    self._tick(given)
                else:
                    self._decision(given)
            except Exception as error:  # told by the loop, at its next step
                self._error = error

    def _tick(self, tick: Tick) -> None:
        self._times[tick.tick] = tick.time_ns
        row = {name: getattr(tick, name) for name in _TICK_NAMES}
        self.ticks.append(without_nan(row | {"read": tick.seen is not None, "clamped": list(tick.clamped)}))
        pictures = {}
        if tick.seen is not None and (self._writer is not None or self._shown is not None):
            pictures = {camera: jpeg(np.asarray(tick.seen[camera])) for camera in self._cameras}
        if self._writer is not None:
            self._write(self._writer, tick, pictures)
        if self._shown is not None:
            self._shown.ticked(tick, pictures)

    def _write(self, writer: McapWriter, tick: Tick, pictures: Mapping[str, bytes]) -> None:
        for camera, data in pictures.items():
            writer.write_picture(f"/camera/{camera}", tick.time_ns, data, frame_id=camera)
        if tick.seen is not None:
            writer.write_vector(JOINTS, tick.time_ns, self._names, state_of(tick.seen, self._joints))
        writer.write_vector(ACTION, tick.time_ns, self._names, [tick.sent[name] for name in self._joints])
        if tick.asked is not None:
            writer.write_vector(ASKED, tick.time_ns, self._names, [tick.asked[name] for name in self._joints])

    def _decision(self, arrived: Arrived) -> None:
        answer = arrived.answer
        row = asdict(choice_of(answer.decided))
        row |= {"arrived": arrived.tick, "dropped": arrived.dropped, "round_trip_s": answer.round_trip_s}
        self.decisions.append(without_nan(row))
        if self._writer is not None:
            write_decision(self._writer, self._times[answer.decided.frame], answer.decided)
        if self._shown is not None:
            self._shown.decided(answer.decided)


_TICK_NAMES = ("tick", "time_ns", "begun", "held", "period_s", "observe_s", "send_s", "busy_s")
