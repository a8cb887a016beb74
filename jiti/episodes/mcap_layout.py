"""Where the parts of an encoded message lie, so that thousands of alike messages are read at once.

A parser walks one message and gives its fields as a tree of places (`Number`, `Numbers`, `Text`, `Blob`) instead of
values. Messages of one stream mostly have the same layout, so the numbers of the rest are picked from the same places
of all of them with numpy, after a check that the bytes which decide the layout are the same.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

from jiti.errors import SourceError


class Undecodable(SourceError):
    """A message does not follow its schema; the message says how, without the place."""


class Number(NamedTuple):
    """One number. `code` is a numpy dtype, `unsigned`, `signed` or `zigzag` for a varint, or `constant`."""

    offset: int
    code: str
    size: int = 0
    """Bytes of a varint."""
    constant: float = 0.0


class Numbers(NamedTuple):
    """Numbers of one numpy dtype, one after another."""

    offset: int
    code: str
    length: int

    def split(self) -> list[Number]:
        size = np.dtype(self.code).itemsize
        return [Number(self.offset + k * size, self.code) for k in range(self.length)]


class Text(NamedTuple):
    """A string and where it lies."""

    offset: int
    length: int
    text: str


class Blob(NamedTuple):
    """Bytes of any meaning."""

    offset: int
    length: int


Tree = Mapping[str, Any]
"""Field name to Number, Numbers, Text, Blob, Tree, or a list of these; JSON gives plain values."""


class Fixed(NamedTuple):
    """Bytes that decide the layout of a message; of varints only the bits that say where they end."""

    offset: int
    length: int
    bits: int = 0xFF


class Parser(Protocol):
    """Reads the layout of a message in one encoding."""

    vectorized: bool
    """Whether the tree has places; otherwise it has values."""

    def parse(self, block: bytes, start: int, end: int) -> tuple[Tree, list[Fixed]]:
        """Fields of the message `block[start:end]`; offsets are into `block`. Raises Undecodable."""
        ...


@dataclass(frozen=True, slots=True)
class Layout:
    """Where the numbers of a message lie, and which bytes must be the same for another message to be alike."""

    positions: np.ndarray
    """(F,) int64 of the bytes that must be the same, from the message's start."""
    bits: np.ndarray
    """(F,) uint8: which bits of them."""
    expected: np.ndarray
    """(F,) uint8."""
    names: tuple[str, ...]
    numbers: tuple[Number, ...]
    """By name; offsets from the message's start."""

    def alike(self, messages: np.ndarray) -> np.ndarray:
        """Which of `messages` (N, size) uint8 have this layout: (N,) bool."""
        return ((messages[:, self.positions] & self.bits) == self.expected).all(1)

    def values(self, messages: np.ndarray) -> np.ndarray:
        """Their numbers: (N, len(names)) float64."""
        out = np.empty((len(messages), len(self.numbers)))
        by_kind: dict[tuple[str, int], list[int]] = {}
        for column, number in enumerate(self.numbers):
            by_kind.setdefault((number.code, number.size), []).append(column)
        for (code, size), columns in by_kind.items():
            if code == "constant":
                out[:, columns] = [self.numbers[c].constant for c in columns]
                continue
            starts = np.array([self.numbers[c].offset for c in columns])
            width = size or np.dtype(code).itemsize
            places = (starts[:, None] + np.arange(width)).reshape(-1)
            taken = np.take(messages, places, axis=1).reshape(len(messages), -1, width)
            out[:, columns] = _varints(taken, code) if size else taken.reshape(len(messages), -1).view(code)
        return out


def _varints(taken: np.ndarray, code: str) -> np.ndarray:
    """Values of varints (N, columns, bytes) uint8. Encoding: https://protobuf.dev/programming-guides/encoding."""
    width = taken.shape[-1]
    shifts = np.arange(width, dtype=np.uint64) * np.uint64(7)
    value = ((taken & 0x7F).astype(np.uint64) << shifts).sum(-1, dtype=np.uint64)
    if code == "zigzag":
        return (value >> np.uint64(1)).astype(np.int64) ^ -(value & np.uint64(1)).astype(np.int64)
    return value.astype(np.int64) if code == "signed" else value


def layout_of(
    block: bytes, start: int, fixed: Sequence[Fixed], names: tuple[str, ...], numbers: Sequence[Number]
) -> Layout:
    """The layout of one parsed message that starts at `start`."""
    bits: dict[int, int] = {}
    for place in fixed:
        for position in range(place.offset, place.offset + place.length):
            bits[position] = bits.get(position, 0) | place.bits
    at = np.array(sorted(bits), np.int64)
    masks = np.array([bits[p] for p in sorted(bits)], np.uint8)
    expected = np.frombuffer(block, np.uint8)[at] & masks
    moved = tuple(n if n.code == "constant" else n._replace(offset=n.offset - start) for n in numbers)
    return Layout(at - start, masks, expected, names, moved)
