"""Axes of charts: round numbers, and where they stand."""

import math
from collections.abc import Sequence
from html import escape

WIDTH, HEIGHT = 460, 210
"""Of a chart, in the page's pixels."""
LEFT, RIGHT, BOTTOM, TOP = 44, 8, 34, 18
"""Room beside the plot."""


def round_ticks(low: float, high: float, about: int = 5, *, whole: bool = False) -> list[float]:
    """The multiples of 1, 2 or 5 times a power of ten from `low` to `high`: `about` of them, or fewer."""
    if not high > low:
        return [low]
    raw = (high - low) / about
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(power * factor for factor in (1, 2, 5, 10) if power * factor >= raw * (1 - 1e-9))
    step = max(1.0, step) if whole else step
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [round(k * step, 12) for k in range(first, last + 1)]


def x_of(value: float, low: float, high: float) -> float:
    """Where a value stands on the horizontal axis."""
    return round(LEFT + (WIDTH - LEFT - RIGHT) * (value - low) / (high - low), 2)


def y_of(value: float, low: float, high: float) -> float:
    """Where a value stands on the vertical axis."""
    return round(HEIGHT - BOTTOM - (HEIGHT - TOP - BOTTOM) * (value - low) / (high - low), 2)


def x_axis(ticks: Sequence[float], low: float, high: float, name: str) -> list[str]:
    """Numbers below the plot, and what they are."""
    parts = []
    for value in ticks:
        x = x_of(value, low, high)
        parts.append(f'<line x1="{x}" x2="{x}" y1="{HEIGHT - BOTTOM}" y2="{HEIGHT - BOTTOM + 4}" class="grid"/>')
        parts.append(f'<text x="{x}" y="{HEIGHT - BOTTOM + 16}" text-anchor="middle">{value:g}</text>')
    middle = (LEFT + WIDTH - RIGHT) / 2
    return [*parts, f'<text x="{middle}" y="{HEIGHT - 2}" text-anchor="middle">{escape(name)}</text>']


def y_axis(ticks: Sequence[float], low: float, high: float, name: str = "") -> list[str]:
    """Lines across the plot, their numbers at its left, and what they are."""
    parts = []
    for value in ticks:
        y = y_of(value, low, high)
        parts.append(f'<line x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{y}" y2="{y}" class="grid"/>')
        parts.append(f'<text x="{LEFT - 6}" y="{y + 4}" text-anchor="end">{value:g}</text>')
    if name:
        middle = (TOP + HEIGHT - BOTTOM) / 2
        parts.append(
            f'<text transform="translate(12 {middle:g}) rotate(-90)" text-anchor="middle">{escape(name)}</text>'
        )
    return parts
