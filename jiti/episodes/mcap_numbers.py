"""Numbers of many messages at once."""

from collections.abc import Sequence

import numpy as np

from jiti.episodes.mcap_components import Components
from jiti.episodes.mcap_layout import Fixed, Layout, Number, Parser, Undecodable, layout_of

MAX_LAYOUTS = 64
"""Layouts remembered a stream. Our choice: Protobuf's omitted zeros and times of different lengths give a dozen."""
MAX_GATHER_BYTES = 8 << 20
"""Bytes of messages copied side by side at a time. Our choice: small beside a chunk."""


class NumberDecoder:
    """Turns messages of one stream into rows of numbers under the names that the stream declares."""

    def __init__(self, parser: Parser, names: Sequence[str]) -> None:
        self._parser = parser
        self._columns = {name: column for column, name in enumerate(names)}
        self._layouts: dict[int, list[Layout]] = {}
        self._layout_count = 0
        self.missing: str | None = None
        """A component that some message lacks, once one was seen."""
        self.unknown: str | None = None
        """A component that some message has and the stream does not declare, once one was seen."""

    def decode(
        self, block: bytes, starts: np.ndarray, ends: np.ndarray, failures: dict[int, str]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Numbers of the messages `block[start:end]`: which of them (n,) int64 in order, and their values (n, size).

        A component that a message lacks is NaN; messages that do not follow their schema go to
        `failures`, by index with the reason.
        """
        values = np.full((len(starts), len(self._columns)), np.nan)
        good = np.ones(len(starts), bool)
        if not self._parser.vectorized:
            for index, (start, end) in enumerate(zip(starts.tolist(), ends.tolist(), strict=True)):
                good[index] = self._one(block, start, end, index, values, failures)
            return np.flatnonzero(good), values[good]
        sizes = ends - starts
        for size in np.unique(sizes).tolist():
            alike = np.flatnonzero(sizes == size)
            step = max(1, MAX_GATHER_BYTES // max(1, size))
            for part in range(0, len(alike), step):
                self._same_size(block, starts, size, alike[part : part + step], values, good, failures)
        return np.flatnonzero(good), values[good]

    def _same_size(
        self,
        block: bytes,
        starts: np.ndarray,
        size: int,
        rows: np.ndarray,
        values: np.ndarray,
        good: np.ndarray,
        failures: dict[int, str],
    ) -> None:
        """Decode the messages `rows`, all of `size` bytes, by the layouts known for that size; learn new ones."""
        messages = np.frombuffer(block, np.uint8)[starts[rows][:, None] + np.arange(size)]
        known = self._layouts.setdefault(size, [])
        for layout in known:
            rows, messages = self._by_layout(layout, rows, messages, values)
        while len(rows):
            start = int(starts[rows[0]])
            if self._layout_count >= MAX_LAYOUTS:
                for row in rows.tolist():
                    start = int(starts[row])
                    good[row] = self._one(block, start, start + size, row, values, failures)
                return
            try:
                layout = self._learn(block, start, start + size)
            except Undecodable as error:
                failures[int(rows[0])] = str(error)
                good[rows[0]] = False
                rows, messages = rows[1:], messages[1:]
                continue
            known.append(layout)
            self._layout_count += 1
            rows, messages = self._by_layout(layout, rows, messages, values)

    def _learn(self, block: bytes, start: int, end: int) -> Layout:
        tree, fixed = self._parser.parse(block, start, end)
        parts = Components(tree)
        fixed += [Fixed(label.offset, label.length) for label in parts.labels]
        return layout_of(block, start, fixed, tuple(parts.names), [p for p in parts.leaves if isinstance(p, Number)])

    def _by_layout(
        self, layout: Layout, rows: np.ndarray, messages: np.ndarray, values: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Fill in the rows that have a layout; returns the rest."""
        alike = layout.alike(messages)
        if alike.any():
            taken, columns = self._place(layout.names)
            values[rows[alike][:, None], columns] = layout.values(messages[alike])[:, taken]
        return rows[~alike], messages[~alike]

    def _place(self, names: Sequence[str]) -> tuple[list[int], list[int]]:
        """Which of a message's components the stream declares, and in which column each belongs."""
        taken = [index for index, name in enumerate(names) if name in self._columns]
        columns = [self._columns[names[index]] for index in taken]
        if len(taken) < len(names) and self.unknown is None:
            self.unknown = next(name for name in names if name not in self._columns)
        if len(taken) < len(self._columns) and self.missing is None:
            present = set(names)
            self.missing = next(name for name in self._columns if name not in present)
        return taken, columns

    def _one(self, block: bytes, start: int, end: int, row: int, values: np.ndarray, failures: dict[int, str]) -> bool:
        """Decode one message on its own; the way of JSON, and of messages that no layout fits."""
        try:
            tree, _ = self._parser.parse(block, start, end)
        except Undecodable as error:
            failures[row] = str(error)
            return False
        parts = Components(tree)
        taken, columns = self._place(parts.names)
        if self._parser.vectorized:
            layout = layout_of(block, start, [], tuple(parts.names), [p for p in parts.leaves if isinstance(p, Number)])
            found = layout.values(np.frombuffer(block, np.uint8)[None, start:end])[0]
        else:
            found = np.array([float(leaf) for leaf in parts.leaves])  # type: ignore[arg-type]
        values[row, columns] = found[taken]
        return True
