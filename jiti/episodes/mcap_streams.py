"""The streams of an MCAP recording: channels by topic, what is in their messages, and their times."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from mcap.records import Channel

from jiti.episodes.clock import FIXED_RATE_HZ, stretches_in_order, unwrap_together
from jiti.episodes.episode import INTER_CODED, Stream, StreamKind
from jiti.episodes.keyframes import is_key_frame
from jiti.episodes.mcap_components import Components, text_in
from jiti.episodes.mcap_contents import METADATA_NAME, Contents, Rows
from jiti.episodes.mcap_decode import Reading, reading_of
from jiti.episodes.mcap_layout import Tree, Undecodable
from jiti.episodes.mcap_pictures import Picture, PictureDecoder, picture_shape
from jiti.episodes.mcap_records import MESSAGE_RECORD, McapFile, RecordDamaged, message_heads, unpack

TRIES = 8
"""Chunks, and messages a chunk, that are tried for a first message that can be decoded. Our choice."""

MAX_RATE_HZ = 1000.0
"""Beyond which a recorder's rate is not believed: frames are kept in memory. Our choice."""
_TASK_TOPIC = re.compile(r"(task|instruction|language|prompt)", re.IGNORECASE)
_TASK_FIELDS = ("instruction", "language_instruction", "task", "task_description", "language", "prompt")


@dataclass(slots=True)
class McapStream:
    """One stream: the messages of the channels that share a topic and a schema."""

    name: str
    channels: tuple[int, ...]
    reading: Reading
    schema: str
    rows: Rows
    """Messages in the order in which they are shown; `time_ns` is the log time as recorded."""
    time_ns: np.ndarray
    """(N,) int64, non-decreasing: log times with clock jumps undone."""
    number: np.ndarray
    """(N,) int64: place of each message in recording order."""
    kind: StreamKind = "other"
    encoding: str = ""
    shape: tuple[int, ...] = ()
    names: tuple[str, ...] = ()
    text: str | None = None
    """What the first message says, of a topic that is named like a task."""
    notes: list[str] = field(default_factory=list)
    """What is wrong with it, as `Problem.what`."""

    def describe(self) -> Stream:
        """As the episode lists it."""
        rate_hz = 1e9 / self.period_ns if self.period_ns else None
        count = len(self.time_ns)
        return Stream(self.name, self.kind, count, rate_hz, self.shape, self.encoding, self.schema, self.names)

    @property
    def period_ns(self) -> int:
        """Median time between messages that differ in time; 0 when there are no two."""
        steps = np.diff(self.time_ns)
        steps = steps[steps > 0]
        return int(np.median(steps)) if len(steps) else 0


def streams_of(contents: Contents) -> list[McapStream]:
    """Streams by channel id. Channels with the same topic, encoding and schema are one stream."""
    groups: dict[tuple, list[Channel]] = {}
    for _, channel in sorted(contents.channels.items()):
        schema = contents.schemas.get(channel.schema_id)
        what = (schema.name, schema.encoding, schema.data) if schema else (channel.schema_id,)
        groups.setdefault((channel.topic, channel.message_encoding, what), []).append(channel)
    streams: dict[str, McapStream] = {}
    for channels in groups.values():
        first = channels[0]
        name = first.topic
        while name in streams:
            name += f" (channel {first.id})"
        schema = contents.schemas.get(first.schema_id)
        rows = _merged([contents.rows[c.id] for c in channels if c.id in contents.rows])
        numbers = np.arange(len(rows.time_ns))
        reading = reading_of(first, schema)
        encoding = (schema.name if schema else "") or first.message_encoding
        streams[name] = McapStream(
            name,
            tuple(c.id for c in channels),
            reading,
            schema.name if schema else "",
            rows,
            rows.time_ns,
            numbers,
            encoding=encoding,
        )
    return list(streams.values())


def _merged(parts: Sequence[Rows]) -> Rows:
    if len(parts) == 1:
        return parts[0]
    if not parts:
        return Rows(np.empty(0, np.int64), np.empty(0, np.int32), np.empty(0, np.int64))
    rows = Rows(*(np.concatenate([getattr(p, name) for p in parts]) for name in ("time_ns", "chunk", "offset")))
    return _picked(rows, np.lexsort((rows.offset, rows.chunk)))


