"""How good proposals are: against a person's accepted segments or the simulator's, by criterion.

A proposed segment counts as found when its temporal IoU with one of the reference for the same ITC is at least 0.5, as
is usual for detections. Verdicts are compared where segments were found so and both sides have one.
"""

import json
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING, Any

import numpy as np

from jiti.annotate.agreement import cohens_kappa, lanes_of
from jiti.annotate.labels import read_labels
from jiti.annotate.matching import Match, match
from jiti.annotate.segments import Segment
from jiti.durable import make_folder, write_atomic
from jiti.errors import LabelError
from jiti.tasks.task import Criterion

if TYPE_CHECKING:
    from rich.table import Table

FOUND_IOU = 0.5
BINS = 10
"""Of confidence, for calibration (Guo et al. 2017 use 15 on ten thousands of verdicts; there are hundreds here)."""
EVERYTHING = "all"

PAPER_G2 = {"process constraints": 0.706, "fine spatial checks": 0.478}
"""Accuracy of the paper's VLM on verdicts (supplement, G.2), on four tasks of LIBERO-Elegant."""
PAPER_G1 = (235, 273)
"""ITCs that experts accepted of those that the paper's VLM proposed (supplement, G.1)."""
_FLAG = {"vlm": "--vlm", "signal": "--from signal", "sim": "--from sim"}
PROCESS = (Criterion.TASK_SEQUENCE_INTEGRITY, Criterion.COLLISION_FREE_EXECUTION)
"""Criteria about what happens on the way; the other two ask for exact places. Our reading of "process-oriented"."""


@dataclass(frozen=True, slots=True)
class Bin:
    """Verdicts of about one confidence."""

    confidence: float
    """Mean."""
    accuracy: float
    count: int


@dataclass(frozen=True, slots=True)
class Scores:
    """Of one criterion, or of several together."""

    name: str
    reference: int
    """Segments in the reference."""
    proposed: int
    found: int
    """Matched with an IoU of at least `FOUND_IOU`."""
    start_error: float | None
    """Mean absolute, in frames, over matched segments."""
    end_error: float | None
    verdicts: int
    """Found segments with a verdict on both sides."""
    correct: int
    kappa: float | None
    """Cohen's; None where both sides used only one and the same verdict."""
    ece: float | None
    """Expected calibration error of the verdicts' confidences; None without any."""
    bins: tuple[Bin, ...] = ()

    @property
    def f1(self) -> float | None:
        """Harmonic mean of precision and recall of segments."""
        return 2 * self.found / (self.reference + self.proposed) if self.reference + self.proposed else None

    @property
    def accuracy(self) -> float | None:
        """Of verdicts."""
        return self.correct / self.verdicts if self.verdicts else None


