"""Small charts in the page: bars, histograms, maps of points. Colours are classes, so that the page's style gives
them."""

from collections.abc import Sequence
from html import escape

import numpy as np

from jiti.curate.report.axes import BOTTOM, HEIGHT, LEFT, RIGHT, TOP, WIDTH, round_ticks, x_axis, x_of, y_axis, y_of

BINS = 24
"""Of a histogram. Our choice."""
CELLS = 44
"""Of a map, across. Our choice."""
FAINTEST = 0.15
"""Opacity of a cell of a map that has one point. Our choice: it is still seen."""

Series = Sequence[tuple[str, np.ndarray]]
"""Class of the colour, which is also its name in the legend, and values."""


def histogram(series: Series, *, unit: str, bins: int = BINS) -> str:
    """Stacked counts of several series over one range."""
    every = np.concatenate([values for _, values in series]) if series else np.empty(0)
    if not len(every):
        return empty()
    low, high = float(every.min()), float(every.max())
    whole = bool((every == np.round(every)).all())
    if whole and high - low < bins:
        margin = 1.5 if high == low else 0.5
        low, high = low - margin, high + margin
        bins = int(high - low)
    elif high == low:
        low, high = low - 0.5, high + 0.5
    edges = np.linspace(low, high, bins + 1)
    counts = [(name, np.histogram(values, edges)[0]) for name, values in series]
    most = max(1, int(np.sum([count for _, count in counts], axis=0).max()))
    parts = y_axis(round_ticks(0, most, 4, whole=True), 0, most)
    parts += x_axis(round_ticks(low, high, whole=whole), low, high, unit)
    for k in range(bins):
        base = 0
        left, right = (x_of(float(edge), low, high) for edge in edges[k : k + 2])
        for name, count in counts:
            if count[k]:
                top, bottom = y_of(base + int(count[k]), 0, most), y_of(base, 0, most)
                told = f"{edges[k]:.4g} to {edges[k + 1]:.4g} {unit}: {count[k]} {name}"
                parts.append(_rect(left + 0.5, top, max(1.0, right - left - 1), bottom - top, name, told))
                base += int(count[k])
    return _figure(parts, "".join(_key(name) for name, _ in series))


def bars(rows: Sequence[tuple[str, Sequence[tuple[str, int]]]]) -> str:
    """One horizontal bar a row, divided by class in the shares of its counts; no picture, so that it is read on a
    narrow screen too."""
    if not rows:
        return empty()
    parts: list[str] = []
    for name, counts in rows:
        total = max(1, sum(count for _, count in counts))
        told = " / ".join(str(count) for _, count in counts)
        shares = "".join(
            f'<i class="{kind}" style="flex-grow:{count}" title="{escape(f"{name}: {count} {kind}")}"></i>'
            for kind, count in counts
            if count
        )
        share = f"{counts[0][1] / total:.0%} ({told})"
        parts.append(f"<div><span>{escape(name)}</span><b>{shares}</b><span>{share}</span></div>")
    kinds = dict.fromkeys(kind for _, counts in rows for kind, _ in counts)
    keys = "".join(map(_key, kinds))
    return f'<figure><div class="bars">{"".join(parts)}</div><figcaption>{keys}</figcaption></figure>'


def maps(groups: Sequence[tuple[str, str, np.ndarray]]) -> list[str]:
    """Points (n, 2) of several groups, with class and title, each as a grid of cells: the darker the more points are
    in it. All have the same axes and the same shades."""
    every = np.concatenate([points for _, _, points in groups])
    (x0, x1), (y0, y1) = ((float(column.min()), float(column.max())) for column in every.T)
    rows = max(8, round(CELLS * (HEIGHT - TOP - BOTTOM) / (WIDTH - LEFT - RIGHT)))
    grids = [
        np.histogram2d(points[:, 0], points[:, 1], (CELLS, rows), range=[(x0, x1), (y0, y1)]) for _, _, points in groups
    ]
    most = max(int(counts.max()) for counts, _, _ in grids)
    drawn = []
    for (kind, title, _), (counts, across, up) in zip(groups, grids, strict=True):
        parts = [f'<text x="{LEFT}" y="12" class="head">{escape(title)}</text>']
        parts += y_axis(round_ticks(y0, y1, 4), y0, y1, "second component")
        parts += x_axis(round_ticks(x0, x1), x0, x1, "first component")
        for column, row in np.argwhere(counts > 0).tolist():
            left, right = (x_of(float(edge), x0, x1) for edge in across[column : column + 2])
            bottom, top = (y_of(float(edge), y0, y1) for edge in up[row : row + 2])
            count = int(counts[column, row])
            parts.append(
                _rect(left, top, right - left, bottom - top, kind, f"{count} frames", opacity=_shade(count, most))
            )
        scale = sorted({1, round(most**0.5), most})
        keys = "".join(_key(kind, f"{count:,}", _shade(count, most)) for count in scale)
        drawn.append(_figure(parts, f'<span class="key">frames in a cell:</span>{keys}'))
    return drawn


def empty() -> str:
    """In the place of a chart that has nothing to show."""
    return '<p class="nothing">Nothing to show.</p>'


def _shade(count: int, most: int) -> float:
    return FAINTEST + (1 - FAINTEST) * float(np.log(count) / np.log(most)) if most > 1 else 1.0


def _rect(x: float, y: float, width: float, height: float, kind: str, told: str, *, opacity: float = 1.0) -> str:
    faint = f' fill-opacity="{opacity:.2f}"' if opacity < 1 else ""
    return (
        f'<rect x="{x:.2f}" y="{y:.2f}" width="{width:.2f}" height="{height:.2f}" class="{kind}"{faint}>'
        f"<title>{escape(told)}</title></rect>"
    )


def _key(kind: str, told: str = "", opacity: float = 1.0) -> str:
    faint = f' style="opacity:{opacity:.2f}"' if opacity < 1 else ""
    return f'<span class="key"><i class="{kind}"{faint}></i>{escape(told or kind)}</span>'


def _figure(parts: Sequence[str], caption: str) -> str:
    drawn = f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}" height="{HEIGHT}" class="chart" role="img">'
    return f"<figure>{drawn}{''.join(parts)}</svg><figcaption>{caption}</figcaption></figure>"