def _picked(rows: Rows, order: np.ndarray) -> Rows:
    return Rows(rows.time_ns[order], rows.chunk[order], rows.offset[order])


def put_in_order(streams: Sequence[McapStream]) -> None:
    """Undo clock jumps in all streams and put their messages in order of time, with a note on each stream changed.

    Video stays in recording order, in which alone it decodes: a picture stamped earlier than one before it gets that
    one's time.
    """
    positions = [s.rows.chunk.astype(np.int64) << 32 | s.rows.offset for s in streams]
    unwrapped = unwrap_together([s.rows.time_ns for s in streams], positions)
    for stream, (time_ns, jumps) in zip(streams, unwrapped, strict=True):
        for jump in jumps.tolist():
            back_s = (stream.rows.time_ns[jump - 1] - stream.rows.time_ns[jump]) / 1e9 if jump else 0.0
            if 0 < jump < len(time_ns) and back_s > 0:
                back = f"its clock jumps back by {back_s:.3f} s at message {jump}"
                stream.notes.append(f"{back}; its times go on from there without a gap")
        steps = np.diff(time_ns)
        if (steps >= 0).all():
            stream.time_ns = time_ns
            continue
        if stream.encoding in INTER_CODED:
            _put_video_in_order(stream, time_ns)
            continue
        count, most_s = int((steps < 0).sum()), -int(steps.min()) / 1e9
        _reorder(stream, time_ns, np.argsort(time_ns, kind="stable"))
        stream.notes.append(
            f"its messages are out of order in {count} places, by up to {most_s:.3f} s; they are given in order of time"
        )


def _reorder(stream: McapStream, time_ns: np.ndarray, order: np.ndarray) -> None:
    stream.rows, stream.time_ns, stream.number = _picked(stream.rows, order), time_ns[order], stream.number[order]


def _put_video_in_order(stream: McapStream, time_ns: np.ndarray) -> None:
    """Whole stretches may change places; inside of one, pictures need those that were recorded before them."""
    order = stretches_in_order(time_ns)
    if order is not None:
        _reorder(stream, time_ns, order)
        stream.notes.append("its pictures are recorded in stretches that are out of order; these are put in order")
        time_ns = stream.time_ns
    stream.time_ns = np.maximum.accumulate(time_ns)
    moved_ns = stream.time_ns - time_ns
    if moved_ns.any():
        stream.notes.append(
            f"{int((moved_ns > 0).sum())} of its pictures are stamped earlier than one before, by up to "
            f"{int(moved_ns.max()) / 1e9:.3f} s; they are shown at the time of the latest before them"
        )


