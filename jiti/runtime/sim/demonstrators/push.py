"""Sliding a plate over the table to a region, past what stands in the way or, without care, through it."""

from collections.abc import Iterator

import numpy as np

from jiti.runtime.sim.demonstrators.motion import OPEN, Demonstrator
from jiti.runtime.sim.scene import STEP_M
from jiti.runtime.sim.world import LEFT
from jiti.tasks.rotation import hand_down

PRESS_M = 0.003
"""How far below the plate's floor the fingertip wants to be: a newton at most. With none the finger tips the plate,
which weighs 12 g, over the foot that it stands on; with much it drags on the table and the finger slips."""
FLOAT_M = 0.008
"""How far above the floor the fingertip moves to another place within the plate; the rim is some 10 mm high."""
PUT_DOWN_M = 0.018
"""The same as it is set down, which must be more than the joints' friction holds up."""
BEHIND_M = 0.016
"""Where it begins to push, behind the plate's middle: it creeps forwards by some 2 cm on the way, the floor has 6."""
TIPPED_RAD = 0.08
"""By how much the plate may tip before the finger, which then climbs the rim, is set anew."""
TURN_RAD = 0.8
"""By how much the way may turn before it is set anew."""
SWING_RAD = 0.02
"""By how much the hand swings around its finger in a step."""
BESIDE_RAD, CORNER_RAD, LAST_RAD = 1.9, 2.6, 2.0
"""Where the hand is from the finger, from the x axis: beside what is gone around, past it, at the corner of the way,
which the robot can just reach, and at the end, beside the stove."""
BACK_M = 0.08
"""How far from the end it begins to swing back."""
BACK_SPEED = 0.2
"""Greatest length of an action towards the robot: the arm is nearly straight, and a quick pull lifts the hand."""
CARROT_M = 0.03
"""How far ahead on its line the plate is sent at any time."""
LEAST_M = 0.010
"""Of the way asked for at once: less does not overcome the friction of plate and joints."""
TIP_M = 0.046
"""From the middle of the open hand to the middle of a fingertip: robosuite's Panda gripper."""
ROUND_M = (0.009, 0.018)
"""How far the careful keep the plate from what they go around."""
CUT_M = (0.011, 0.024)
"""By how much the careless run it over what stands there, which may move by 5 mm; with more it rides up on that."""
OVER_M = 0.012
"""How far the plate goes beyond its corner: it is dragged back as the finger is set anew."""
INSIDE_M = 0.004
"""How far inside the region the plate's origin must come to lie; sliding ends 3 mm from where it should."""
TRIES = 3
"""Times that the finger is set into the plate; where it slips, the plate is left short of its end."""
VIA_M, END_M = 0.012, 0.003
"""How far short of where it passes, and of the corner and the end of its way, the plate may be left."""


