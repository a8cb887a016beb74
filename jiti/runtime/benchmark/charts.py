"""Charts as SVG: rates as bars with their intervals and the paper's figure beside them, and a sweep of tau."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

from jiti.runtime.benchmark.cells import Estimate

WIDTH = 940
NAMES, ROW, GROUP_GAP, TOP, RIGHT = 250, 20, 12, 10, 200
COLOURS = 10
"""Of columns, in the page's style; more begin again."""

STYLE = """
body { max-width: 1280px }
th, td { padding: 6px 7px }
th { white-space: normal; vertical-align: bottom }
td:first-child, td.n { white-space: nowrap }
.c0 { fill: #7a8699 } .c1 { fill: #3f6fb0 } .c2 { fill: #b08a3f } .c3 { fill: #2a8f5b } .c4 { fill: #8a5bb0 }
.c5 { fill: #c8503c } .c6 { fill: #4aa3a8 } .c7 { fill: #a8527f } .c8 { fill: #6f7f2f } .c9 { fill: #d49a8c }
.whisker { stroke: var(--ink, #1c2330); stroke-width: 1.4; fill: none }
.paper { fill: none; stroke: var(--ink, #1c2330); stroke-width: 1.6 }
.line { fill: none; stroke: #2a8f5b; stroke-width: 2 }
.paper-line { fill: none; stroke: var(--dim, #5d6778); stroke-width: 1.4; stroke-dasharray: 5 4 }
.absent { fill: var(--dim, #5d6778); font-style: italic }
"""


@dataclass(frozen=True, slots=True)
class Bar:
    """A rate, in a group of bars with one heading."""

    group: str
    name: str
    rate: Estimate | None
    """None where it is missing."""
    paper: float | None = None
    """Share."""


@dataclass(frozen=True, slots=True)
class Point:
    """A rate at a multiple of tau."""

    scale: float
    rate: Estimate | None
    paper: float | None
    interventions: float | None
    """Share of decisions."""


def bar_chart(bars: Sequence[Bar]) -> str:
    """Horizontal bars from 0 to 100%, those of a group together."""
    names = list(dict.fromkeys(bar.name for bar in bars))
    room = WIDTH - NAMES - RIGHT
    y, group, parts = float(TOP), None, []
    for bar in bars:
        if bar.group != group:
            y += GROUP_GAP if group is not None else 0
            group = bar.group
            if group:
                parts.append(f'<text x="4" y="{y + 13:g}" class="head">{escape(group)}</text>')
        parts.append(f'<text x="{NAMES - 8}" y="{y + 13:g}" text-anchor="end">{escape(bar.name)}</text>')
        parts += _bar(bar, y, room, f"c{names.index(bar.name) % COLOURS}")
        y += ROW
    grid = [
        f'<line x1="{NAMES + room * share:g}" x2="{NAMES + room * share:g}" y1="{TOP}" y2="{y:g}" class="grid"/>'
        f'<text x="{NAMES + room * share:g}" y="{y + 16:g}" text-anchor="middle">{100 * share:.0f}%</text>'
        for share in (0, 0.25, 0.5, 0.75, 1)
    ]
    return _svg([*grid, *parts], WIDTH, y + 24)


def _bar(bar: Bar, y: float, room: float, kind: str) -> list[str]:
    parts = []
    told = "missing"
    if bar.rate is None:
        parts.append(f'<text x="{NAMES + 6}" y="{y + 13:g}" class="absent">missing</text>')
    else:
        low, high = bar.rate.interval
        told = f"{100 * bar.rate.value:.1f} ({100 * low:.0f}–{100 * high:.0f})"
        parts.append(
            f'<rect x="{NAMES}" y="{y + 2:g}" width="{max(1, room * bar.rate.value):.1f}" height="{ROW - 6}" '
            f'class="{kind}"><title>{escape(bar.name)}: {told}, {bar.rate.count} of {bar.rate.of}</title></rect>'
        )
        a, b, middle = NAMES + room * low, NAMES + room * high, y + ROW / 2 - 1
        ends = f"M{a:.1f} {middle - 4:g}V{middle + 4:g}M{b:.1f} {middle - 4:g}V{middle + 4:g}"
        parts.append(f'<path class="whisker" d="M{a:.1f} {middle:g}H{b:.1f}{ends}"/>')
    if bar.paper is not None:
        parts.append(_diamond(NAMES + room * bar.paper, y + ROW / 2 - 1, f"paper: {100 * bar.paper:g}"))
        told += f", paper {100 * bar.paper:g}"
    parts.append(f'<text x="{NAMES + room + 10:g}" y="{y + 13:g}">{escape(told)}</text>')
    return parts


def sweep_chart(points: Sequence[Point]) -> str:
    """ESR over multiples of tau, on a logarithmic axis."""
    height, left, right, top, bottom = 320, 60, 60, 14, 62
    scales = [math.log10(point.scale) for point in points]
    first, last = min(scales), max(scales)

    def x(scale: float) -> float:
        return left + (WIDTH - left - right) * (math.log10(scale) - first) / max(1e-9, last - first)

    def y(share: float) -> float:
        return top + (height - top - bottom) * (1 - share)

    parts = []
    for share in (0, 0.25, 0.5, 0.75, 1):
        parts.append(f'<line x1="{left}" x2="{WIDTH - right}" y1="{y(share):g}" y2="{y(share):g}" class="grid"/>')
        parts.append(f'<text x="{left - 8}" y="{y(share) + 4:g}" text-anchor="end">{100 * share:.0f}%</text>')
    ours = [(x(p.scale), y(p.rate.value)) for p in points if p.rate is not None]
    paper = [(x(p.scale), y(p.paper)) for p in points if p.paper is not None]
    for kind, line in (("line", ours), ("paper-line", paper)):
        if len(line) > 1:
            parts.append(f'<polyline class="{kind}" points="{" ".join(f"{a:.1f},{b:.1f}" for a, b in line)}"/>')
    for point in points:
        at = x(point.scale)
        below = height - bottom + 18
        parts.append(f'<text x="{at:.1f}" y="{below}" text-anchor="middle">{point.scale:g} tau</text>')
        if point.paper is not None:
            parts.append(_diamond(at, y(point.paper), f"paper: {100 * point.paper:g}"))
        if point.rate is None:
            parts.append(f'<text x="{at:.1f}" y="{below + 16}" text-anchor="middle" class="absent">missing</text>')
            continue
        low, high = point.rate.interval
        told = f"{100 * point.rate.value:.1f}"
        parts.append(
            f'<path class="whisker" d="M{at:.1f} {y(low):.1f}V{y(high):.1f}"/>'
            f'<circle cx="{at:.1f}" cy="{y(point.rate.value):.1f}" r="4.5" class="c3"><title>{told}</title></circle>'
            f'<text x="{at + 9:.1f}" y="{y(point.rate.value) - 7:.1f}">{told}</text>'
        )
        if point.interventions is not None:
            share = f"{100 * point.interventions:.0f}%"
            parts.append(f'<text x="{at:.1f}" y="{below + 16}" text-anchor="middle">{share}</text>')
    return _svg(parts, WIDTH, height)


def _diamond(x: float, y: float, told: str) -> str:
    return f'<path class="paper" d="M{x:.1f} {y - 5:.1f}l5 5l-5 5l-5 -5z"><title>{escape(told)}</title></path>'


def _svg(parts: Sequence[str], width: float, height: float) -> str:
    size = f'viewBox="0 0 {width:g} {height:g}" width="{width:g}" height="{height:g}"'
    return f'<svg {size} role="img">{"".join(parts)}</svg>'
