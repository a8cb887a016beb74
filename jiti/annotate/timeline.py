"""The rows of one partition after a sequence of edits, with undo and redo: pure state, no files."""

from bisect import bisect_right
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace
from operator import attrgetter
from typing import Any

from jiti.annotate.history import Entry
from jiti.annotate.segment_file import Recording
from jiti.annotate.segments import Segment
from jiti.errors import LabelError

_in_order = attrgetter("start_frame", "end_frame", "segment_id")
_version_of = attrgetter("version")


class Timeline:
    """Edits on top of the rows at `version`. An undo is an edit as well, so nothing is ever taken out of the sequence.

    The `*_entry` methods build the next entry and change nothing; `append` takes it in. Between the two, the
    entry is made durable.
    """

    def __init__(self, version: int = 0, rows: Iterable[Segment] = ()) -> None:
        self.version = version
        self._rows = {segment.segment_id: segment for segment in rows}
        self._entries: list[Entry] = []
        self._undo: list[Entry] = []
        self._redo: list[Entry] = []

    @property
    def can_undo(self) -> bool:
        return bool(self._undo)

    @property
    def can_redo(self) -> bool:
        return bool(self._redo)

    @property
    def last(self) -> Entry | None:
        return self._entries[-1] if self._entries else None

    def segments(self) -> tuple[Segment, ...]:
        """By start, then end, then id."""
        return tuple(sorted(self._rows.values(), key=_in_order))

    def segments_with(self, entry: Entry) -> tuple[Segment, ...]:
        """What `segments` will be after `append(entry)`."""
        return tuple(sorted(self._rows_with(entry).values(), key=_in_order))

    def since(self, version: int) -> list[dict[str, Any]]:
        """Edits after `version`, oldest first, as JSON objects."""
        first = bisect_right(self._entries, version, key=_version_of)
        return [entry.to_json() for entry in self._entries[first:]]

    def edit_entry(self, action: str, put: Sequence[Segment], remove: Sequence[str], at: int) -> Entry | None:
        """The entry that puts rows in (new, or in place of those with the same id) and takes others out.

        None when that changes nothing. `created_at` stays that of the row that is replaced; `updated_at` becomes
        `at`. Raises LabelError for a row that is not there or that is named twice.
        """
        ids = [segment.segment_id for segment in put] + list(remove)
        if twice := [name for name, count in Counter(ids).items() if count > 1]:
            raise LabelError(f"segment {twice[0]} is named twice in one edit {action!r}")
        if unknown := [name for name in remove if name not in self._rows]:
            raise LabelError(f"segment {unknown[0]} cannot be removed: there is none of that id")
        old = {name: self._rows[name] for name in ids if name in self._rows}
        new = []
        for segment in put:
            known = old.get(segment.segment_id)
            created_at = known.created_at if known else segment.created_at or at
            if known == replace(segment, created_at=created_at, updated_at=known.updated_at if known else 0):
                del old[segment.segment_id]
            else:
                new.append(replace(segment, created_at=created_at, updated_at=at))
        if not old and not new:
            return None
        return Entry(self.version + 1, at, "edit", action, tuple(old.values()), tuple(new))

    def undo_entry(self, at: int) -> Entry:
        """The entry that takes the last edit back. Raises LabelError when there is none."""
        if not self._undo:
            raise LabelError("there is nothing to undo")
        edit = self._undo[-1]
        return Entry(self.version + 1, at, "undo", edit.action, edit.after, edit.before, of=edit.version)

    def redo_entry(self, at: int) -> Entry:
        """The entry that makes the last undone edit again. Raises LabelError when there is none."""
        if not self._redo:
            raise LabelError("there is nothing to redo")
        edit = self._redo[-1]
        return Entry(self.version + 1, at, "redo", edit.action, edit.before, edit.after, of=edit.version)

    def recording_entry(self, recording: Recording, at: int) -> Entry:
        """The entry that confirms what is labelled and touches no row."""
        return Entry(self.version + 1, at, "recording", "confirm", (), (), recording=recording)

    def recovered_entry(self, version: int, rows: Iterable[Segment], at: int) -> Entry:
        """The entry that leads from here to rows of a later version whose own entries are lost."""
        there = {segment.segment_id: segment for segment in rows}
        before = tuple(s for name, s in self._rows.items() if there.get(name) != s)
        after = tuple(s for name, s in there.items() if self._rows.get(name) != s)
        return Entry(version, at, "recovered", "recovered", before, after)

    def append(self, entry: Entry) -> None:
        """Take an entry in, newest last."""
        self._rows = self._rows_with(entry)
        self.version = entry.version
        self._entries.append(entry)
        if entry.kind in ("edit", "recovered"):
            self._undo.append(entry)
            self._redo.clear()
        elif entry.kind in ("undo", "redo"):
            source, target = (self._undo, self._redo) if entry.kind == "undo" else (self._redo, self._undo)
            if source and source[-1].version == entry.of:
                target.append(source.pop())
            else:  # the edit itself is lost: nothing before it can be undone
                self._undo.clear()
                self._redo.clear()

    def _rows_with(self, entry: Entry) -> dict[str, Segment]:
        rows = dict(self._rows)
        for segment in entry.before:
            rows.pop(segment.segment_id, None)
        for segment in entry.after:
            rows[segment.segment_id] = segment
        return rows


def rewound(rows: Iterable[Segment], entries: Sequence[Entry]) -> tuple[Segment, ...]:
    """The rows from which `entries`, oldest first, led to `rows`."""
    there = {segment.segment_id: segment for segment in rows}
    for entry in reversed(entries):
        for segment in entry.after:
            there.pop(segment.segment_id, None)
        for segment in entry.before:
            there[segment.segment_id] = segment
    return tuple(there.values())
