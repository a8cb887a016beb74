"""Closing a drawer or a door: the fingertips push its handle along the way on which its joint lets it move."""

from collections.abc import Iterator

import numpy as np

from jiti.errors import UsageError
from jiti.runtime.sim.demonstrators.motion import CLOSE, Demonstrator
from jiti.runtime.sim.scene import Scene
from jiti.tasks.goal import atoms, parse_goal
from jiti.tasks.rotation import hand_down

TILT_RAD = 0.6
"""How far the hand leans back from the vertical, so that it does not meet the handles above. Our choice."""
BEFORE_M = 0.04
"""Distance from the handle at which the fingers come down. Our choice: the bowl stands 5 cm from a drawer's handle."""
BELOW_EDGE_M = 0.03
"""How far under a door's upper edge the fingertips push. Our choice: the fingers are 4 cm long under the hand."""
LEVER = 0.6
"""Where a door is pushed, as a share of the handle's distance from the hinge. Our choice: the handle begins at 0.73."""
OVER_M = 0.12
"""Height over the push at which the hand arrives. Our choice: over everything that stands on the table."""
AHEAD_M = 0.05
"""How far beyond the handle the hand is sent while it pushes."""
PRESS_STEPS = 16
"""Steps of pushing on, less and less, after the part is shut. Our choice: LIBERO asks for the very end of the way."""
MOST_STEPS = 250
"""Steps after which a push is given up. Our choice: the slowest, of a door, takes about 170."""


class CloseSmoothly(Demonstrator):
    """Careful: one even, gentle push to the end. Careless: a run-up, and the part is slammed."""

    def _run(self) -> Iterator[np.ndarray]:
        random, self.part, self._side = self.random, _part(self.scene), 0
        aside = np.array([*random.uniform(-0.008, 0.008, 2), random.uniform(-0.004, 0.004)])
        local = self.world.handle(self.part) + aside
        if self.world.hinged(self.part):
            local = self._beside_handle(local)
        speed = random.uniform(0.18, 0.26) if self.careful else random.uniform(0.9, 1.0)
        if self.careful and self.world.hinged(self.part):
            speed *= 0.8
        start, way = self._push(local)
        before = start - way * (BEFORE_M + random.uniform(0, 0.01))
        yield from self.go(before + [0, 0, OVER_M], CLOSE, self._hand(way), near_m=0.02, patience=80)
        yield from self.go(before, CLOSE, self._hand(way), steady=True)
        closed = 0
        for _ in range(MOST_STEPS):
            place, way = self._push(local)
            closed += self.scene.holds("Close", self.part)
            if closed == PRESS_STEPS:
                break
            # Once it is shut, less and less: a door that is let go of under pressure springs open.
            ahead = way * AHEAD_M * (1 - 2 * closed / PRESS_STEPS)
            yield self.towards(place + ahead, CLOSE, self._hand(way), speed=speed, steady=True)
        yield from self.go(self.eef - way * 0.06, CLOSE, near_m=0.02, patience=15, speed=0.3, steady=True)
        yield from self.go(self.eef + [0, 0, 0.1], CLOSE, near_m=0.02, patience=20, steady=True)
        yield from self.wait(10, CLOSE)

    def _beside_handle(self, local: np.ndarray) -> np.ndarray:
        """Where a door is pushed: nearer to its hinge than the handle, in which fingers would catch when they leave,
        and at its upper edge, so that the hand passes over the door and over what stands on the table."""
        place, hinge = self.world.carried(self.part, local), self.world.hinge(self.part)
        local = local + self.world.turned_back(self.part, (hinge - place) * np.array([1, 1, 0]) * (1 - LEVER))
        local[2] += self.world.top_m(self.part) - BELOW_EDGE_M - place[2]
        return local

    def _push(self, local: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where the part is pushed now (3,), and the unit vector (3,) along which that point moves when it closes."""
        place = self.world.carried(self.part, local)
        return place, self.world.moves_along(self.part, place)

    def _hand(self, way: np.ndarray) -> np.ndarray:
        """(3, 3): a hand whose fingers stand side by side across the way, and lean towards it."""
        if self.world.hinged(self.part):
            return hand_down(0.0)
        level = np.array([way[0], way[1], 0.0]) / np.linalg.norm(way[:2])
        out = np.sin(TILT_RAD) * level - np.cos(TILT_RAD) * np.array([0, 0, 1.0])
        across = np.cross(np.array([0, 0, 1.0]), level)
        if self._side == 0:  # of the two hands that fit, the nearer one; then it turns with the way and never over
            self._side = 1 if across @ self.eef_rotation[:, 1] >= 0 else -1
        across = across * self._side
        return np.column_stack([np.cross(across, out), across, out])


def _part(scene: Scene) -> str:
    """The drawer's region or the door's fixture that the task's ITC wants closed. Raises UsageError."""
    for itc in scene.task.itcs:
        for atom in atoms(parse_goal(itc.goal)):
            if atom.predicate == "Close":
                return atom.arguments[0]
    raise UsageError(f"{scene.task.task_id} has no ITC that asks for something to be closed")
