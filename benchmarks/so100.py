"""An SO100's loop at 30 Hz while policy and critic are at work beside it, and how often the arm waits for them.

    uv run python benchmarks/so100.py --json figures.json

lerobot's own driver on the virtual arm, recording to MCAP, for a minute each. Policy and critic are arithmetic that
sleeps as long as SmolVLA took (supplement G.6): 112 ms for a chunk of 50 actions, 449 ms for eight; JITI looks at all
eight at every third decision. "short chunks" have 10 actions, which are over before such a decision: there the arm must
wait. Both virtual cameras are there in the lines that say so; this machine's processor renders them in the loop's own
process, which nothing does for real ones.
"""

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path

from bench import Bench
from program import arguments, run
from report import Line

sys.path.insert(0, str(Path(__file__).parents[1]))  # for the agents, which inference's process imports by name

from jiti.runtime.robot.command import run_robot
from jiti.runtime.robot.report import EpisodeSummary, Latency
from jiti.runtime.robot.request import RobotRequest
from jiti.runtime.robot.settings import RobotSettings
from jiti.runtime.robot.virtual import VirtualArm
from jiti.tasks.catalogue import load_catalogue
from tests.builders import robot_agents

TASK = "so100/T4"
PERIOD_P99_MS = 40.0
"""Limit; a step is 33.3 ms."""
KINDS = {
    "none": ("none", robot_agents.smolvla),
    "jiti": ("jiti", robot_agents.smolvla),
    "full": ("full", robot_agents.smolvla),
    "full, short chunks": ("full", robot_agents.ten_actions),
    "none, cameras": ("none", robot_agents.smolvla),
    "jiti, cameras": ("jiti", robot_agents.smolvla),
}


def measure(bench: Bench, asked: argparse.Namespace) -> Iterator[Line]:
    for name in asked.only or KINDS:
        guidance, agent = KINDS[name]
        with bench.folder() as folder, VirtualArm(TASK) as arm:
            cameras = arm.cameras(width=320, height=240) if "cameras" in name else {}
            settings = RobotSettings(port=arm.port, id=arm.id, calibration_dir=str(arm.calibration_dir))
            request = RobotRequest(
                settings, TASK, "policy", "critic", (guidance,), tau=0.5, seconds=bench.count(60, 3), out=folder
            )
            ran = run_robot(request, load_catalogue(), bench.console.print, make_agent=agent, cameras=cameras)
            if ran.problem is not None:
                raise ran.problem
            yield from _lines(name, ran.report.episodes[0])


def _lines(name: str, episode: EpisodeSummary) -> Iterator[Line]:
    short = "short" in name
    period = episode.period_ms
    yield Line(
        name, "period, p50", period.p50 / 1e3, "s", episode.steps, most=period.most / 1e3, least=period.p50 / 1e3
    )
    yield Line(name, "period, p99", period.p99 / 1e3, "s", episode.steps, limit=PERIOD_P99_MS / 1e3)
    yield Line(name, "held", episode.held, "steps", episode.acting, limit=None if short else 0)
    yield Line(name, "looked at candidates", episode.triggered, "decisions", episode.decisions)
    for part, what in (
        ("observe_s", "reading arm and cameras"),
        ("send_s", "sending"),
        ("busy_s", "a step's work"),
        ("sample_s", "policy"),
        ("score_s", "critic"),
        ("round_trip_s", "decision, there and back"),
    ):
        yield from _latency(name, what, episode.parts_ms[part], episode)


def _latency(name: str, what: str, found: Latency, episode: EpisodeSummary) -> Iterator[Line]:
    for share, value in (("p50", found.p50), ("p99", found.p99)):
        yield Line(name, f"{what}, {share}", value / 1e3, "s", episode.steps)


if __name__ == "__main__":
    parser = arguments(__doc__)
    parser.add_argument("--only", choices=KINDS, action="append", help="may be repeated")
    asked = parser.parse_args()
    run(asked, lambda bench: measure(bench, asked))
