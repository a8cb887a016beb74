"""One STS3215 of 7.4 V: what its registers make the motor do, and what it measures.

It follows a goal with a limited acceleration and speed, as a spring with a damper whose torque has a limit. Without
torque only the friction of its gears is left. Position mode is all there is of its four modes.
"""

from dataclasses import dataclass
from math import copysign, pi, sqrt

from jiti.runtime.robot.virtual import registers as r

STEP_RAD = 2 * pi / r.STEPS
STALL_NM = 1.91
"""19.5 kg cm at 7.4 V. Feetech's data of the STS3215, as sellers of the DFRobot SER0069 give them."""
FASTEST = 52 / 60 * r.STEPS
"""Steps/s without load: 52 turns a minute at 7.4 V, of the same data."""
DRAG = STALL_NM / (FASTEST * STEP_RAD)
"""N m s/rad: a motor's torque falls in a line from the stall to its speed without load."""
STIFFNESS_OF_P = 1.2
"""N m/rad for one unit of the P coefficient: 1.47 N m turned a servo as it comes, with P 32, by 1.8 to 2.6 degrees in
https://github.com/TheRobotStudio/SO-ARM100/issues/134."""
DAMPING_OF_D = 0.04
"""N m s/rad for one unit of the D coefficient. Our choice: with lerobot's P 16 and D 32 no joint overshoots."""
STALL_A = 2.5
"""Current at stall. Our choice: Feetech gives 2.7 A for the 12 V model."""
UNLIMITED = 1e9
"""Steps/s2 that stand for no limit: up to speed, and down from it, in one step of any length."""
MOVING_FROM = 20
"""Steps/s from which it says that it moves. Our choice."""


@dataclass(frozen=True, slots=True)
class Drive:
    """What the motor does until it is asked again."""

    target_rad: float
    """Angle of the joint that it pulls to."""
    stiffness: float
    """N m/rad."""
    damping: float
    """N m s/rad."""
    limit_nm: float
    """Greatest torque; 0 when the torque is off."""


class Servo:
    """A servo that turns one joint; angles are those of the joint."""

    def __init__(self, servo: int, *, low_rad: float, high_rad: float, mount: int, full_turn: bool = False) -> None:
        """`mount`: steps from the middle of the encoder to the middle of the joint, as the horn was screwed on.

        Its limits and its offset are as lerobot's calibration would leave them: the joint's middle is step 2047, and a
        joint that turns all the way round has the whole range.
        """
        self.memory = r.Memory(servo)
        self._mount = mount
        self._middle_rad = (low_rad + high_rad) / 2
        half = 0 if full_turn else round((high_rad - low_rad) / 2 / STEP_RAD)
        self.memory[r.OFFSET] = mount + 1
        self.memory[r.MIN_POSITION] = 0 if full_turn else r.STEPS // 2 - 1 - half
        self.memory[r.MAX_POSITION] = r.STEPS - 1 if full_turn else r.STEPS // 2 - 1 + half
        self._angle_rad = self._middle_rad
        self._powered = False
        self._at = self._speed = 0.0  # of the target on its way to the goal, in the joint's steps and steps/s
        self._strained_s, self._overloaded = 0.0, False

    def power_up(self, angle_rad: float) -> None:
        """Begin at an angle, which is its goal until there is another."""
        self.measure(angle_rad, 0.0, 0.0, 0.0)
        self.memory[r.GOAL_POSITION] = self.memory[r.PRESENT_POSITION]

    def write(self, address: int, values: bytes) -> None:
        """Set bytes of its memory; a new offset shows at once in the position."""
        self.memory.write(address, values)
        self._show_position()

    @property
    def error(self) -> r.Error:
        """The bits that its status packets carry."""
        return r.Error(self.memory[r.STATUS])

    def measure(
        self, angle_rad: float, speed_rad_s: float, torque_nm: float, dt_s: float, *, weak: bool = False
    ) -> None:
        """Set what it reports, and watch for an overload: too much torque for too long, until the torque is turned off.

        `weak`: overloaded now, whatever the torque.
        """
        memory, self._angle_rad = self.memory, angle_rad
        self._show_position()
        memory[r.PRESENT_VELOCITY] = round(speed_rad_s / STEP_RAD)
        load = torque_nm / STALL_NM
        memory[r.PRESENT_LOAD] = round(1000 * load)
        memory[r.PRESENT_CURRENT] = round(abs(load) * STALL_A / 0.0065)
        memory[r.MOVING] = int(abs(speed_rad_s) > MOVING_FROM * STEP_RAD)
        strained = abs(load) >= memory[r.OVERLOAD_TORQUE] / 100
        self._strained_s = self._strained_s + dt_s if strained else 0.0
        too_long = self._strained_s >= memory[r.PROTECTION_TIME] / 100
        self._overloaded = bool(memory[r.TORQUE_ENABLE]) and (self._overloaded or too_long)
        memory[r.STATUS] = r.Error.OVERLOAD if weak or self._overloaded else 0

    def drive(self, angle_rad: float, dt_s: float) -> Drive:
        """Move the target on towards the goal, and say how the motor pulls to it."""
        memory = self.memory
        if not memory[r.TORQUE_ENABLE]:
            self._powered = False
            return Drive(angle_rad, 0.0, 0.0, 0.0)
        if not self._powered:
            self._powered, self._at, self._speed = True, angle_rad / STEP_RAD, 0.0
        self._approach(dt_s)
        share = min(memory[r.MAX_TORQUE], memory[r.TORQUE_LIMIT]) / 1000
        if r.Error.OVERLOAD in self.error:
            share = min(share, memory[r.PROTECTIVE_TORQUE] / 100)
        stiffness = STIFFNESS_OF_P * memory[r.P_COEFFICIENT]
        return Drive(self._at * STEP_RAD, stiffness, DAMPING_OF_D * memory[r.D_COEFFICIENT], share * STALL_NM)

    def _approach(self, dt_s: float) -> None:
        memory = self.memory
        left = self._goal() - self._at
        fastest = min(abs(memory[r.GOAL_VELOCITY]) or FASTEST, FASTEST)
        change = (100 * memory[r.ACCELERATION] or UNLIMITED) * dt_s  # of the speed, in one step
        # From this speed it still stops at the goal when each step takes `change` off it.
        stoppable = sqrt((change / 2) ** 2 + 2 * change / dt_s * abs(left)) - change / 2
        wish = copysign(min(fastest, stoppable, abs(left) / dt_s), left)
        self._speed = min(max(wish, self._speed - change), self._speed + change)
        self._at += self._speed * dt_s

    def _goal(self) -> float:
        """In the joint's steps, within the limits of the servo."""
        memory = self.memory
        goal = min(max(memory[r.GOAL_POSITION], memory[r.MIN_POSITION]), memory[r.MAX_POSITION])
        from_middle = goal + memory[r.OFFSET] - r.STEPS // 2 - self._mount
        return self._middle_rad / STEP_RAD + (from_middle + r.STEPS // 2) % r.STEPS - r.STEPS // 2

    def _show_position(self) -> None:
        encoder = r.STEPS // 2 + self._mount + round((self._angle_rad - self._middle_rad) / STEP_RAD)
        position = encoder % r.STEPS - self.memory[r.OFFSET]
        counts_turns = self.memory[r.PHASE] & 0x10
        self.memory[r.PRESENT_POSITION] = position if counts_turns else position % r.STEPS
