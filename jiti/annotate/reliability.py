"""The reliability plot: how often verdicts of each confidence are right."""

import io
from importlib.util import find_spec
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from jiti.annotate.evaluate import Evaluation


def can_plot() -> bool:
    """Whether matplotlib is installed."""
    return find_spec("matplotlib") is not None


def plot_png(evaluation: "Evaluation") -> bytes:
    """A panel a criterion that has verdicts, and one for all. Needs matplotlib (`can_plot`)."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    shown = [s for s in evaluation.scores if s.bins] or [evaluation.scores[-1]]
    figure = Figure(figsize=(max(4.0, 3.2 * len(shown)), 3.6), layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(f"{evaluation.proposer} against {evaluation.reference}", fontsize=10)
    for k, scores in enumerate(shown, 1):
        axes = figure.add_subplot(1, len(shown), k)
        axes.plot([0, 1], [0, 1], color="grey", linestyle="dashed", linewidth=1)
        most = max((b.count for b in scores.bins), default=1)
        sizes = [20 + 180 * b.count / most for b in scores.bins]
        axes.plot([b.confidence for b in scores.bins], [b.accuracy for b in scores.bins], color="tab:blue", alpha=0.5)
        axes.scatter([b.confidence for b in scores.bins], [b.accuracy for b in scores.bins], s=sizes, color="tab:blue")
        for b in scores.bins:
            axes.annotate(str(b.count), (b.confidence, b.accuracy), (4, -10), textcoords="offset points", fontsize=8)
        ece = "-" if scores.ece is None else f"{scores.ece:.3f}"
        axes.set(xlim=(0, 1.02), ylim=(-0.02, 1.05), xlabel="confidence", title=f"{scores.name}\nECE {ece}")
        axes.title.set_fontsize(9)
        if k == 1:
            axes.set_ylabel("share that is right")
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=120)
    return file.getvalue()
