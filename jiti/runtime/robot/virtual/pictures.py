"""What a virtual arm's cameras see, drawn by one thread for all of them. MuJoCo lets others run while it renders."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from threading import Condition, Thread
from time import perf_counter

import numpy as np

from jiti.errors import UsageError
from jiti.runtime.robot.virtual.painter import CAMERAS, Painter
from jiti.runtime.robot.virtual.world import Pose
from jiti.runtime.sim.gl import Graphics, find_graphics, use

FIRST_S = 30.0
"""How long a first picture may take. Our choice: to make a GL context takes seconds on a slow machine."""

by_port: dict[str, "Pictures"] = {}
"""Of the virtual arms that are open in this process: a camera's configuration can only hold the name of a port."""


@dataclass(frozen=True, slots=True)
class Picture:
    pixels: np.ndarray
    """(height, width, 3) uint8, RGB."""
    taken_s: float
    """By `time.perf_counter`."""


@dataclass
class _Shot:
    """A camera that is on."""

    width: int
    height: int
    period_s: float
    due_s: float = field(default_factory=perf_counter)
    last: Picture | None = None


class Pictures:
    """The cameras of one task's world; the thread runs while any is on."""

    def __init__(self, task_id: str, pose: Callable[[], Pose]) -> None:
        """`pose` tells how the world is now."""
        self._task_id, self._pose = task_id, pose
        self._changed = Condition()
        self._on: dict[str, _Shot] = {}
        self._thread: Thread | None = None
        self._failure: Exception | None = None

    def start(self, camera: str, *, width: int, height: int, fps: float) -> None:
        """Take pictures with a camera from now on. Raises UsageError where there is no such camera or no GL library."""
        if camera not in CAMERAS:
            raise UsageError(f"the virtual arm has no camera {camera!r}; it has: {', '.join(CAMERAS)}")
        graphics = _graphics()
        if graphics.backend is None:
            raise UsageError(f"the virtual arm's cameras see nothing: {graphics.message}")
        use(graphics.backend)
        with self._changed:
            self._on[camera] = _Shot(width, height, 1 / fps)
            self._changed.notify_all()
            if self._thread is None:
                self._failure = None
                self._thread = Thread(target=self._run, name="virtual cameras", daemon=True)
                self._thread.start()

    def stop(self, camera: str) -> None:
        """Returns, for the last camera, when the thread has let go of GL."""
        with self._changed:
            self._on.pop(camera, None)
            self._changed.notify_all()
            ending = None if self._on else self._thread
        if ending is not None:
            ending.join()
            self._thread = None

    def close(self) -> None:
        for camera in list(self._on):
            self.stop(camera)

    def latest(self, camera: str) -> Picture | None:
        """The last picture; None before the first."""
        return self._on[camera].last

    def after(self, camera: str, moment_s: float, timeout_s: float) -> Picture:
        """The first picture that was taken after a moment of `time.perf_counter`. Raises TimeoutError."""
        shot = self._on[camera]
        with self._changed:
            self._changed.wait_for(
                lambda: self._failure or (shot.last is not None and shot.last.taken_s > moment_s), timeout_s
            )
            if self._failure is not None:
                raise RuntimeError(f"the virtual camera {camera!r} has stopped") from self._failure
            if shot.last is None or shot.last.taken_s <= moment_s:
                raise TimeoutError(f"no picture of the virtual camera {camera!r} in {timeout_s:g} s")
            return shot.last

    def _run(self) -> None:
        painter = None
        try:
            painter = Painter(self._task_id)
            while (next_one := self._next()) is not None:
                camera, shot = next_one
                taken_s = perf_counter()
                pixels = painter.paint(self._pose(), camera, width=shot.width, height=shot.height)
                with self._changed:
                    shot.last = Picture(pixels, taken_s)
                    shot.due_s = max(shot.due_s + shot.period_s, taken_s)
                    self._changed.notify_all()
        except Exception as error:  # told to whoever waits for a picture
            with self._changed:
                self._failure = error
                self._changed.notify_all()
        finally:
            if painter is not None:
                painter.close()

    def _next(self) -> tuple[str, _Shot] | None:
        """Wait until a picture is due; None when no camera is on any more."""
        with self._changed:
            while self._on:
                camera, shot = min(self._on.items(), key=lambda item: item[1].due_s)
                wait_s = shot.due_s - perf_counter()
                if wait_s <= 0:
                    return camera, shot
                self._changed.wait(wait_s)
        return None


@cache
def _graphics() -> Graphics:
    return find_graphics()
