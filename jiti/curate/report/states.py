"""Where elegant and inelegant episodes lie in the space of what was observed: maps of two principal components."""

from collections.abc import Iterator
from html import escape

import numpy as np

from jiti.curate.report.facts import Facts
from jiti.curate.report.svg import empty, maps

KINDS = {True: "elegant", False: "inelegant", None: "unlabelled"}


def state_maps(facts: Facts) -> Iterator[str]:
    """A pair of maps for each feature of numbers: of the robot, and of the scene where it was recorded."""
    elegant = {episode.index: episode.elegant for episode in facts.episodes}
    kinds = np.array([KINDS[elegant[int(index)]] for index in facts.state_episode])
    drawn = 0
    for name, values in facts.states.items():
        found = _plane(values)
        if found is None:
            continue
        points, (first, second) = found
        if not drawn:
            yield (
                "<p>Standardized, in the plane of the two first principal components, in standard deviations. A critic "
                "has seen nothing where both maps are empty, and can compare nothing where one of them is.</p>"
            )
        drawn += 1
        yield (
            f"<p><code>{escape(name)}</code>, {len(points):,} frames; the components have {first:.0%} and {second:.0%} "
            "of the variance.</p>"
        )
        groups = [(kind, f"{kind} episodes", points[kinds == kind]) for kind in KINDS.values()]
        charts = maps([(kind, f"{title}, {len(of):,} frames", of) for kind, title, of in groups if len(of)])
        yield f'<div class="pair">{"".join(charts)}</div>'
    if not drawn:
        yield empty()


def _plane(values: np.ndarray) -> tuple[np.ndarray, tuple[float, float]] | None:
    """Points (rows, 2) and the two components' shares of the variance; None where there are no two."""
    spread = values.std(axis=0) if len(values) else np.empty(0)
    if len(values) < 2 or (spread > 0).sum() < 2:
        return None
    scaled = (values - values.mean(axis=0))[:, spread > 0] / spread[spread > 0]
    _, strengths, axes = np.linalg.svd(scaled, full_matrices=False)
    first, second = (strengths[:2] ** 2 / (strengths**2).sum()).tolist()
    return scaled @ axes[:2].T, (first, second)