class PushPlate(Demonstrator):
    """Sets one finger into the plate and pushes it over the table, the hand beside it and away from other things."""

    def _run(self) -> Iterator[np.ndarray]:
        self.plate, self.region = self.scene.interest
        low, high = self.world.extent(self.plate)
        self.radius = float((high - low)[:2].max()) / 2
        beside, *_ = *vias, end = self._way()
        speed = self.temper.speed * self.random.uniform(0.35, 0.55)
        for _ in range(TRIES):
            yield from self._enter(self._ahead((*vias, end)[0])[0])
            start = self.world.position(self.plate)[:2]
            for place in (*vias, end):
                yield from self._slide(start, place, VIA_M if place is beside else END_M, speed)
                start = place
            yield from self.wait(int(self.random.integers(1, 5)), OPEN)
            yield from self.go(self.eef + [0, 0, self.random.uniform(0.09, 0.14)], OPEN, steady=True)
            if self.scene.holds("On", self.plate, self.region):
                break
            left_m = self._ahead(end)[1]
            vias = [via for via in vias if np.linalg.norm(end - via) < left_m - VIA_M]  # those still before it
        yield from self.wait(10, OPEN)

    def _enter(self, ahead: np.ndarray) -> Iterator[np.ndarray]:
        """Bring the open hand beside the plate, on the robot's left, and the finger on its right into the plate."""
        self.angle_rad = np.pi / 2 + self.random.uniform(-0.2, 0.1)
        outward = np.array([np.cos(self.angle_rad), np.sin(self.angle_rad), 0])
        rotation = self._beside(self.angle_rad)
        middle = self.world.position(self.plate)
        middle[2] = self.world.floor_m(self.plate, middle + [0, 0, 0.1]) or middle[2]
        above = middle + outward * TIP_M + [0, 0, self.random.uniform(0.09, 0.13)]
        yield from self.go(above, OPEN, rotation, near_m=0.01)
        place = middle + self.eef - self._finger() - [*ahead * BEHIND_M, 0]
        yield from self.go(place + [0, 0, 0.03], OPEN, rotation, near_m=0.004, steady=True, speed=0.5)
        self.floor_m, self.ahead, self.swing_to_rad = float(place[2]), ahead, BESIDE_RAD
        yield from self.go(place, OPEN, rotation, near_m=0.003, patience=25, steady=True, speed=0.3)

    def _finger(self) -> np.ndarray:
        """(3,) m: the middle of the underside of the fingertip that goes into the plate."""
        tip = self.eef + TIP_M * self.eef_rotation[:, 1]
        tip[2] = self.world.lowest_m(LEFT)
        return tip

    def _slide(self, start: np.ndarray, place: np.ndarray, near_m: float, speed: float) -> Iterator[np.ndarray]:
        """Push the plate along the line from a start to a place, (2,) m each, and back to that line where it strays."""
        length_m = float(np.linalg.norm(place - start))
        line = (place - start) / max(length_m, 1e-9)
        before, self.ahead = self.ahead, line
        if before @ self.ahead < np.cos(TURN_RAD):
            yield from self._set_anew(self.ahead)
        for _ in range(160):
            along_m = float((self.world.position(self.plate)[:2] - start) @ line)
            left_m = length_m - along_m
            if left_m < near_m:
                return
            self.ahead = self._ahead(start + line * min(along_m + CARROT_M, length_m))[0]
            if self.world.position(self.plate)[1] > self.passed_m:
                self.swing_to_rad = LAST_RAD if self.ahead[0] < -0.5 and left_m < BACK_M else CORNER_RAD
            offset = self._offset()
            if self.world.rotation(self.plate)[2, 2] < np.cos(TIPPED_RAD):
                yield from self._set_anew(self.ahead)
            # The press is not to be scaled down with the way, so that is cut here.
            most_m = (speed + (BACK_SPEED - speed) * max(0.0, -self.ahead[0])) * STEP_M / self.temper.gain
            aside = offset - offset @ self.ahead * self.ahead
            yield self._move_finger(self.ahead * min(max(left_m, LEAST_M), most_m) - aside, self.floor_m - PRESS_M)

    def _offset(self) -> np.ndarray:
        """(2,) m: the finger from the plate's middle."""
        return (self._finger() - self.world.position(self.plate))[:2]

    def _move_finger(self, way: np.ndarray, height_m: float) -> np.ndarray:
        """One action that moves the finger by (2,) m, while the hand turns about it towards the robot, which reaches no
        further than the corner of the way."""
        self.angle_rad += float(np.clip(self.swing_to_rad - self.angle_rad, -SWING_RAD, SWING_RAD))
        rotation = self._beside(self.angle_rad)
        finger = self._finger()
        beside = rotation @ self.eef_rotation.T @ (self.eef - finger)
        target = finger + beside + [*way, 0]
        target[2] = height_m
        return self.towards(target, OPEN, rotation, speed=1.0, steady=True)

    @staticmethod
    def _beside(angle_rad: float) -> np.ndarray:
        """(3, 3): the hand at an angle from the finger, seen from above."""
        return hand_down(angle_rad - np.pi / 2)

    def _set_anew(self, ahead: np.ndarray) -> Iterator[np.ndarray]:
        """Lift the finger off the floor and set it down again behind the plate's middle."""
        for _ in range(10):
            if not self.world.touching(LEFT, self.plate):
                break
            yield self._move_finger(np.zeros(2), self.floor_m + 2 * FLOAT_M)
        for height_m, near_m in ((FLOAT_M, 0.004), (-PUT_DOWN_M, 0.0)):
            for _ in range(30):
                way = -BEHIND_M * ahead - self._offset()
                if np.linalg.norm(way) < near_m or (height_m < 0 and self.world.touching(LEFT, self.plate)):
                    break
                yield self._move_finger(way, self.floor_m + height_m)

    def _ahead(self, place: np.ndarray) -> tuple[np.ndarray, float]:
        """(2,): the direction in which the plate is to go, and how far in m."""
        left = place - self.world.position(self.plate)[:2]
        left_m = float(np.linalg.norm(left))
        return left / max(left_m, 1e-9), left_m

    def _way(self) -> list[np.ndarray]:
        """Around the corner of what stands before the region, on the side away from the other things, or through it."""
        low, high = self.world.bounds(self._obstacle())
        end = self._clearest_place()
        apart = self.random.uniform(*ROUND_M) if self.careful else -self.random.uniform(*CUT_M)
        beside = high[0] + self.radius + apart
        self.passed_m = high[1] - 0.02
        return [np.array([beside, low[1]]), np.array([beside, end[1] + OVER_M]), end]

    def _obstacle(self) -> str:
        """What the plate would come nearest to on the straight way."""
        start, end = self.world.position(self.plate)[:2], self.world.position(self.region)[:2]
        way = end - start

        def apart_m(name: str) -> float:
            share = np.clip((self.world.position(name)[:2] - start) @ way / (way @ way), 0, 1)
            return float(np.linalg.norm(self.world.position(name)[:2] - start - share * way))

        return min((n for n in self.world.names.objects if n != self.plate), key=apart_m)

    def _clearest_place(self) -> np.ndarray:
        """(2,) m: somewhere in the region with room around the plate, or where there is most."""
        low, high = (corner[:2] for corner in self.world.bounds(self._obstacle()))
        middle, half = self.world.position(self.region)[:2], self.world.half_size(self.region)[:2] - INSIDE_M
        places = middle + self.random.uniform((-0.2, -1), 1, (200, 2)) * half
        places = np.concatenate([places, middle + half * [[-0.2, 1], [1, 1]]])
        room = np.linalg.norm(np.maximum(0, np.maximum(low - places, places - high)), axis=1) - self.radius
        enough = np.flatnonzero(room > self.random.uniform(*ROUND_M))
        # Of places that are as tight, the one that is reached first.
        return places[enough[0] if len(enough) else int(np.argmax(room + 0.05 * places[:, 0]))]
