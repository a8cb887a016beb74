"""Small charts as SVG in the page: bars, histograms, a map of points. Colours are classes, so that the page's style
gives them."""

from collections.abc import Sequence
from html import escape

import numpy as np

WIDTH, HEIGHT = 460, 210
"""Of a chart, in the page's pixels."""
LEFT, BOTTOM, TOP = 44, 34, 18
BINS = 24
"""Of a histogram. Our choice."""

Series = Sequence[tuple[str, np.ndarray]]
"""Class of the colour, which is also its name in the legend, and values."""


def histogram(series: Series, *, unit: str, bins: int = BINS) -> str:
    """Stacked counts of several series over one range."""
    every = np.concatenate([values for _, values in series]) if series else np.empty(0)
    if not len(every):
        return empty()
    low, high = float(every.min()), float(every.max())
    whole = bool((every == np.round(every)).all())
    if high == low:
        low, high = low - 0.5, high + 0.5
    if whole and high - low < bins:
        low, high = np.floor(low) - 0.5, np.ceil(high) + 0.5
        bins = int(high - low)
    edges = np.linspace(low, high, bins + 1)
    counts = [(name, np.histogram(values, edges)[0]) for name, values in series]
    most = max(1, int(np.sum([count for _, count in counts], axis=0).max()))
    parts = _axes(low, high, most, unit)
    step = (WIDTH - LEFT - 8) / bins
    for k in range(bins):
        base = 0
        for name, count in counts:
            if count[k]:
                top = _y(base + count[k], most)
                height = _y(base, most) - top
                told = f"{edges[k]:.4g} to {edges[k + 1]:.4g} {unit}: {count[k]} {name}"
                x = LEFT + k * step + 0.5
                parts.append(_rect(x, top, max(1.0, step - 1), height, name, told))
                base += int(count[k])
    return _svg(parts, WIDTH, HEIGHT, legend=[name for name, _ in series])


def bars(rows: Sequence[tuple[str, Sequence[tuple[str, int]]]], *, width: int = 940) -> str:
    """One horizontal bar a row, divided by class in the shares of its counts."""
    if not rows:
        return empty()
    names_width, row_height = 340, 26
    room = width - names_width - 120
    parts: list[str] = []
    for k, (name, counts) in enumerate(rows):
        y = TOP + k * row_height
        parts.append(f'<text x="{names_width - 10}" y="{y + 14}" text-anchor="end">{escape(name)}</text>')
        total, x = max(1, sum(count for _, count in counts)), float(names_width)
        for kind, count in counts:
            if count:
                share = room * count / total
                parts.append(_rect(x, y, share, row_height - 8, kind, f"{name}: {count} {kind}"))
                x += share
        told = " / ".join(str(count) for _, count in counts)
        first = counts[0][1] / total
        parts.append(f'<text x="{names_width + room + 8}" y="{y + 14}">{first:.0%} ({told})</text>')
    kinds = list(dict.fromkeys(kind for _, counts in rows for kind, _ in counts))
    return _svg(parts, width, TOP + len(rows) * row_height + 6, legend=kinds)


def density(points: np.ndarray, spans: Sequence[tuple[float, float]], kind: str, title: str, cells: int = 44) -> str:
    """Points (n, 2) as a grid of cells, the darker the more there are; `spans` are the two axes' ranges."""
    rows = max(8, round(cells * (HEIGHT - TOP - BOTTOM) / (WIDTH - LEFT - 8)))
    (x0, x1), (y0, y1) = spans
    counts, _, _ = np.histogram2d(points[:, 0], points[:, 1], (cells, rows), range=[(x0, x1), (y0, y1)])
    step_x, step_y = (WIDTH - LEFT - 8) / cells, (HEIGHT - TOP - BOTTOM) / rows
    most = max(1.0, float(np.log1p(counts).max()))
    parts = [f'<text x="{LEFT}" y="12" class="head">{escape(title)}</text>']
    parts.append(
        f'<rect x="{LEFT}" y="{TOP}" width="{WIDTH - LEFT - 8}" height="{HEIGHT - TOP - BOTTOM}" class="frame"/>'
    )
    for column, row in np.argwhere(counts > 0).tolist():
        strength = 0.15 + 0.85 * float(np.log1p(counts[column, row])) / most
        x, y = LEFT + column * step_x, HEIGHT - BOTTOM - (row + 1) * step_y
        told = f"{int(counts[column, row])} frames"
        parts.append(_rect(x, y, step_x, step_y, kind, told, opacity=strength))
    middle = (LEFT + WIDTH - 8) / 2
    parts.append(f'<text x="{middle}" y="{HEIGHT - 14}" text-anchor="middle">first principal component</text>')
    return _svg(parts, WIDTH, HEIGHT)


def empty() -> str:
    """In the place of a chart that has nothing to show."""
    return '<p class="nothing">Nothing to show.</p>'


def _axes(low: float, high: float, most: int, unit: str) -> list[str]:
    parts = []
    for share in (0.0, 0.5, 1.0):
        y = _y(share * most, most)
        parts.append(f'<line x1="{LEFT}" x2="{WIDTH - 8}" y1="{y}" y2="{y}" class="grid"/>')
        if (share * most).is_integer():
            parts.append(f'<text x="{LEFT - 6}" y="{y + 4}" text-anchor="end">{share * most:.0f}</text>')
        x = LEFT + share * (WIDTH - LEFT - 8)
        anchor = {0.0: "start", 0.5: "middle", 1.0: "end"}[share]
        told = f"{low + share * (high - low):.4g}"
        parts.append(f'<text x="{x}" y="{HEIGHT - BOTTOM + 16}" text-anchor="{anchor}">{told}</text>')
    parts.append(f'<text x="{(LEFT + WIDTH) / 2}" y="{HEIGHT - 2}" text-anchor="middle">{escape(unit)}</text>')
    return parts


def _y(value: float, most: int) -> float:
    return round(HEIGHT - BOTTOM - (HEIGHT - TOP - BOTTOM) * value / most, 2)


def _rect(x: float, y: float, width: float, height: float, kind: str, told: str, *, opacity: float = 1.0) -> str:
    faint = f' fill-opacity="{opacity:.2f}"' if opacity < 1 else ""
    return (
        f'<rect x="{x:.2f}" y="{y:.2f}" width="{width:.2f}" height="{height:.2f}" class="{kind}"{faint}>'
        f"<title>{escape(told)}</title></rect>"
    )


def _svg(parts: Sequence[str], width: float, height: float, legend: Sequence[str] = ()) -> str:
    keys = "".join(f'<span class="key"><i class="{name}"></i>{escape(name)}</span>' for name in legend)
    drawn = f'<svg viewBox="0 0 {width:g} {height:g}" width="{width:g}" height="{height:g}" role="img">'
    return f"<figure>{drawn}{''.join(parts)}</svg><figcaption>{keys}</figcaption></figure>"
