"""The arm's USB cable: a pseudo-terminal that servos listen on, and the thread that keeps the world in real time.

A link in the file system leads to it, so that its name stays when it is unplugged and plugged in again.
"""

import os
import select
import tty
from contextlib import suppress
from pathlib import Path
from random import Random
from threading import Event, Thread
from time import monotonic

from jiti.runtime.robot.virtual.packet import Parser
from jiti.runtime.robot.virtual.servo_bus import ServoBus
from jiti.runtime.robot.virtual.world import World

TICK_S = 0.01
"""The world is brought up to the present this often, or after a packet. Our choice."""


class Line:
    """Serves a world's servos at `link` from `start` to `close`."""

    def __init__(self, world: World, link: Path) -> None:
        self._world, self._link = world, link
        self._bus, self._parser = ServoBus(world.servos), Parser()
        self._ends: tuple[int, int] | None = None  # ours and theirs; without an open end of theirs, ours cannot be read
        self._ended = Event()
        self._thread = Thread(target=self._serve, name=f"servos at {link}", daemon=True)
        self._random = Random(0)

    def start(self) -> None:
        self._plug()
        self._thread.start()

    def close(self) -> None:
        """Returns when nothing is served any more."""
        self._ended.set()
        self._thread.join()
        self._unplug()

    def _plug(self) -> None:
        self._ends = os.openpty()
        os.set_blocking(self._ends[0], False)
        tty.setraw(self._ends[1])
        self._link.symlink_to(os.ttyname(self._ends[1]))
        self._parser.reset()

    def _unplug(self) -> None:
        if self._ends is not None:
            self._link.unlink(missing_ok=True)
            for end in self._ends:
                os.close(end)
            self._ends = None

    def _serve(self) -> None:
        behind = False
        while not self._ended.is_set():
            if self._world.faults.unplugged:
                self._unplug()
            elif self._ends is None:
                self._plug()
            # Packets first: lerobot waits for 50 ms, on a machine that may have much else to do.
            ends = [self._ends[0]] if self._ends else []
            if select.select(ends, [], [], 0 if behind else TICK_S)[0]:
                self._reply(ends[0], os.read(ends[0], 4096))
            elif not behind:
                self._parser.reset()
            behind = self._world.advance(monotonic())

    def _reply(self, end: int, received: bytes) -> None:
        faults = self._world.faults
        for instruction in self._parser.feed(received):
            with self._world.lock:
                answers = self._bus.handle(instruction)
            for number, answer in answers:
                if number in faults.mute:
                    continue
                if faults.slow_s:
                    self._ended.wait(faults.slow_s)
                # A reader that went away leaves a full buffer: what it would have read is lost.
                with suppress(BlockingIOError):
                    os.write(end, self._sent(answer))

    def _sent(self, answer: bytes) -> bytes:
        """As it arrives: with a wrong byte, where the fault strikes."""
        if self._random.random() >= self._world.faults.corrupt:
            return answer
        wrong = bytearray(answer)
        wrong[self._random.randrange(len(wrong))] ^= self._random.randrange(1, 256)
        return bytes(wrong)
