"""A world with its line in a process of its own, so that nothing its user's program does keeps a packet waiting.

In the user's process, a policy at work or lerobot's own waiting loop would hold the interpreter that is to answer. With
four other programs on two cores lerobot then missed one answer in 200; of 360 from another process, none.
"""

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection, Pipe
from pathlib import Path
from threading import Lock
from typing import Any

from jiti.runtime.robot.virtual.faults import Faults
from jiti.runtime.robot.virtual.hand import Path as HandPath
from jiti.runtime.robot.virtual.line import Line
from jiti.runtime.robot.virtual.registers import Memory
from jiti.runtime.robot.virtual.world import Pose, State, World

END_S = 10.0
"""How long it may take to end. Our choice: it does so at once, when its machine gets to it."""
_CHILD = f"import sys; from {__name__} import main; main(*sys.argv[1:])"


class ArmProcess:
    """The side of the user; its methods may be called from any thread."""

    def __init__(self, task_id: str, seed: int, link: Path) -> None:
        """Serves the servos at `link` until `close`. Raises what `World` raises."""
        self._lock = Lock()
        self._pipe, theirs = Pipe()
        self._child = subprocess.Popen(
            [sys.executable, "-c", _CHILD, task_id, str(seed), str(link), str(theirs.fileno())],
            env=os.environ | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
            stdin=subprocess.DEVNULL,
            pass_fds=[theirs.fileno()],
        )
        theirs.close()
        try:
            self._receive()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        self._pipe.close()
        try:
            self._child.wait(END_S)
        except subprocess.TimeoutExpired:
            self._child.kill()
            self._child.wait()

    def state(self) -> State:
        return self._ask("state")

    def pose(self) -> Pose:
        return self._ask("pose")

    def memories(self) -> dict[int, Memory]:
        """What is in the servos' registers, by their first ids."""
        return self._ask("memories")

    def reset(self, seed: int) -> None:
        self._ask("reset", seed)

    def lead(self, path: HandPath) -> None:
        self._ask("lead", path)

    def led(self) -> bool:
        return self._ask("led")

    def set_faults(self, faults: Faults) -> None:
        self._ask("set_faults", faults)

    def _ask(self, name: str, *arguments: Any) -> Any:
        with self._lock:
            with suppress(BrokenPipeError):  # told by what is received
                self._pipe.send((name, arguments))
            return self._receive()

    def _receive(self) -> Any:
        try:
            answer, error = self._pipe.recv()
        except (EOFError, ConnectionError):
            raise RuntimeError(f"the virtual arm's process has ended with {self._child.wait()}") from None
        if error is not None:
            raise error
        return answer


URGENT = -15
"""Niceness. Servos answer whatever the computer is at, and lerobot waits 50 ms for them: where this user may, the arm
goes before other programs. It takes a tenth of a core."""


def main(task_id: str, seed: str, link: str, descriptor: str) -> None:
    """The side of the arm: ends when the other one closes the pipe, or is no more."""
    # Whoever ends a program may send it to every process of it; this one goes on until the arm has no torque.
    for number in (signal.SIGINT, signal.SIGQUIT, signal.SIGTSTP, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    with suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, 0, URGENT)
    pipe = Connection(int(descriptor))
    try:
        world = World(task_id, seed=int(seed))
    except Exception as error:
        pipe.send((None, error))
        return
    line = Line(world, Path(link))
    line.start()
    with suppress(EOFError, OSError):
        _serve(pipe, world)
    line.close()


def _serve(pipe: Connection, world: World) -> None:
    answers: dict[str, Callable[..., Any]] = {
        "state": world.state,
        "pose": world.pose,
        "memories": lambda: {number: servo.memory for number, servo in world.servos.items()},
        "reset": world.reset,
        "lead": world.lead,
        "led": world.led,
        "set_faults": lambda faults: setattr(world, "faults", faults),
    }
    pipe.send((None, None))
    while True:
        name, arguments = pipe.recv()
        with world.lock:
            pipe.send((answers[name](*arguments), None))