@dataclass(frozen=True, slots=True)
class Evaluation:
    """One machine against a reference."""

    proposer: str
    reference: str
    episodes: int
    """In which both have segments, or the reference has some."""
    scores: tuple[Scores, ...]
    """By criterion, then process and spatial ones, then all."""
    discovered: tuple[int, int] | None = None
    """ITCs that a person kept, of those that were proposed, where both files are there."""
    temperatures: Mapping[str, float] = field(default_factory=dict)
    """By model, where confidence was calibrated to the reference."""
    files: tuple[Path, ...] = ()
    """Figures and reliability plot, once they are written."""

    def __str__(self) -> str:
        """The tables, as wide as the terminal, and where the files are."""
        from rich.console import Console

        console = Console(markup=False, highlight=False)
        with console.capture() as captured:
            for table in self.tables():
                console.print(table, "", sep="\n")
            console.print(
                f"ref., prop.: segments of {self.reference} and of {self.proposer}; F1 at temporal IoU {FOUND_IOU}; "
                f"start, end: mean absolute error in frames; N, right: verdicts on both sides; ECE over {BINS} bins."
            )
        fitted = "".join(
            f"Calibrated {model}: temperature {t:.2f}; run `jiti autolabel --vlm` again to apply it.\n"
            for model, t in self.temperatures.items()
        )
        named = zip(("Figures", "Reliability plot"), self.files, strict=False)
        where = "\n".join(f"{name}: {path}" for name, path in named)
        if len(self.files) == 1:
            where += "\nNo reliability plot without matplotlib. Run: pip install 'jiti[vlm]'"
        return captured.get() + fitted + where

    def to_json(self) -> str:
        """For `--json`."""
        return json.dumps(self.figures(), indent=2)

    def figures(self) -> dict[str, Any]:
        """Everything, in plain types."""
        rows = [asdict(s) | {"f1": s.f1, "accuracy": s.accuracy} for s in self.scores]
        paper = {"G.1": {"accepted": PAPER_G1[0], "proposed": PAPER_G1[1]}, "G.2": PAPER_G2}
        return {
            "proposer": self.proposer,
            "reference": self.reference,
            "episodes": self.episodes,
            "scores": rows,
            "discovered": self.discovered,
            "temperatures": dict(self.temperatures),
            "paper": paper,
            "files": [str(path) for path in self.files],
        }

    def tables(self) -> "list[Table]":
        """For the terminal: our figures, and the paper's beside ours."""
        from rich.table import Table

        title = f"{self.proposer} against {self.reference}, {self.episodes} episodes"
        ours = Table(title=title, title_justify="left", box=None, padding=(0, 2, 0, 0))
        ours.add_column("criterion", min_width=19)
        for heading in ("ref.", "prop.", "F1", "start", "end", "N", "right", "kappa", "ECE"):
            ours.add_column(heading, justify="right", no_wrap=True)
        for s in self.scores:
            figures = (s.f1, s.start_error, s.end_error, s.accuracy, s.kappa, s.ece)
            f1, start, end, right, kappa, ece = (_number(x) for x in figures)
            ours.add_row(s.name, str(s.reference), str(s.proposed), f1, start, end, str(s.verdicts), right, kappa, ece)
        paper = Table(
            title="Beside the paper's (supplement, G.1 and G.2)", title_justify="left", box=None, padding=(0, 2, 0, 0)
        )
        for heading in ("what", "paper", "here", "N here"):
            paper.add_column(heading)
        kept = self.discovered
        paper.add_row(
            "G.1: proposed ITCs that were accepted",
            f"{PAPER_G1[0] / PAPER_G1[1]:.1%} ({PAPER_G1[0]}/{PAPER_G1[1]})",
            f"{kept[0] / kept[1]:.1%}" if kept else "-",
            str(kept[1]) if kept else "-",
        )
        named = {s.name: s for s in self.scores}
        for name, figure in PAPER_G2.items():
            s = named[name]
            here = f"{s.accuracy:.1%}" if s.accuracy is not None else "-"
            paper.add_row(f"G.2: verdicts, {name}", f"{figure:.1%}", here, str(s.verdicts))
        whole = named[EVERYTHING]
        recall = f"{whole.found / whole.reference:.1%}" if whole.reference else "-"
        paper.add_row("G.2: segments found", "nearly always", recall, str(whole.reference))
        return [ours, paper]


def evaluate(labels_dir: Path, proposer: str, reference: str) -> Evaluation:
    """Compare a machine's proposals in a labels folder. Raises LabelError when either has none there."""
    labels = read_labels(labels_dir).whole()
    table = labels.segments
    names = sorted(set(table["annotator"].to_pylist()))
    proposing = f"run `jiti autolabel {_FLAG.get(proposer, '')}` first"
    for name, remedy in ((proposer, proposing), (reference, "give another name to --evaluate")):
        if name not in names:
            raise LabelError(
                f"{name!r} has no labels in {labels_dir}; {remedy}. There are: {', '.join(names) or 'none'}"
            )
    if proposer == reference:
        raise LabelError(f"{reference!r} compared with itself says nothing; give another name to --evaluate")
    lanes, worked = lanes_of(table, reference)
    return compare_lanes(lanes, lanes_of(table, proposer)[0], proposer, reference, worked)


