"""`jiti rollout --robot` with an agent of arithmetic, as a program of its own: to be killed, or to be a second one."""

import sys
from dataclasses import replace
from pathlib import Path

from jiti.errors import JitiError
from jiti.runtime.robot.command import run_robot
from jiti.runtime.robot.request import RobotRequest
from jiti.runtime.robot.settings import RobotSettings
from jiti.runtime.robot.stops import Stopped
from jiti.runtime.robot.virtual import VirtualArm
from jiti.tasks.catalogue import load_catalogue
from tests.builders import robot_agents


def command(arm: VirtualArm, out: Path, *more: str) -> list[str]:
    """The program's command line; `judge` plays two guidances twice, for a person to judge."""
    return [sys.executable, "-m", __spec__.name, arm.port, arm.id, str(arm.calibration_dir), str(out), *more]


def main(port: str, robot: str, calibration_dir: str, out: str, *more: str) -> int:
    settings = RobotSettings(port=port, id=robot, calibration_dir=calibration_dir, release_after_s=0.5)
    request = RobotRequest(settings, task="so100/T2", policy="hub/p", out=Path(out), seconds=600.0)
    if more == ("judge",):
        judged = {"judge": True, "guidance": ("none", "jiti"), "critic": "hub/c", "tau": 0.5, "episodes": 2}
        request = replace(request, task="so100/T5", seconds=1.0, **judged)
    try:
        ran = run_robot(request, load_catalogue(), lambda said: print(said, flush=True), make_agent=robot_agents.quick)
    except Stopped as stopped:
        print(stopped, flush=True)
        return stopped.exit_code
    except JitiError as error:
        print(error, flush=True)
        return 1
    ran.print()
    if isinstance(ran.problem, Stopped):
        return ran.problem.exit_code
    return 1 if ran.problem else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
