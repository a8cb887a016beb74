"""The contents of an MCAP file read from its start, as far as it can be read: what `mcap recover` does."""

from dataclasses import dataclass

from mcap.opcode import Opcode

from jiti.episodes.mcap_contents import MAX_METADATA_BYTES, Contents, ContentsBuilder, Loss, lost_with
from jiti.episodes.mcap_records import (
    MAGIC,
    MAX_UNPACKED_BYTES,
    MESSAGE_HEAD,
    RECORD,
    Chunk,
    McapFile,
    RecordDamaged,
    chunk_at,
)
from jiti.episodes.mcap_summary import entries_in

RUN_BYTES = 1 << 20
"""Messages outside of chunks are read in runs of about this size. Our choice: that of a usual chunk."""
MAX_INDEX_BYTES = 64 << 20
"""Largest message index that is read to count what a corrupt chunk held. Our choice: four million messages."""

_DEFINITIONS = (Opcode.HEADER, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA)


@dataclass(slots=True)
class _Run:
    """Messages that stand one after another outside of chunks."""

    start: int = 0
    end: int = 0


def read_unindexed(file: McapFile, reason: str) -> Contents:
    """Contents by walking over all records. `reason` says what is wrong with the summary; empty if nothing is."""
    builder = ContentsBuilder(file)
    losses = builder.contents.losses
    if reason:
        remedy = "What is readable was read from the start; run `mcap recover` on it to get a file that opens faster"
        losses.append(Loss("the index", f"cannot be used, because {reason}", {}, remedy=remedy))
    run = _Run()
    position = len(MAGIC)
    while position < file.size:
        if position + RECORD.size > file.size:
            losses.append(_cut(file, position, "a record", RECORD.size))
            break
        opcode, length = file.record(position)
        end = position + RECORD.size + length
        if opcode == Opcode.MESSAGE and MESSAGE_HEAD.size <= length <= MAX_UNPACKED_BYTES and end <= file.size:
            if run.end != position or run.end - run.start >= RUN_BYTES:
                _close(builder, run)
                run = _Run(position)
            run.end = position = end
            continue
        if opcode == 0 or (end > file.size and not _is_known(opcode)):
            losses.append(_not_records(file, position))
            break
        if opcode in (Opcode.DATA_END, Opcode.FOOTER):
            break
        if opcode == Opcode.CHUNK:
            _close(builder, run)
            run = _Run()
            _add_chunk(file, builder, position, length)
        elif opcode == Opcode.MESSAGE and end <= file.size:
            losses.append(Loss(f"the message at byte {position}", f"is corrupt (its length is {length} bytes)"))
        elif end <= file.size:
            _define(file, builder, opcode, position, length)
        if end > file.size:
            losses.append(_cut(file, position, f"a {Opcode(opcode).name.lower()} record", RECORD.size + length))
            break
        position = end
    _close(builder, run)
    return builder.finish()


def _close(builder: ContentsBuilder, run: _Run) -> None:
    if run.end > run.start:
        size = run.end - run.start
        chunk = Chunk(len(builder.contents.chunks), run.start, run.start, size, size, "", 0)
        builder.add(chunk)
        builder.scan_into(chunk)


def _add_chunk(file: McapFile, builder: ContentsBuilder, position: int, length: int) -> None:
    number = len(builder.contents.chunks)
    try:
        chunk = chunk_at(file, number, position, length)
    except RecordDamaged as error:
        chunk = Chunk(number, position, position, 0, 0, "", 0)
        builder.add(chunk)
        builder.contents.losses.append(lost_with(chunk, str(error), None))
        return
    builder.add(chunk)
    try:
        builder.add_entries(number, builder.scan(chunk))
    except RecordDamaged as error:
        entries = _following_index(file, position + RECORD.size + length)
        builder.contents.losses.append(lost_with(chunk, str(error), entries))


def _following_index(file: McapFile, position: int) -> dict[int, bytes] | None:
    """The message index records that follow a chunk, which say what it held when it cannot be unpacked."""
    start = position
    while position + RECORD.size <= file.size and position - start <= MAX_INDEX_BYTES:
        opcode, length = file.record(position)
        if opcode != Opcode.MESSAGE_INDEX or position + RECORD.size + length > file.size:
            break
        position += RECORD.size + length
    return entries_in(file.read(start, position - start)) if position > start else None


def _define(file: McapFile, builder: ContentsBuilder, opcode: int, position: int, length: int) -> None:
    if opcode not in _DEFINITIONS or length > MAX_METADATA_BYTES:
        return
    builder.define_or_lose(opcode, file.read(position + RECORD.size, length), f"the record at byte {position}")


def _is_known(opcode: int) -> bool:
    return opcode in Opcode.__members__.values()


def _cut(file: McapFile, position: int, what: str, needed: int) -> Loss:
    there = f"{file.size - position} of its {needed} bytes are there"
    return Loss(f"byte {file.size}", f"is where the file ends, inside {what} at byte {position}: {there}", None)


def _not_records(file: McapFile, position: int) -> Loss:
    what = "are not MCAP records, and what they were is lost"
    return Loss(f"the {file.size - position} bytes from byte {position} on", what, None)