def compare_lanes(
    reference: Mapping[tuple[str, str], Sequence[Segment]],
    proposed: Mapping[tuple[str, str], Sequence[Segment]],
    proposer: str,
    named: str,
    worked: Collection[str] = (),
) -> Evaluation:
    """From segments by episode and ITC. Only episodes that the reference has, or `worked` on, are counted."""
    episodes = {episode for episode, _ in reference} | set(worked)
    groups: dict[str, list[tuple[Sequence[Segment], Sequence[Segment]]]] = {c.value: [] for c in Criterion}
    for key in sorted(reference.keys() | proposed.keys()):
        if key[0] in episodes:
            left, right = reference.get(key, ()), proposed.get(key, ())
            groups.setdefault((left or right)[0].criterion, []).append((left, right))
    together = {
        "process constraints": [pair for c in PROCESS for pair in groups[c.value]],
        "fine spatial checks": [pair for c in Criterion if c not in PROCESS for pair in groups[c.value]],
        EVERYTHING: [pair for pairs in groups.values() for pair in pairs],
    }
    rows = [_score(name.replace("_", " "), pairs) for name, pairs in groups.items() if pairs]
    rows += [_score(name, pairs) for name, pairs in together.items()]
    return Evaluation(proposer, named, len(episodes), tuple(rows))


def calibration_error(confidences: Sequence[float], correct: Sequence[bool]) -> tuple[float | None, tuple[Bin, ...]]:
    """Expected calibration error over `BINS` bins of equal width, and the bins that hold any."""
    if not confidences:
        return None, ()
    confidence, right = np.array(confidences), np.array(correct, dtype=float)
    index = np.minimum((confidence * BINS).astype(int), BINS - 1)
    bins = []
    for k in np.unique(index):
        inside = index == k
        bins.append(Bin(float(confidence[inside].mean()), float(right[inside].mean()), int(inside.sum())))
    return sum(b.count * abs(b.accuracy - b.confidence) for b in bins) / len(confidence), tuple(bins)


def verdict_pairs(matches: Iterable[Match]) -> list[Match]:
    """Those with a verdict on both sides."""
    return [m for m in matches if m.a.reward is not None and m.b.reward is not None]


def save(evaluation: Evaluation, folder: Path) -> Evaluation:
    """The figures as JSON and, where matplotlib is installed, the reliability plot as PNG. Raises SaveFailed."""
    from jiti.annotate.reliability import can_plot, plot_png

    make_folder(folder)
    name = f"{evaluation.proposer}-against-{evaluation.reference}"
    figures, plot = folder / f"{name}.json", folder / f"{name}.png"
    evaluation = replace(evaluation, files=(figures, plot) if can_plot() else (figures,))
    write_atomic(figures, evaluation.to_json().encode())
    if can_plot():
        write_atomic(plot, plot_png(evaluation))
    return evaluation


def _score(name: str, pairs: Sequence[tuple[Sequence[Segment], Sequence[Segment]]]) -> Scores:
    matches = [m for left, right in pairs for m in match(left, right, least_iou=FOUND_IOU)[0]]
    judged = verdict_pairs(matches)
    counts = np.zeros((2, 2), np.int64)
    for m in judged:
        counts[m.a.reward or 0, m.b.reward or 0] += 1
    sure = [(m.b.confidence, m.a.reward == m.b.reward) for m in judged if m.b.confidence is not None]
    ece, bins = calibration_error([c for c, _ in sure], [right for _, right in sure])
    return Scores(
        name,
        sum(len(left) for left, _ in pairs),
        sum(len(right) for _, right in pairs),
        len(matches),
        fmean(abs(m.start_error) for m in matches) if matches else None,
        fmean(abs(m.end_error) for m in matches) if matches else None,
        len(judged),
        int(np.trace(counts)),
        cohens_kappa(counts),
        ece,
        bins,
    )


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"
