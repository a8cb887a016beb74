"""`jiti curate`, whole: from what a user asked for to what is printed."""

import json
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Literal

from jiti.curate.export.build import Output, build
from jiti.curate.export.card import dataset_card
from jiti.curate.export.codec import Codec, Name
from jiti.curate.export.counted import MAJORITY, Rule
from jiti.curate.export.curated import Added, Curated
from jiti.curate.export.features_file import read_features
from jiti.curate.export.filter import Filter
from jiti.curate.export.held_out import Dealt, splits_file
from jiti.curate.export.plan import Choice, Plan, make_plan
from jiti.curate.export.show_features import show_features
from jiti.curate.export.sources import Source, open_sources
from jiti.curate.export.split import DEFAULT, parse_shares
from jiti.curate.export.weights import WEIGHTS_FILE
from jiti.curate.report import report_on
from jiti.curate.returns import GAMMA
from jiti.episodes.lerobot_info import INFO_PATH
from jiti.episodes.lerobot_reader import LeRobotReader
from jiti.errors import UsageError
from jiti.progress import Progress

Unlabelled = Literal["leave", "keep"]
Weigh = Callable[[Path, Progress], Path]
"""Writes weights into a dataset and says where they are: a critic's, which stands above this package."""


@dataclass(frozen=True, slots=True)
class Request:
    """What a user asked for."""

    sources: tuple[str, ...] = ()
    """Empty for the current folder."""
    out: Path | None = None
    labels: tuple[Path, ...] = ()
    tasks: tuple[Path, ...] = ()
    rule: str = MAJORITY
    accept: tuple[str, ...] = ()
    unlabelled: Unlabelled = "leave"
    features: Path | None = None
    fps: int | None = None
    condition: str | None = None
    split: str | None = None
    """Shares. Where this, the seed and `unseen` are all left out, a dataset of jiti keeps its splits."""
    seed: int | None = None
    unseen: tuple[str, ...] = ()
    gamma: float = GAMMA
    codec: Name | None = None
    crf: int | None = None
    weights: bool = False
    report: bool = False
    overwrite: bool = False

    def check_out(self) -> Path:
        """The place of the dataset. Raises UsageError where there is none, or something that must not be replaced."""
        if self.out is None:
            raise UsageError("jiti curate needs a place for the dataset: pass --out DATASET.")
        out = self.out.absolute()
        for source in self.sources or (".",):
            path = Path(source).expanduser()
            if path.exists() and (inside := path.resolve()) and (out == inside or out in inside.parents):
                raise UsageError(f"--out {self.out} holds the source {source}; name another folder.")
        if not out.exists():
            return out
        if not out.is_dir() or (any(out.iterdir()) and not (out / INFO_PATH).is_file()):
            raise UsageError(f"--out {self.out} exists and is no dataset; name another folder.")
        if any(out.iterdir()) and not self.overwrite:
            raise UsageError(f"--out {self.out} exists. Pass --overwrite to replace it, or name another folder.")
        return out


@dataclass(frozen=True, slots=True)
class Prepared:
    """A request, looked at and planned; nothing is written yet."""

    request: Request
    out: Path
    sources: Sequence[Source]
    plan: Plan
    codec: Codec | None
    about: Mapping[str, Any] = field(default_factory=dict)


def run(
    request: Request, progress: Progress = lambda _share, _what: None, weigh: Weigh | None = None
) -> "Curated | Added":
    """Make the dataset, or add a report or a critic's weights to one. Raises JitiError.

    Where it was to be made and could not be, nothing is at `--out`.
    """
    if request.out is None and (request.report or weigh):
        if len(request.sources) != 1:
            flag = "--report" if request.report else "--weights-from RUN"
            raise UsageError(f"{flag} without --out is of one dataset: jiti curate {flag} DATASET.")
        return _add(Path(request.sources[0]), request, weigh, progress)
    share = 0.8 if weigh else 1.0
    done = curate(request, lambda part, what: progress(share * part, what))
    added = _add(done.out, request, weigh, lambda part, what: progress(share + (1 - share) * part, what))
    return replace(done, weights=added.weights or done.weights, report=added.report)


def _add(dataset: Path, request: Request, weigh: Weigh | None, progress: Progress) -> Added:
    weights = weigh(dataset, progress) if weigh else None
    return Added(weights, report_on(dataset) if request.report else None)


def curate(request: Request, progress: Progress = lambda _share, _what: None) -> Curated:
    """Make the dataset. Raises JitiError; then nothing is at `--out` that was not there before."""
    return write(prepare(request, lambda share, what: progress(0.2 * share, what)), progress)


