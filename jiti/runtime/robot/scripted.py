"""Who demonstrates on a virtual arm: a hand that moves the arm itself, or a virtual leader."""

from dataclasses import replace
from time import sleep

from jiti.runtime.robot.stops import Stops
from jiti.runtime.robot.virtual import State, VirtualArm
from jiti.runtime.robot.virtual.demonstrator import demonstrate, home

LOOK_S = 0.02


class Scripted:
    """`moved` is the arm that the hand moves, `scene` the one that is to do the task; they may be one."""

    def __init__(self, scene: VirtualArm, moved: VirtualArm, quality: float) -> None:
        self._scene, self._moved, self._quality = scene, moved, quality

    def plan(self, seed: int) -> str:
        """Look at the scene; in which manner the task will be shown."""
        shown = demonstrate(self._scene.task, self._state(), seed, self._quality)
        self._path = shown.path
        return shown.manner

    def begin(self) -> None:
        self._moved.lead(self._path)

    def over(self) -> bool:
        return self._moved.led()

    def go_home(self) -> None:
        self._moved.lead(home(self._state()))

    def wait(self, stops: Stops) -> None:
        """Until the hand is where it was to go. Raises Stopped."""
        while not self._moved.led():
            stops.look()
            sleep(LOOK_S)

    def _state(self) -> State:
        return replace(self._scene.state(), joints=self._moved.state().joints)
