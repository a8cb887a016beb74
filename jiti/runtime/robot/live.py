"""An episode of an arm in Rerun, while it goes on; kept beside its recording."""

from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path

from jiti.runtime.robot.tick import Tick
from jiti.runtime.rollout.decide import Decided
from jiti.runtime.rollout.drawing import draw_arm, draw_values, live_recording


class LiveArm:
    """Of one thread, which is not the loop's."""

    def __init__(
        self,
        path: Path,
        address: str | None,
        joints: tuple[str, ...],
        cameras: tuple[str, ...],
        tau: float | None,
        *,
        blind: bool = False,
    ) -> None:
        """Kept at `path` in the end; shown meanwhile by the viewer at `address`. `blind`: without the critic's values,
        which would tell the guidance."""
        self._joints, self._tau, self._blind, self._stack = joints, tau, blind, ExitStack()
        opened = live_recording(path.stem, cameras, path, address, joints=joints)
        self._recording = self._stack.enter_context(opened)

    def ticked(self, tick: Tick, pictures: Mapping[str, bytes]) -> None:
        """`pictures` are JPEG files by camera."""
        seen = tick.seen
        joints = {} if seen is None else {name: (float(seen[f"{name}.pos"]), tick.sent[name]) for name in self._joints}
        draw_arm(self._recording, tick.tick, joints, pictures)

    def decided(self, decided: Decided) -> None:
        if not self._blind:
            draw_values(self._recording, decided, self._tau)

    def close(self) -> None:
        """Raises SaveFailed."""
        self._stack.close()
