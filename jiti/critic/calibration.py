"""How well Q of what was done agrees with the Monte-Carlo return of what came of it."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from jiti.durable import replacing

BINS = 10
"""Groups of equally many frames by Q. Our choice: tenths."""


@dataclass(frozen=True, slots=True)
class Calibration:
    """Of n frames. A calibrated Q has groups on the diagonal, and no bias."""

    frames: int
    bias: float
    """Mean of Q less the return. The conservative term pushes Q of recorded chunks up, and Q of others down."""
    rmse: float
    correlation: float
    """Pearson's; NaN where one of both does not vary."""
    bins_q: list[float]
    """Mean Q of each group of frames, ascending."""
    bins_return: list[float]
    """Mean return of the same frames."""
    bins_count: list[int]


def calibration(q: np.ndarray, mc_return: np.ndarray) -> Calibration:
    """Of values and returns (n,) of the same frames; n may not be 0."""
    order = np.argsort(q, kind="stable")
    groups = [group for group in np.array_split(order, BINS) if len(group)]
    varies = q.std() > 0 and mc_return.std() > 0
    return Calibration(
        frames=len(q),
        bias=float((q - mc_return).mean()),
        rmse=float(np.sqrt(((q - mc_return) ** 2).mean())),
        correlation=float(np.corrcoef(q, mc_return)[0, 1]) if varies else float("nan"),
        bins_q=[float(q[group].mean()) for group in groups],
        bins_return=[float(mc_return[group].mean()) for group in groups],
        bins_count=[len(group) for group in groups],
    )


def plot_calibration(found: Calibration, q: np.ndarray, mc_return: np.ndarray, title: str, path: Path) -> None:
    """Write a PNG: each frame's return over its Q, and the means of groups. Raises SaveFailed."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.5, 5), layout="constrained")
    axes = figure.add_subplot()
    axes.scatter(q, mc_return, s=4, alpha=0.3, linewidths=0, color="tab:blue", label="a frame", rasterized=True)
    axes.plot(found.bins_q, found.bins_return, "o-", color="tab:red", label="ten groups of equally many frames by Q")
    low, high = min(q.min(), mc_return.min()), max(q.max(), mc_return.max())
    axes.plot([low, high], [low, high], "--", color="gray", linewidth=1, label="Q = return")
    axes.set(xlabel="Q of the recorded chunk, least of the members", ylabel="Monte-Carlo return", title=title)
    for handle in axes.legend(loc="upper left", fontsize="small").legend_handles:
        if handle is not None:
            handle.set_alpha(1)
    FigureCanvasAgg(figure)
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=150)
