"""An episode as a Rerun recording, streamed to the viewer in the page. The annotator's only Rerun calls.

One timeline, `time`: nanoseconds since frame 0, such that the latest picture at `display_ns[i]` is frame `i`.
Pictures pass through undecoded.
"""

import os
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from jiti.annotate.web.ahead import by_time
from jiti.episodes.clock import Clock
from jiti.episodes.episode import INTER_CODED, Batch, Episode, ImageBatch, NumericBatch, Stream
from jiti.episodes.video_decode import raw_frame, to_rgb

if TYPE_CHECKING:
    import rerun as rr

TIMELINE = "time"
PLAYABLE = frozenset({"jpeg", "png", "raw", "h264", "av1"})
"""Encodings that Chromium and Rerun's web viewer show as they are; the rest is transcoded to H.264."""
MAX_PLOTS = 6
"""Numeric streams that are drawn. Our choice: more are unreadable on a laptop."""
MAX_PLOT_ROWS = 20_000
"""Rows of one numeric stream that are drawn; beyond, every n-th is. Our choice: ten a pixel."""

FLUSH_BYTES = 16 << 20
"""Bytes handed to Rerun before its encoder is waited for: it runs beside the reader, and memory stays bounded."""

_PLOT_WORDS = ("gripper", "action", "command", "state", "joint", "force", "wrench", "torque", "contact", "pose", "eef")

os.environ.setdefault("RERUN_ANALYTICS_ENABLED", "false")  # Rerun sends usage statistics unless told not to.


def plotted_streams(streams: Sequence[Stream], limit: int = MAX_PLOTS) -> list[str]:
    """Names of the numeric streams worth drawing: grippers, actions, states and forces first, then recording order."""

    def rank(stream: Stream) -> int:
        name = stream.name.lower()
        return next((k for k, word in enumerate(_PLOT_WORDS) if word in name), len(_PLOT_WORDS))

    numeric = [s for s in streams if s.kind == "numeric" and s.count > 1]
    return [s.name for s in sorted(numeric, key=rank)[:limit]]


def entity_path(stream: str) -> str:
    """The stream's name as a Rerun entity path, with what Rerun gives a meaning escaped."""
    import rerun as rr

    return rr.new_entity_path([part for part in stream.split("/") if part])


def stream_recording(
    episode: Episode,
    recording_id: str,
    *,
    transcode: Callable[[str], Iterator[ImageBatch]] | None = None,
    on_progress: Callable[[int], None] | None = None,
) -> Iterator[bytes]:
    """Yield the episode as the bytes of an .rrd, piece by piece, in one pass over the source.

    `transcode(stream)` gives the pictures of a camera that the viewer cannot take as recorded;
    given, it is used for every camera. `on_progress` is called with the last frame that was sent.
    Memory is bounded by one batch of the reader.
    """
    import rerun as rr

    recording = rr.RecordingStream("jiti", recording_id=recording_id)
    pipe = recording.binary_stream()
    cameras = [s for s in episode.streams.values() if s.kind in ("camera", "depth")]
    plots = plotted_streams(list(episode.streams.values()))
    recording.send_blueprint(_blueprint(cameras, plots), make_active=True)
    _log_statics(recording, episode, cameras, plots, transcoded=transcode is not None)

    def pieces() -> Iterator[Batch]:
        if transcode is None:
            yield from episode.read([s.name for s in cameras] + plots)
        else:
            if plots:
                yield from episode.read(plots)
            yield from by_time([transcode(camera.name) for camera in cameras])

    reference = _FramePlacer(episode.clock)
    unflushed = 0
    for batch in pieces():
        if batch.stream == episode.clock.reference:
            times = reference.place(batch.time_ns)
        else:
            times = batch.time_ns - episode.clock.frame_ns[0]
            # What came before the first frame holds at it; a latched message may stand at 1970. Video needs its order.
            if not (isinstance(batch, ImageBatch) and batch.encoding in INTER_CODED):
                times = np.maximum(times, 0)
        _log_batch(recording, episode.streams[batch.stream], batch, times)
        if on_progress and batch.stream == (episode.clock.reference or batch.stream) and len(times):
            on_progress(int(np.searchsorted(episode.clock.display_ns, times[-1])))
        unflushed += size_bytes(batch)
        if piece := pipe.read(flush=unflushed > FLUSH_BYTES):
            yield piece
        unflushed = 0 if unflushed > FLUSH_BYTES else unflushed
    if piece := pipe.read(flush=True):
        yield piece


