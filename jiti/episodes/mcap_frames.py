"""Single pictures of an MCAP recording, from the one chunk that holds each."""

from collections.abc import Iterator, Sequence

import av
import numpy as np

from jiti.episodes.clock import Clock
from jiti.episodes.mcap_contents import Contents
from jiti.episodes.mcap_layout import Undecodable
from jiti.episodes.mcap_pictures import Picture, PictureDecoder
from jiti.episodes.mcap_records import MESSAGE_RECORD, RECORD, McapFile, RecordDamaged, message_heads, unpack
from jiti.episodes.mcap_streams import McapStream
from jiti.episodes.video_decode import SampleDecoder, UndecodablePicture
from jiti.errors import SourceError


def decode_stills(
    file: McapFile, contents: Contents, stream: McapStream, clock: Clock, frames: Sequence[int]
) -> Iterator[tuple[int, av.VideoFrame]]:
    """Yield `(frame, picture)` of a stream that is not inter-coded; `frames` increase.

    A frame shows the latest picture at or before its time that can be used; of several with its time, the first
    shows the first. Frames before the first picture are left out. Raises SourceError for a picture that does not
    decode.
    """
    pictures = _Pictures(file, contents, stream)
    shown: tuple[int, av.VideoFrame] | None = None
    for frame, row in zip(frames, _rows(stream, clock, np.asarray(frames, np.int64)).tolist(), strict=True):
        while row >= 0 and (shown is None or shown[0] != row):
            picture = pictures.take(row)
            if picture is None:
                row -= 1
                continue
            try:
                shown = (row, SampleDecoder(picture.encoding, picture.raw).decode(picture.data, row)[0][1])
            except UndecodablePicture as error:
                raise SourceError(
                    f"{file.path.name}, {stream.name}, frame {frame}: the picture cannot be decoded: {error}. "
                    "Go on without this camera, or record the episode again."
                ) from error
        if row >= 0 and shown is not None:
            yield frame, shown[1]


def _rows(stream: McapStream, clock: Clock, frames: np.ndarray) -> np.ndarray:
    """The row that each frame shows, -1 before the first: (N,) int64."""
    frame_ns = clock.frame_ns[frames]
    last = np.searchsorted(stream.time_ns, frame_ns, side="right") - 1
    first = np.searchsorted(stream.time_ns, frame_ns, side="left")
    rank = frames - np.searchsorted(clock.frame_ns, frame_ns, side="left")
    return np.where(first <= last, np.minimum(first + rank, last), last)


class _Pictures:
    """Pictures by row; holds the chunk of the last one."""

    def __init__(self, file: McapFile, contents: Contents, stream: McapStream) -> None:
        parser, kind = stream.reading.parser, stream.reading.picture
        if parser is None or kind is None:
            raise SourceError(f"{file.path.name}, {stream.name}: it has no pictures that can be read.")
        self._file, self._contents, self._stream = file, contents, stream
        self._decoder = PictureDecoder(parser, kind)
        self._held: tuple[int, bytes] = (-1, b"")

    def take(self, row: int) -> Picture | None:
        """None when the picture cannot be used; reading the stream reports why."""
        number, offset = int(self._stream.rows.chunk[row]), int(self._stream.rows.offset[row])
        try:
            if self._held[0] != number:
                self._held = (number, unpack(self._file, self._contents.chunks[number]))
            block = self._held[1]
            if offset + MESSAGE_RECORD.itemsize > len(block):
                return None
            head = message_heads(block, np.array([offset]))[0]
            end = offset + RECORD.size + int(head["length"])
            right = head["op"] == 5 and int(head["channel"]) in self._stream.channels and end <= len(block)
            if not right or int(head["log"]) != int(self._stream.rows.time_ns[row]):
                return None
            return self._decoder.decode(block, offset + MESSAGE_RECORD.itemsize, end)
        except (RecordDamaged, Undecodable):
            return None
