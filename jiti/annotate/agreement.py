"""How well two annotators agree: where an ITC is decided, and how it was decided there.

Compared are a person's accepted segments and a machine's proposals, in episodes that both have worked on. For each ITC:
the temporal IoU and the boundary errors of matched segments, and Cohen's kappa [1] over frames.

[1] J. Cohen, "A coefficient of agreement for nominal scales", 1960: kappa = (p_o - p_e) / (1 - p_e).
"""

import json
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import fmean, median
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from jiti.annotate.labels import read_labels
from jiti.annotate.matching import Match, match
from jiti.annotate.names import MACHINES
from jiti.annotate.segment_file import to_segments
from jiti.annotate.segments import Segment
from jiti.errors import LabelError

if TYPE_CHECKING:
    from rich.table import Table

ALL_ITCS = "all"
"""Under this name, every ITC together."""


@dataclass(frozen=True, slots=True)
class BoundaryError:
    """Frames by which one boundary of b is after that of a, over matched segments."""

    mean: float
    """Signed: above 0, b marks it later."""
    mean_absolute: float
    median_absolute: float

    @classmethod
    def of(cls, errors: Sequence[int]) -> "BoundaryError | None":
        if not errors:
            return None
        sizes = [abs(error) for error in errors]
        return cls(fmean(errors), fmean(sizes), float(median(sizes)))


@dataclass(frozen=True, slots=True)
class ItcAgreement:
    """Agreement on one ITC, over the episodes of both in which at least one of them marked it."""

    itc_id: str
    episodes: int
    matched: int
    only_a: int
    only_b: int
    mean_iou: float | None
    """Over matched segments; None without any."""
    mean_iou_with_unmatched: float | None
    """Segments without a counterpart count as 0."""
    start_error: BoundaryError | None
    end_error: BoundaryError | None
    frame_kappa: float | None
    """Over frames in the categories not annotated, 0, 1; None where both used only one and the same."""
    verdict_kappa: float | None
    """Over matched segments that both decided; None without any, or where both used only one and the same verdict."""
    verdict_agreement: float | None
    """Share of matched and decided segments with the same verdict."""
    frames: tuple[tuple[int, ...], ...]
    """Frames by a's category (row) and b's (column)."""


@dataclass(frozen=True, slots=True)
class Lane:
    """One ITC of one episode, as both annotators see it."""

    episode_id: str
    itc_id: str
    matches: tuple[Match, ...]
    only_a: tuple[Segment, ...]
    only_b: tuple[Segment, ...]


@dataclass(frozen=True, slots=True)
class Agreement:
    """Two annotators over the same episodes."""

    a: str
    b: str
    episodes: tuple[str, ...]
    """Labelled by both."""
    episodes_only_a: tuple[str, ...]
    """Not counted as disagreement."""
    episodes_only_b: tuple[str, ...]
    itcs: tuple[ItcAgreement, ...]
    """By id, then all together."""
    lanes: tuple[Lane, ...]

    def to_json(self) -> dict[str, Any]:
        """For `--json` and the viewer: names, episodes and the figures of each ITC."""
        return {
            "a": self.a,
            "b": self.b,
            "episodes": list(self.episodes),
            "episodes_only_a": list(self.episodes_only_a),
            "episodes_only_b": list(self.episodes_only_b),
            "itcs": [asdict(itc) for itc in self.itcs],
        }

    def to_table(self) -> "Table":
        """For the terminal."""
        from rich.table import Table

        table = Table(title=f"{self.a} and {self.b} over {len(self.episodes)} episodes")
        table.add_column("ITC", overflow="fold")
        for heading in ("matched", f"only {self.a}", f"only {self.b}", "IoU", "start", "end", "kappa", "verdicts"):
            table.add_column(heading, justify="right")
        for itc in self.itcs:
            table.add_row(
                itc.itc_id,
                *map(str, (itc.matched, itc.only_a, itc.only_b)),
                _number(itc.mean_iou),
                _error(itc.start_error),
                _error(itc.end_error),
                _number(itc.frame_kappa),
                "–" if itc.verdict_agreement is None else f"{itc.verdict_agreement:.0%}",
            )
        one_sided = len(self.episodes_only_a), len(self.episodes_only_b)
        table.caption = (
            f"start, end: mean error in frames (of its size, signed); kappa over frames. "
            f"Only {self.a}: {one_sided[0]} episodes, only {self.b}: {one_sided[1]}; these are not compared."
        )
        return table


def compare_labels(labels_dir: Path, a: str, b: str) -> Agreement:
    """Compare two annotators of a labels folder. Raises LabelError like `compare`, or when a file cannot be read."""
    labels = read_labels(labels_dir).whole()
    counts = {episode_id: recording.frame_count for episode_id, recording in labels.by_episode().items()}
    return compare(labels.segments, counts, a, b)


def print_agreement(agreement: Agreement, *, as_json: bool = False) -> None:
    """Say on standard output how well two annotators agree."""
    if as_json:
        print(json.dumps(agreement.to_json(), indent=2, ensure_ascii=False))
        return
    from rich.console import Console

    Console(markup=False).print(agreement.to_table())


