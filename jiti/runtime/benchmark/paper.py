"""The paper's figures that ours are shown beside, in percent unless said otherwise.

"Beyond Success" (CVPR 2026, arXiv 2511.22555): Table 8, Table 9 (G.4), G.5 and G.6 of its supplement, and the main
paper.
"""

from collections.abc import Mapping, Sequence

AVERAGE = "average"
"""Key of a row's average ESR over its tasks."""
INTERVENTIONS = "interventions"
"""An episode."""
DECISION_MS = "decision_ms"
"""Inference time of a decision, milliseconds (G.6, on the authors' GPU). The supplement says "per step", and that
220.5 ms make about 45 Hz with chunks of 10 actions: 10 / 0.2205 s, so its step is a whole chunk."""
RATE = "intervention_rate"
"""Percent of decisions (G.6)."""


EIGHT = tuple(f"elegant/T{number}" for number in range(8))
"""LIBERO-Elegant, Table 4."""
SEVEN = tuple(f"rq3/{name}" for name in ("seen-A", "seen-B", "seen-C", "unseen-A", "unseen-B", "unseen-C", "unseen-D"))
"""RQ3, Table 6."""


def paper_average(row: str, tasks: Sequence[str]) -> float | None:
    """The average ESR of a row over some tasks: as it is printed where these are all of its tasks; else
    the mean of their figures. None where there is no figure for one of them, or no such row."""
    figures = FIGURES.get(row, {})
    if is_over(row, tasks):
        return figures.get(AVERAGE)
    found = [figures[task] for task in tasks if task in figures]
    return sum(found) / len(found) if found and len(found) == len(tasks) else None


def is_over(row: str, tasks: Sequence[str]) -> bool:
    """Whether a row's averages, those of interventions and times too, are over these tasks, and no others."""
    return ({key for key in FIGURES.get(row, {}) if "/" in key} or set(_AVERAGED.get(row, ()))) == set(tasks)


def _table8(*esr: float, average: float) -> dict[str, float]:
    return {**{f"elegant/T{number}": value for number, value in enumerate(esr)}, AVERAGE: average}


FIGURES: Mapping[str, Mapping[str, float]] = {
    "base": _table8(70, 30, 34, 52, 50, 42, 48, 72, average=49.8) | {INTERVENTIONS: 0, DECISION_MS: 112.4},
    "filtered": _table8(58, 32, 30, 38, 46, 48, 46, 86, average=48.0),
    "weighted": _table8(64, 40, 38, 40, 54, 36, 42, 74, average=48.5),
    "jiti": _table8(86, 68, 42, 62, 60, 54, 74, 92, average=67.2)
    | {INTERVENTIONS: 6.26, DECISION_MS: 220.5, RATE: 33.9},
    "full": {AVERAGE: 53.8, INTERVENTIONS: 16.25, DECISION_MS: 449.3},
    "sparse": {AVERAGE: 56.8},
    "rq3-base": {AVERAGE: 53.0},
    "rq3-jiti": {AVERAGE: 68.6},
    "rigid-base": {"g4/ketchup": 34, "g4/cream-cheese": 54, "g4/black-bowl": 20, AVERAGE: 36.0},
    "rigid-jiti": {"g4/ketchup": 56, "g4/cream-cheese": 68, "g4/black-bowl": 46, AVERAGE: 56.7},
    "articulated-base": {"g4/close-top-drawer": 30, "g4/close-microwave": 40, AVERAGE: 35.0},
    "articulated-jiti": {"g4/close-top-drawer": 64, "g4/close-microwave": 50, AVERAGE: 57.0},
    "tau-0.01": {AVERAGE: 52.86},
    "tau-0.5": {AVERAGE: 64.86},
    "tau-1": {AVERAGE: 65.72},
    "tau-2": {AVERAGE: 62.86},
    "tau-10": {AVERAGE: 48.86},
}
"""Rows by name. `base` to `weighted` are Table 8 (SmolVLA); interventions, `full` and `sparse` are of the main paper,
times of G.6; `rq3-` of the main paper, over seen and unseen objects; `rigid-` and `articulated-` Table 9; `tau-` G.5,
whose multiple of 1 is not Table 8's JITI."""
_AVERAGED: Mapping[str, Sequence[str]] = {
    **dict.fromkeys(("full", "sparse"), EIGHT),
    **dict.fromkeys(("rq3-base", "rq3-jiti"), SEVEN),
    # All of G.5's figures are whole 350ths: of seven tasks of 50 rollouts, and which of the eight, it does not say.
    **dict.fromkeys((row for row in FIGURES if row.startswith("tau-")), EIGHT),
}
"""Tasks of the rows that have no figures by task."""
