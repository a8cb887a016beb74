"""One process a port. lerobot opens a port that another program has open, and both then read half of the answers."""

import fcntl
import os
import termios

from jiti.errors import RobotError


class PortLock:
    """Held from when it is made until `release`; the system lets go of it when the process ends, however it ends."""

    def __init__(self, port: str) -> None:
        """Raises RobotError where there is no port, it may not be opened, or another process has it."""
        self._descriptor: int | None = None
        try:
            self._descriptor = os.open(port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
        except OSError as error:
            raise RobotError(_why(port, error)) from error
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            self.release()
            raise RobotError(f"another program drives the arm at {port}. End it first, or pass another port.") from None

    def exclude(self) -> None:
        """Keep out programs that ask for no lock, from now on; the arm's own driver has the port open by then."""
        assert self._descriptor is not None
        fcntl.ioctl(self._descriptor, termios.TIOCEXCL)

    def release(self) -> None:
        """Once is enough, and twice does no harm."""
        if self._descriptor is not None:
            descriptor, self._descriptor = self._descriptor, None
            os.close(descriptor)


def _why(port: str, error: OSError) -> str:
    if isinstance(error, FileNotFoundError):
        return f"there is no {port}. Plug the arm in and switch its power on; `lerobot-find-port` tells its name."
    if isinstance(error, PermissionError):
        return (
            f"{port} may not be opened: add yourself to its group (`sudo usermod -aG dialout $USER`), and log in again."
        )
    return f"{port} cannot be opened: {error.strerror}. End other programs that use the arm, or pass another port."