def size_bytes(batch: Batch) -> int:
    """What a batch holds: encoded pictures, or numbers."""
    return sum(len(d) for d in batch.data) if isinstance(batch, ImageBatch) else batch.values.nbytes


def warm() -> None:
    """Load Rerun and what a first recording needs of it, which takes two seconds, while the browser starts."""
    camera = Stream("/camera", "camera", 1, None, (), "jpeg")
    _blueprint([camera], ["/numbers"])


class _FramePlacer:
    """Puts each picture of the reference camera at its own frame, also where stamps repeat."""

    def __init__(self, clock: Clock) -> None:
        self._frame_ns, self._display_ns = clock.frame_ns, clock.display_ns
        self._last = -1

    def place(self, time_ns: np.ndarray) -> np.ndarray:
        """Display times (N,) int64 of the pictures with these stamps, which come in order."""
        steps = np.arange(len(time_ns))
        first = np.searchsorted(self._frame_ns, time_ns, side="left")
        frames = np.maximum(np.maximum.accumulate(first - steps), self._last + 1) + steps
        last = np.searchsorted(self._frame_ns, time_ns, side="right") - 1
        frames = np.minimum(frames, np.maximum(last, 0))
        self._last = int(frames[-1]) if len(frames) else self._last
        return self._display_ns[frames]


def _blueprint(cameras: Sequence[Stream], plots: Sequence[str]) -> Any:
    import rerun.blueprint as rrb

    views = [rrb.Spatial2DView(origin=entity_path(c.name), name=c.name) for c in cameras]
    charts = [
        rrb.TimeSeriesView(origin=entity_path(p), name=p, plot_legend=rrb.PlotLegend(visible=False)) for p in plots
    ]
    rows: list[Any] = []
    if views:
        rows.append(rrb.Horizontal(*views) if len(views) <= 3 else rrb.Grid(*views))
    if charts:
        shown = [*charts[:2], rrb.Tabs(*charts[2:])] if len(charts) > 3 else charts
        rows.append(rrb.Horizontal(*shown))
    hidden = [p(state="hidden") for p in (rrb.TimePanel, rrb.SelectionPanel, rrb.BlueprintPanel)]
    shares = [3, 1] if len(rows) == 2 else [1]
    return rrb.Blueprint(rrb.Vertical(*rows, row_shares=shares) if rows else rrb.TextDocumentView(), *hidden)


def _log_statics(
    recording: "rr.RecordingStream",
    episode: Episode,
    cameras: Sequence[Stream],
    plots: Sequence[str],
    *,
    transcoded: bool,
) -> None:
    import rerun as rr

    for camera in cameras:
        codec = "h264" if transcoded else camera.encoding
        if codec in INTER_CODED:
            recording.log(
                entity_path(camera.name), rr.VideoStream(codec=getattr(rr.VideoCodec, codec.upper())), static=True
            )
    for name in plots:
        stream = episode.streams[name]
        recording.log(entity_path(name), rr.SeriesLines(names=list(stream.names) or [name]), static=True)