def prepare(request: Request, progress: Progress = lambda _share, _what: None) -> Prepared:
    """Open all sources and plan the dataset. Raises JitiError."""
    out = request.check_out()
    codec = Codec(request.codec or "h264", request.crf) if request.codec or request.crf is not None else None
    rule = Rule(request.rule, request.accept)
    choice = Choice(
        rule=str(rule),
        gamma=request.gamma,
        fps=request.fps,
        codec=codec,
        keep_unlabelled=request.unlabelled == "keep",
        features=read_features(request.features) if request.features else None,
        condition=Filter(request.condition) if request.condition else None,
        dealt=Dealt(
            parse_shares(request.split) if request.split is not None else DEFAULT,
            request.seed or 0,
            request.unseen,
            anew=request.split is not None or request.seed is not None or bool(request.unseen),
        ),
    )
    sources = open_sources(request.sources, labels=request.labels, tasks=request.tasks or None, rule=rule)
    plan = make_plan(sources, choice, progress)
    return Prepared(request, out, sources, plan, codec, _about(request, choice, sources, plan))


def write(prepared: Prepared, progress: Progress = lambda _share, _what: None) -> Curated:
    """Write a planned dataset. Raises SourceError, SaveFailed."""
    plan, out = prepared.plan, prepared.out
    output = Output(
        root=out,
        gamma=prepared.request.gamma,
        about=prepared.about,
        card=dataset_card(plan, out.name, prepared.about),
        codec=prepared.codec,
        robot=_robot(prepared.sources),
        weights=prepared.request.weights,
    )
    notes = build(plan, prepared.sources, output, lambda share, what: progress(0.2 + 0.8 * share, what))
    rewards = [episode.reward for episode in plan.episodes if episode.reward is not None]
    return Curated(
        out=prepared.request.out or out,
        episodes=len(plan.episodes),
        frames=sum(episode.frames for episode in plan.episodes),
        fps=plan.fps,
        elegant=sum(rewards),
        judged=len(rewards),
        splits=dict(Counter(episode.split for episode in plan.episodes)),
        unlabelled=plan.unlabelled,
        filtered=plan.filtered,
        splits_kept=plan.splits_kept,
        splits_anew=tuple(s.name for s in prepared.sources if splits_file(s) and s.name not in plan.splits_kept),
        notes=(*plan.notes, *notes),
        weights=out / WEIGHTS_FILE if prepared.request.weights else None,
    )


def print_features(request: Request, progress: Progress = lambda _share, _what: None) -> str:
    """The mapping of the first recording that can be opened, as a file to begin from. Raises JitiError."""
    sources = open_sources(
        request.sources, labels=request.labels, tasks=request.tasks or None, rule=Rule(request.rule, request.accept)
    )
    return show_features(sources, progress)


def _about(request: Request, choice: Choice, sources: Sequence[Source], plan: Plan) -> dict[str, Any]:
    """For `meta/jiti/curate.json`: everything that made the dataset what it is, and no time or machine."""
    mapping = {
        feature.key: {
            name: value for name, value in asdict(feature).items() if name != "key" and value not in ((), None, False)
        }
        for feature in plan.episodes[0].features
    }
    return {
        "format": 1,
        "gamma": request.gamma,
        "rule": choice.rule,
        "fps": plan.fps,
        "digest": plan.digest,
        "sources": [source.name for source in sources],
        "features": mapping,
        "options": {
            "rule": request.rule,
            "accept": list(request.accept),
            "unlabelled": request.unlabelled,
            "resampled": plan.resampled,
            "filter": request.condition,
            "split": list(choice.dealt.shares),
            "seed": choice.dealt.seed,
            "unseen": list(request.unseen),
            "splits_kept": list(plan.splits_kept),
            "codec": asdict(choice.codec) if choice.codec else None,
            "weights": request.weights,
        },
        "left_out": {"unlabelled": plan.unlabelled, "filtered": plan.filtered},
        "versions": {name: _version(name) for name in ("jiti", "av", "numpy", "pyarrow")},
    }


def _version(package: str) -> str:
    if package == "jiti":
        from jiti import __version__

        return __version__
    try:
        return version(package)
    except PackageNotFoundError:
        return "unknown"


def _robot(sources: Sequence[Source]) -> str | None:
    """The robot that all sources name, where they are LeRobot datasets of one robot."""
    names = {
        json.loads(source.reader.info.text).get("robot_type") if isinstance(source.reader, LeRobotReader) else None
        for source in sources
    }
    return names.pop() if len(names) == 1 else None
