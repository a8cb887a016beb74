"""A virtual SO100 that lerobot's unmodified driver talks to, for tests and for people without an arm.

From the wire inwards:

    line packet servo_bus       the port, what is said there, and who answers
    servo registers faults      one STS3215, its memory, and what can be made to go wrong
    world scenes mjcf/          the arm and the things of Table 7, as MuJoCo moves them
    hand reach demonstrator     who moves it by hand, and how a task is shown
    process                     all of that in a process of its own
    painter pictures            what its cameras see
    arm                         what a program uses, as one `with`
    config_camera camera        lerobot's plugin; importing it imports lerobot
"""

from jiti.runtime.robot.virtual.arm import VirtualArm
from jiti.runtime.robot.virtual.faults import Faults
from jiti.runtime.robot.virtual.world import State

__all__ = ["Faults", "State", "VirtualArm"]
