"""History files: what is read back, and what broken lines mean."""

import zlib
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jiti.annotate.history import Entry, Gap, Header, entry_line, header_line, scan
from jiti.errors import LabelError, NewerSchema
from tests.builders.labels import RECORDING, segment

PATH = Path("ep.jsonl")
HEADER = Header("anna", "ep", RECORDING)
LINES = [header_line(HEADER)] + [
    entry_line(Entry(version, version * 1000, "edit", "mark", (), (segment(rationale="a\nb “ü” \u2028"),)))
    for version in range(1, 6)
]


def test_reads_back_what_was_written() -> None:
    found = scan(PATH, b"".join(LINES))
    assert found.header == HEADER
    assert [entry.version for entry in found.entries] == [1, 2, 3, 4, 5]
    assert found.entries[0].after[0].rationale == "a\nb “ü” \u2028"
    assert b"".join(map(entry_line, found.entries)) == b"".join(LINES[1:])
    assert found.size == len(b"".join(LINES))
    assert found.gap is None
    assert found.after_gap == found.entries


def test_every_kind_of_entry_reads_back() -> None:
    old, new = segment(reward=None, confidence=0.25), segment(status="rejected", source="vlm", parent_id="p")
    entries = [
        Entry(1, 10, "edit", "nudge", (old,), (new,)),
        Entry(2, 11, "undo", "nudge", (new,), (old,), of=1),
        Entry(3, 12, "redo", "nudge", (old,), (new,), of=1),
        Entry(4, 13, "recording", "confirm", (), (), recording=RECORDING),
        Entry(9, 14, "recovered", "recovered", (), (segment(),)),
    ]
    found = scan(PATH, header_line(HEADER) + b"".join(map(entry_line, entries)))
    assert found.entries == tuple(entries)
    assert found.gap is None


@settings(deadline=None)
@given(st.integers(0, len(b"".join(LINES))))
def test_cut_anywhere_keeps_the_whole_lines(size: int) -> None:
    data = b"".join(LINES)[:size]
    found = scan(PATH, data)
    whole = data.count(b"\n")
    assert len(found.entries) == max(0, whole - 1)
    assert (found.header is None) == (whole == 0)
    assert found.size == len(b"".join(LINES[:whole]))
    assert found.gap is None


@settings(deadline=None)
@given(st.data())
def test_one_wrong_byte_is_a_gap_or_the_torn_end(data: st.DataObject) -> None:
    whole = b"".join(LINES)
    place = data.draw(st.integers(0, len(whole) - 1))
    byte = data.draw(st.integers(0, 255).filter(lambda b: b != whole[place]))
    found = scan(PATH, whole[:place] + bytes([byte]) + whole[place + 1 :])
    number = whole[:place].count(b"\n") + 1  # the line that is hit
    known = {entry.version for entry in found.entries} | ({0} if found.header else set())
    assert number - 1 not in known  # nothing that was changed is believed
    lost = {0, 1, 2, 3, 4, 5} - known
    assert lost <= {number - 1, number}  # two when the byte was the end of the line
    if found.gap:
        assert found.gap.line == number
        assert max(lost) <= found.gap.version <= max(lost) + 1
        assert all(entry.version > found.gap.version for entry in found.after_gap)
    else:
        assert max(lost) == 5


def test_a_missing_line_and_a_repeated_one_are_gaps() -> None:
    assert scan(PATH, b"".join(LINES[:2] + LINES[4:])).gap == Gap(3, 3)
    assert scan(PATH, b"".join(LINES[:3] + LINES[2:])).gap == Gap(4, 2)
    two_at_the_end = b"".join(LINES[:4]) + b"x\ny\n"
    assert scan(PATH, two_at_the_end).gap == Gap(5, 4)


def test_a_file_of_nothing_but_nulls_holds_nothing() -> None:
    found = scan(PATH, bytes(4096))
    assert (found.header, found.entries, found.size, found.gap) == (None, (), 0, None)


def test_a_later_schema_is_refused_by_name() -> None:
    line = header_line(HEADER)
    body = line.rpartition(b',"crc32"')[0].replace(b'"schema_version":1', b'"schema_version":7') + b"}"
    sealed = b'%s,"crc32":"%08x"}\n' % (body[:-1], zlib.crc32(body))
    with pytest.raises(NewerSchema, match=r"ep\.jsonl has schema version 7; jiti .* reads versions up to 1"):
        scan(PATH, sealed)


def test_sealed_lines_that_are_no_history_name_the_line() -> None:
    with pytest.raises(LabelError, match=r"ep\.jsonl, line 1 is not the start of a history"):
        scan(PATH, LINES[1])
    with pytest.raises(LabelError, match=r"ep\.jsonl, line 2 is not an edit"):
        scan(PATH, LINES[0] + LINES[0])