class Sampler:
    """Looks at a first and a last message of each stream to learn what they hold."""

    def __init__(self, file: McapFile, contents: Contents) -> None:
        self._file = file
        self._contents = contents
        self._held: tuple[int, bytes] | None = None

    def sample(self, streams: Sequence[McapStream]) -> None:
        """Fill in kind, encoding, shape and names of the streams that can be read.

        Streams are taken in the order of their chunks, so that each chunk is unpacked once and one is held at a time.
        """
        wanted = [s for s in streams if len(s.time_ns) and s.reading.parser and self._matters(s)]
        firsts: dict[str, tuple[str, ...]] = {}
        for stream in sorted(wanted, key=lambda s: int(s.rows.chunk[0])):
            if stream.reading.role == "picture":
                self._picture(stream)
            else:
                firsts[stream.name] = self._numbers(stream, backwards=False)
        for stream in sorted(wanted, key=lambda s: int(s.rows.chunk[-1])):
            if stream.reading.role == "numbers":
                first = firsts[stream.name]
                last = self._numbers(stream, backwards=True)
                stream.names = (*first, *(name for name in last if name not in set(first)))
                if stream.names:
                    stream.kind, stream.shape = "numeric", (len(stream.names),)

    def _matters(self, stream: McapStream) -> bool:
        return stream.reading.role != "other"

    def _numbers(self, stream: McapStream, *, backwards: bool) -> tuple[str, ...]:
        for tree in self._trees(stream, backwards=backwards):
            if stream.text is None:
                stream.text = _task_in(stream.name, tree)
            return tuple(Components(tree).names)
        return ()

    def _picture(self, stream: McapStream) -> None:
        if stream.reading.parser is None or stream.reading.picture is None:
            return
        decoder = PictureDecoder(stream.reading.parser, stream.reading.picture)
        reason = "its chunks are corrupt"
        for block, start, end in self._messages(stream, backwards=False):
            try:
                picture = decoder.decode(block, start, end)
            except Undecodable as error:
                reason = str(error)
                continue
            if stream.kind == "other":
                stream.kind = "depth" if picture.depth else "camera"
                stream.encoding = picture.encoding
            stream.shape = picture_shape(picture)
            if picture.encoding not in INTER_CODED:
                return
            if is_key_frame(picture.encoding, picture.data):
                stream.shape = _video_shape(picture)
                return
            if not stream.notes:
                stream.notes.append("it does not start with a key frame; what comes before the first cannot be shown")
        if stream.kind != "other":
            return
        stream.notes.append(f"none of the pictures that were looked at can be used: {reason}")

    def _trees(self, stream: McapStream, *, backwards: bool) -> Iterator[Tree]:
        if stream.reading.parser is None:
            return
        for block, start, end in self._messages(stream, backwards=backwards):
            try:
                yield stream.reading.parser.parse(block, start, end)[0]
            except Undecodable:
                continue  # reading the stream counts and reports it

    def _messages(self, stream: McapStream, *, backwards: bool) -> Iterator[tuple[bytes, int, int]]:
        """Messages to look at: block, start and end of payload."""
        numbers = np.unique(stream.rows.chunk)
        for number in (numbers[::-1] if backwards else numbers)[:TRIES].tolist():
            block = self._block(number)
            offsets = stream.rows.offset[stream.rows.chunk == number]
            offsets = offsets[offsets + MESSAGE_RECORD.itemsize <= len(block)]
            offsets = (offsets[::-1] if backwards else offsets)[:TRIES]
            heads = message_heads(block, offsets)
            for offset, head in zip(offsets.tolist(), heads, strict=True):
                end = offset + 9 + int(head["length"])
                if head["op"] == 5 and int(head["channel"]) in stream.channels and end <= len(block):
                    yield block, offset + MESSAGE_RECORD.itemsize, end

    def _block(self, number: int) -> bytes:
        """An unpacked chunk; empty when it is corrupt, which reading it reports."""
        if self._held is None or self._held[0] != number:
            try:
                self._held = (number, unpack(self._file, self._contents.chunks[number]))
            except RecordDamaged:
                self._held = (number, b"")
        return self._held[1]


def _task_in(topic: str, tree: Tree) -> str | None:
    """The instruction that a message states: all of a topic named like one, or a field named like one."""
    if _TASK_TOPIC.search(topic.rsplit("/", 1)[-1]):
        return text_in(tree)
    for name in _TASK_FIELDS:
        if name in tree and (text := text_in({name: tree[name]})):
            return text
    return None


def task_of(contents: Contents, streams: Sequence[McapStream]) -> str | None:
    """The instruction in the metadata records, else in a topic."""
    for name in _TASK_FIELDS:
        for record in contents.metadata:
            values: Mapping[str, str] = {key.lower(): value.strip() for key, value in record.metadata.items()}
            if values.get(name):
                return values[name]
    return next((stream.text for stream in streams if stream.text), None)


def own_metadata(contents: Contents) -> Mapping[str, str]:
    """What a recorder of jiti wrote of itself; empty for recordings of others."""
    return {k: v for record in contents.metadata if record.name == METADATA_NAME for k, v in record.metadata.items()}


def frame_rate_of(contents: Contents) -> float:
    """Rate of the frames of a recording without cameras: what jiti's recorder says, else a fixed one."""
    try:
        rate_hz = float(own_metadata(contents).get("rate_hz", FIXED_RATE_HZ))
    except ValueError:
        return FIXED_RATE_HZ
    return rate_hz if 0 < rate_hz <= MAX_RATE_HZ else FIXED_RATE_HZ


def _video_shape(picture: Picture) -> tuple[int, ...]:
    """Size of a video by decoding a key frame; () when it does not decode."""
    from jiti.episodes.video_decode import SampleDecoder, UndecodablePicture

    decoder = SampleDecoder(picture.encoding)
    try:
        frames = decoder.decode(picture.data, 0) or decoder.flush()
    except UndecodablePicture:
        return ()
    return (frames[0][1].height, frames[0][1].width, 3) if frames else ()
