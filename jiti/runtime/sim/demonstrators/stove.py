"""Turning a stove on by its knob, and putting a pan on it by its handle: in the middle or beside it."""

from collections.abc import Iterator

import numpy as np

from jiti.runtime.sim.demonstrators.motion import CLOSE, OPEN, Demonstrator
from jiti.runtime.sim.world import LEFT, RIGHT
from jiti.tasks.rotation import hand_down

KNOB_RAD = (0.6, 0.8)
"""How far the knob is pushed; LIBERO calls the stove on from 0.5, and the knob is heavy and turns on by itself."""
LEVER_M = 0.036
"""From the knob's axis, which is the stove's origin, to where its bar is pushed; the bar reaches 41 to 52 mm."""
BESIDE_M = 0.022
"""From the bar's middle to that of the closed fingers when they touch: 12 mm of bar and 10 mm of fingers."""
PUSH_M = 0.035
"""How far beyond that they want to be: some 20 N, or the knob takes seconds."""
GRASP_SHARE = (0.5, 0.65)
"""Where the handle is held, between its end and the pan's round."""
OFF_M = (0.032, 0.052)
"""How far off the middle the careless put it: beyond the 20 mm of the ITC, within the 75 mm of LIBERO's `On`."""
ALIGNED_M = 0.003
"""How near to the middle the careful bring it before they lower it."""


class TurnOnAndPlace(Demonstrator):
    """Both ways share the knob, the grasp and the hover; then the careful line the pan up and the others do not."""

    def _run(self) -> Iterator[np.ndarray]:
        self.stove, self.pan = self.scene.interest
        self.cook = next(name for name, owner in self.world.names.regions.items() if owner == self.stove)
        yield from self._turn_on()
        yield from self._take()
        lift_m = self.random.uniform(0.07, 0.10)
        yield from self.go(self.eef + [0, 0, lift_m], CLOSE, self.rotation, near_m=0.01, steady=True, speed=0.6)
        middle, off = self.world.position(self.cook), np.zeros(3)
        rough = [*self.random.normal(0, 0.006, 2), 0]
        yield from self._carry(middle + rough, lift_m, near_m=0.015, steady=False)
        if not self.careful:
            # Not towards the robot, where the knob is.
            angle = self.random.uniform(-1.9, 1.9)
            off = self.random.uniform(*OFF_M) * np.array([np.cos(angle), np.sin(angle), 0])
        yield from self._carry(middle + off, lift_m, near_m=ALIGNED_M if self.careful else 0.006, steady=True)
        yield from self._lower(middle + off)
        yield from self.wait(int(self.random.integers(9, 13)), OPEN)
        yield from self.go(self.eef + [0, 0, self.random.uniform(0.09, 0.13)], OPEN, steady=True)
        yield from self.wait(10, OPEN)

    def _turn_on(self) -> Iterator[np.ndarray]:
        """Push the knob's bar around with closed fingers, by that end of it that lies towards the robot."""
        rotation = self._along_bar()
        top_m = self.world.bounds(self.stove)[1][2]
        tips_m = self.random.uniform(0.024, 0.030)  # below the bar's top
        start = self._beside_bar(-0.015 - self.random.uniform(0, 0.01))
        start[2] = top_m + 0.0092 - tips_m
        yield from self.go(start + [0, 0, self.random.uniform(0.07, 0.10)], CLOSE, rotation, near_m=0.01)
        yield from self.go(start, CLOSE, rotation, near_m=0.004, steady=True, speed=0.5)
        enough_rad = self.random.uniform(*KNOB_RAD)
        for _ in range(120):
            if self.world.joints(self.stove)[0] > enough_rad:
                break
            target = self._beside_bar(PUSH_M)
            target[2] = start[2]
            yield self.towards(target, CLOSE, self._along_bar(), steady=True)
        away = self._beside_bar(-0.02)
        away[2] = start[2] + 0.02
        yield from self.go(away, CLOSE, near_m=0.02, patience=10, steady=True)
        yield from self.go(away + [0, 0, 0.1], OPEN, near_m=0.03, steady=True)

    def _along_bar(self) -> np.ndarray:
        """(3, 3): the hand with the line between its fingers along the bar, so that their flat sides push it."""
        turned = self.world.pose(self.stove)[:3, :3] @ np.array([1, 0, 0])
        return hand_down(np.pi / 2 + np.arctan2(turned[1], turned[0]) + self.world.joints(self.stove)[0])

    def _beside_bar(self, ahead_m: float) -> np.ndarray:
        """(3,) m, at the height of the stove's origin: where the fingers touch the bar, or so far ahead of that."""
        pose = self.world.pose(self.stove)
        angle = np.pi + float(self.world.joints(self.stove)[0])
        out, round_ = np.array([np.cos(angle), np.sin(angle), 0]), np.array([-np.sin(angle), np.cos(angle), 0])
        return pose[:3, 3] + pose[:3, :3] @ (LEVER_M * out + (ahead_m - BESIDE_M) * round_)

    def _take(self) -> Iterator[np.ndarray]:
        """Hold the pan by its handle, which lies along its x axis."""
        share, hover_m = self.random.uniform(*GRASP_SHARE), self.random.uniform(0.07, 0.11)
        for _ in range(3):
            pose, (low, high) = self.world.pose(self.pan), self.world.extent(self.pan)
            along = high[0] + share * (high[1] - high[0])
            place = pose[:3, 3] + pose[:3, :3] @ [along, (low[1] + high[1]) / 2, 0]
            top_m = self.world.floor_m(self.pan, place + [0, 0, 0.2]) or high[2] + pose[2, 3]
            place[2] = top_m - self.random.uniform(0.006, 0.009)
            yaw = float(np.arctan2(pose[1, 0], pose[0, 0]))
            self.rotation = hand_down(yaw % np.pi)  # the line between the fingers lies across the handle
            yield from self.go(place + [0, 0, hover_m], OPEN, self.rotation, near_m=0.01)
            yield from self.go(place, OPEN, self.rotation, near_m=0.004, steady=True, speed=0.5)
            yield from self.wait(int(self.random.integers(11, 15)), CLOSE)
            if self._held():
                return
            yield from self.go(self.eef + [0, 0, 0.05], OPEN, near_m=0.02, steady=True)

    def _held(self) -> bool:
        return self.world.touching(LEFT, self.pan) and self.world.touching(RIGHT, self.pan)

    def _carry(self, place: np.ndarray, lift_m: float, *, near_m: float, steady: bool) -> Iterator[np.ndarray]:
        """Bring the pan's origin over a place, at the height that it was lifted to over what it stands on next."""
        height_m = self.eef[2]
        for _ in range(3):
            hand = self.eef + place - self.world.position(self.pan)
            hand[2] = height_m
            if np.linalg.norm(hand - self.eef) < near_m:
                return
            yield from self.go(hand, CLOSE, self.rotation, near_m=near_m, patience=50, steady=steady)

    def _lower(self, place: np.ndarray) -> Iterator[np.ndarray]:
        """Down until it stands, kept over the place."""
        for _ in range(60):
            if self.world.touching(self.pan, self.stove):
                return
            target = self.eef + place - self.world.position(self.pan)
            target[2] = self.eef[2] - 0.012
            yield self.towards(target, CLOSE, self.rotation, steady=True)