def _log_batch(recording: "rr.RecordingStream", stream: Stream, batch: Batch, times: np.ndarray) -> None:
    import rerun as rr

    columns: Any
    if isinstance(batch, NumericBatch):
        stride = max(1, stream.count // MAX_PLOT_ROWS)
        values, times = batch.values[::stride], times[::stride]
        if not values.size:
            return
        flat = rr.Scalars.columns(scalars=np.ascontiguousarray(values).ravel())
        columns = flat.partition(np.full(len(values), values.shape[1]))
    elif batch.encoding in INTER_CODED:
        columns = rr.VideoStream.columns(sample=_blobs(batch.data))
    elif batch.raw is None:
        media = [f"image/{batch.encoding}"] * len(batch.data)
        kind = rr.EncodedDepthImage if stream.kind == "depth" else rr.EncodedImage
        columns = kind.columns(blob=_blobs(batch.data), media_type=media)
    else:
        columns = _raw_columns(stream, batch)
    index = rr.TimeColumn(TIMELINE, duration=times.astype("timedelta64[ns]"))
    recording.send_columns(entity_path(batch.stream), [index], columns)


def _blobs(data: Sequence[bytes]) -> pa.ListArray:
    """Byte strings as Rerun's Blob array, with one copy; its own conversion takes longer than reading the file."""
    offsets = np.concatenate([[0], np.cumsum([len(d) for d in data])]).astype(np.int32)
    joined = pa.UInt8Array.from_buffers(pa.uint8(), int(offsets[-1]), [None, pa.py_buffer(b"".join(data))])
    blob = pa.list_(pa.field("item", pa.uint8(), nullable=False))
    return pa.ListArray.from_arrays(pa.array(offsets), joined, type=blob)


_RAW_FORMATS: "dict[str, tuple[rr.datatypes.ColorModelLike, rr.datatypes.ChannelDatatypeLike]]" = {
    "rgb8": ("RGB", "U8"),
    "bgr8": ("BGR", "U8"),
    "rgba8": ("RGBA", "U8"),
    "bgra8": ("BGRA", "U8"),
    "mono8": ("L", "U8"),
    "8UC1": ("L", "U8"),
    "8UC3": ("BGR", "U8"),
    "mono16": ("L", "U16"),
    "16UC1": ("L", "U16"),
    "32FC1": ("L", "F32"),
}
"""ROS 2 names of pixel formats to Rerun's colour model and data type."""


def _raw_columns(stream: Stream, batch: ImageBatch) -> Any:
    import rerun as rr

    assert batch.raw is not None
    raw, data = batch.raw, batch.data
    model, datatype = _RAW_FORMATS.get(raw.pixel_format, ("RGB", "U8"))
    kind = rr.DepthImage if stream.kind == "depth" else rr.Image
    row_bytes = raw.width * len(str(model)) * {"U8": 1, "U16": 2, "F32": 4}[str(datatype)]
    if raw.pixel_format not in _RAW_FORMATS:  # Bayer and YUV: Rerun takes them in other layouts
        data = [to_rgb(raw_frame(picture, raw)).tobytes() for picture in data]
    elif raw.row_stride != row_bytes:
        data = [_unpadded(picture, raw.row_stride, row_bytes, raw.height) for picture in data]
    layout = rr.components.ImageFormat(width=raw.width, height=raw.height, color_model=model, channel_datatype=datatype)
    return kind.columns(buffer=_blobs(data), format=[layout] * len(data))


def _unpadded(picture: bytes, row_stride: int, row_bytes: int, height: int) -> bytes:
    return b"".join(picture[y * row_stride : y * row_stride + row_bytes] for y in range(height))


def needs_transcoding(episode: Episode, max_image_bytes: int) -> str | None:
    """Why the viewer cannot take this recording's pictures as they are, or None when it can."""
    for stream in episode.streams.values():
        if stream.kind in ("camera", "depth") and stream.encoding not in PLAYABLE:
            return f"{stream.name} is {stream.encoding}, which browsers do not play"
    if episode.image_bytes > max_image_bytes:
        return f"its pictures take {episode.image_bytes / 2**30:.1f} GiB, more than the viewer can hold"
    return None
