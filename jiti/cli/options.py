"""Arguments and options that several commands share, and the words that may stand behind them."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer


class ProposalSource(StrEnum):
    """Who proposes segments."""

    sim = "sim"
    signal = "signal"


class Stage(StrEnum):
    """What a model is asked."""

    itcs = "itcs"
    segments = "segments"
    verdicts = "verdicts"


class Unlabelled(StrEnum):
    """What becomes of episodes without labels."""

    leave = "leave"
    keep = "keep"


class VideoCodec(StrEnum):
    """How videos are encoded."""

    h264 = "h264"
    hevc = "hevc"
    av1 = "av1"


class Engine(StrEnum):
    """Where episodes are worked on."""

    local = "local"
    ray = "ray"


class Start(StrEnum):
    """Where episodes in simulation begin."""

    jitter = "jitter"
    file = "file"
    sampled = "sampled"


class Arm(StrEnum):
    """Arms that a policy can be played on."""

    so100 = "so100"
    so101 = "so101"


class PickRank(StrEnum):
    """Which candidate is taken, by the critic's value."""

    best = "best"
    median = "median"
    worst = "worst"
    random = "random"


Source = Annotated[
    str | None,
    typer.Argument(help="An MCAP file, a folder of them, a LeRobot folder or Hub id. Default: the current folder."),
]
Tasks = Annotated[
    list[Path] | None,
    typer.Option("--tasks", help="A TOML file with your tasks and ITCs; may be repeated. Default: tasks.toml there."),
]
Labels = Annotated[Path | None, typer.Option("--labels", help="Folder of the labels. Default: beside the recordings.")]
Annotator = Annotated[str | None, typer.Option("--annotator", help="Who labels. Default: your login name.")]
Assets = Annotated[
    str | None, typer.Option("--assets", help="Asset pack: primitive (the default), libero, or a folder.")
]
Port = Annotated[
    int, typer.Option("--port", min=0, max=65535, show_default=False, help="Port on 127.0.0.1. Default: any free one.")
]
NoBrowser = Annotated[bool, typer.Option("--no-browser", help="Print the address, open nothing.")]
ArmPort = Annotated[
    str | None, typer.Option("--port", help="Of the arm: /dev/ttyACM0, or virtual for a simulated one.")
]
RobotId = Annotated[
    str | None, typer.Option("--robot-id", help="By which lerobot knows its calibration. Default: follower.")
]
RobotConfig = Annotated[
    Path | None, typer.Option("--robot-config", help="A TOML file with the arm, its cameras and limits.")
]
Json = Annotated[bool, typer.Option("--json", help="Print JSON for scripts.")]