def compare(segments: pa.Table, frame_counts: Mapping[str, int], a: str, b: str) -> Agreement:
    """Compare two annotators in a table of `read_segments`.

    Raises LabelError when one of them has no labels, or when both are the same.
    """
    if a == b:
        raise LabelError(f"{a!r} cannot be compared with themselves; pass two names to --agreement")
    names = sorted(set(segments["annotator"].to_pylist()))
    if missing := [name for name in (a, b) if name not in names]:
        raise LabelError(f"{missing[0]!r} has no labels here; there are labels by: {', '.join(names) or 'no one'}")
    lanes_a, worked_a = lanes_of(segments, a)
    lanes_b, worked_b = lanes_of(segments, b)
    both = worked_a & worked_b
    lanes: list[Lane] = []
    frames: dict[str, np.ndarray] = defaultdict(lambda: np.zeros((3, 3), np.int64))
    for key in sorted(lanes_a.keys() | lanes_b.keys()):
        if key[0] in both:
            left, right = lanes_a.get(key, []), lanes_b.get(key, [])
            matches, only_a, only_b = match(left, right)
            lanes.append(Lane(*key, tuple(matches), tuple(only_a), tuple(only_b)))
            longest = max(segment.end_frame for segment in (*left, *right)) + 1
            frames[key[1]] += _confusion(left, right, frame_counts.get(key[0], longest))
    itcs = [_of_itc(name, [lane for lane in lanes if lane.itc_id == name], frames[name]) for name in sorted(frames)]
    itcs.append(_of_itc(ALL_ITCS, lanes, sum(frames.values(), np.zeros((3, 3), np.int64))))
    return Agreement(
        a,
        b,
        tuple(sorted(both)),
        tuple(sorted(worked_a - both)),
        tuple(sorted(worked_b - both)),
        tuple(itcs),
        tuple(lanes),
    )


def cohens_kappa(counts: np.ndarray) -> float | None:
    """Chance-corrected agreement from counts (categories, categories) by a's choice and b's.

    1 when they always agree, 0 when no more than by chance; None when chance alone makes them agree always.
    """
    total = counts.sum()
    if not total:
        return None
    observed = np.trace(counts) / total
    expected = float(counts.sum(1) @ counts.sum(0)) / float(total) ** 2
    return None if expected == 1 else float((observed - expected) / (1 - expected))


def lanes_of(segments: pa.Table, annotator: str) -> tuple[dict[tuple[str, str], list[Segment]], set[str]]:
    """What counts of an annotator by episode and ITC, and the episodes that they have worked on."""
    own = segments.filter(pa.array(segments["annotator"].to_numpy() == annotator))
    counted = "proposed" if annotator in MACHINES else "accepted"
    lanes: dict[tuple[str, str], list[Segment]] = defaultdict(list)
    worked: set[str] = set()
    for segment in to_segments(own):
        if segment.status in (counted, "accepted"):
            lanes[segment.episode_id, segment.itc_id].append(segment)
        if segment.status in (counted, "accepted", "rejected"):
            worked.add(segment.episode_id)
    return lanes, worked


def _confusion(a: Iterable[Segment], b: Iterable[Segment], frame_count: int) -> np.ndarray:
    """Frames (3, 3) by the category of each annotator: not annotated, 0, 1."""
    categories = []
    for segments in (a, b):
        category = np.zeros(frame_count, np.int64)
        for reward in (1, 0):  # of overlapping segments the lower verdict holds, as for rewards
            for segment in segments:
                if segment.reward == reward:
                    category[segment.start_frame : segment.end_frame + 1] = 1 + reward
        categories.append(category)
    return np.bincount(3 * categories[0] + categories[1], minlength=9).reshape(3, 3)


def _of_itc(itc_id: str, lanes: Sequence[Lane], frames: np.ndarray) -> ItcAgreement:
    matches = [one for lane in lanes for one in lane.matches]
    only_a, only_b = sum(len(lane.only_a) for lane in lanes), sum(len(lane.only_b) for lane in lanes)
    ious = [one.iou for one in matches]
    verdicts = np.zeros((2, 2), np.int64)
    for one in matches:
        if one.a.reward is not None and one.b.reward is not None:
            verdicts[one.a.reward, one.b.reward] += 1
    decided = int(verdicts.sum())
    return ItcAgreement(
        itc_id,
        len({lane.episode_id for lane in lanes}),
        len(matches),
        only_a,
        only_b,
        fmean(ious) if ious else None,
        sum(ious) / (len(ious) + only_a + only_b) if ious or only_a or only_b else None,
        BoundaryError.of([one.start_error for one in matches]),
        BoundaryError.of([one.end_error for one in matches]),
        cohens_kappa(frames),
        cohens_kappa(verdicts),
        float(np.trace(verdicts)) / decided if decided else None,
        tuple(tuple(int(count) for count in row) for row in frames),
    )


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f}"


def _error(error: BoundaryError | None) -> str:
    return "–" if error is None else f"{error.mean_absolute:.1f} ({error.mean:+.1f})"
