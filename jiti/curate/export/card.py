"""README.md of the dataset: what is in it, what people said about it, and where every label comes from."""

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from typing import Any

from jiti.curate.export.plan import Plan
from jiti.curate.export.split import SPLITS, UNSEEN

_FRONT = """---
license: other
task_categories:
- robotics
tags:
- LeRobot
- jiti
- elegance
configs:
- config_name: default
  data_files: data/*/*.parquet
---
"""
"""What the Hub reads, as on lerobot's own cards; the licence is the recordings' and not ours to say."""


def dataset_card(plan: Plan, name: str, about: Mapping[str, Any]) -> str:
    """The card in Markdown."""
    frames = sum(episode.frames for episode in plan.episodes)
    elegant = sum(episode.reward == 1 for episode in plan.episodes)
    judged = sum(episode.reward is not None for episode in plan.episodes)
    lines = [
        f"{_FRONT}# {name}",
        "",
        f"A LeRobot v3 dataset of {len(plan.episodes)} episodes, {frames} frames at {plan.fps} Hz, labelled for how "
        f"the task was done: {elegant} of {judged} judged episodes satisfy all of their constraints.",
        "",
        "## Tasks",
        *_table(("task", "instruction", "episodes", "elegant", "succeeded"), _tasks(plan)),
        "",
        "## Constraints",
        "Episodes by verdict. An episode violates a constraint where any annotated frame does.",
        "",
        *_table(("constraint", "satisfied", "violated", "positive"), _itcs(plan)),
        "",
        "## Labels",
        f"Rule: {about['rule']}. Discount of the returns: {about['gamma']:g}.",
        "",
        *_table(("annotator", "source", "segments", "episodes"), _annotators(plan)),
        "",
        "Each label is in `meta/jiti/segments/` with its author, time and, where it decides on a proposal, that "
        "proposal's id. `jiti annotate` and `jiti validate-rewards` open this folder.",
        "",
        "## Splits",
        *_table(("split", "episodes", "elegant"), _splits(plan)),
        "",
        "Which episode is in which split, its source and its recording's fingerprint: `meta/jiti/episodes.parquet`.",
        "",
        "## Columns",
        *_table(("column", "type", "size", "what"), _columns(plan)),
        "",
        "## Use",
        "```python",
        "from lerobot.datasets.lerobot_dataset import LeRobotDataset",
        "",
        f'dataset = LeRobotDataset("{name}", root="{name}")',
        "```",
        "",
        "## Provenance",
        f"Made by `jiti curate` {about['versions']['jiti']} from {', '.join(about['sources'])}; digest of all inputs "
        f"`{about['digest'][:16]}`. Options and versions: `meta/jiti/curate.json`.",
        "",
    ]
    return "\n".join(lines)


def _table(heading: Sequence[str], rows: Sequence[Sequence[Any]]) -> list[str]:
    lines = [f"| {' | '.join(heading)} |", f"|{'---|' * len(heading)}"]
    return lines + [f"| {' | '.join(_cell(value) for value in row)} |" for row in rows]


def _cell(value: Any) -> str:
    return str(value).replace("|", "\\|").replace("\n", " ")


def _tasks(plan: Plan) -> list[tuple[Any, ...]]:
    groups: dict[tuple[str, str], list[Any]] = defaultdict(list)
    for episode in plan.episodes:
        groups[episode.task_id or "–", episode.instruction].append(episode)
    rows = []
    for (task_id, instruction), episodes in groups.items():
        told = [episode.success for episode in episodes if episode.success is not None]
        succeeded = f"{sum(told)} of {len(told)}" if told else "–"
        rows.append((task_id, instruction, len(episodes), sum(e.reward == 1 for e in episodes), succeeded))
    return rows


def _itcs(plan: Plan) -> list[tuple[Any, ...]]:
    counts: dict[str, Counter[int]] = defaultdict(Counter)
    for episode in plan.episodes:
        for itc_id, verdict in episode.verdicts.items():
            counts[itc_id][verdict] += 1
    return [(itc, c[1], c[0], f"{c[1] / c.total():.0%}") for itc, c in sorted(counts.items())]


def _annotators(plan: Plan) -> list[tuple[Any, ...]]:
    segments: Counter[tuple[str, str]] = Counter()
    episodes: dict[tuple[str, str], set[int]] = defaultdict(set)
    for episode in plan.episodes:
        for annotator, segment in episode.segments:
            segments[annotator, segment.source] += 1
            episodes[annotator, segment.source].add(episode.index)
    return [(*key, count, len(episodes[key])) for key, count in sorted(segments.items())]


def _splits(plan: Plan) -> list[tuple[Any, ...]]:
    counts = Counter(episode.split for episode in plan.episodes)
    elegant = Counter(episode.split for episode in plan.episodes if episode.reward == 1)
    return [(name, counts[name], elegant[name]) for name in (*SPLITS, UNSEEN) if counts[name]]


def _columns(plan: Plan) -> list[tuple[Any, ...]]:
    rows: list[tuple[Any, ...]] = []
    for feature in plan.episodes[0].features:
        shape = plan.shapes[feature.key]
        size = "x".join(str(n) for n in shape.shape)
        whence = "the scene's state (jiti.tasks.scene_state)" if feature.scene_state else ""
        whence = whence or ", ".join(f"`{name}`" for name in feature.streams or (feature.camera,))
        rows.append((f"`{feature.key}`", shape.dtype, size, f"{whence} of the recording"))
    return [
        *rows,
        ("`next.reward`", "float32", 1, "1 where every constraint that is decided at this frame is satisfied, else 0"),
        ("`next.done`", "bool", 1, "the last frame of an episode"),
        ("`next.success`", "bool", 1, "the last frame of an episode whose recorder saw the task succeed"),
        ("`elegance.annotated`", "bool", 1, "whether a constraint is decided at this frame"),
        ("`elegance.mc_return`", "float32", 1, "reward plus discount times the next frame's return"),
    ]
