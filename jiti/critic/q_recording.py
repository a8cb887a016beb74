"""Q over time as a Rerun recording: values, rewards, returns and segments under the episode's own video and numbers.

The critic's only Rerun calls. The annotator's recording of the episode is taken as it is, and merged with what is drawn
here, under the same recording id.
"""

import os
import subprocess
import sys
import tempfile
import uuid
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jiti.annotate.web.recording import TIMELINE, entity_path, stream_recording
from jiti.durable import make_folder, replacing
from jiti.episodes.episode import Episode
from jiti.errors import SaveFailed

if TYPE_CHECKING:
    import rerun as rr


def write_q_recording(
    path: Path, episode: Episode, q: np.ndarray, mc_return: np.ndarray, reward: np.ndarray, annotated: np.ndarray
) -> None:
    """Write an .rrd of an episode with values (E, frames) of its members, and what the dataset says of its frames.

    `mc_return`, `reward` and `annotated` are (frames,). Raises SaveFailed.
    """
    import rerun as rr

    make_folder(path.parent)
    recording_id = str(uuid.uuid4())
    drawn = rr.RecordingStream("jiti", recording_id=recording_id)
    pipe = drawn.binary_stream()
    drawn.send_blueprint(_blueprint(episode), make_active=True)
    index = rr.TimeColumn(TIMELINE, duration=episode.clock.display_ns[: q.shape[1]].astype("timedelta64[ns]"))
    _lines(drawn, index, "critic/q", np.vstack([q.min(0), q]), ["least", *(f"member {n}" for n in range(len(q)))])
    _lines(drawn, index, "critic/mc_return", mc_return[None], ["Monte-Carlo return"])
    _lines(drawn, index, "label/reward", np.stack([reward, annotated.astype(float)]), ["reward", "decided"])
    with tempfile.TemporaryDirectory(dir=path.parent, prefix=".tmp-") as folder:
        parts = Path(folder) / "episode.rrd", Path(folder) / "values.rrd"
        with parts[0].open("wb") as file:
            for piece in stream_recording(episode, recording_id):
                file.write(piece)
        parts[1].write_bytes(pipe.read(flush=True) or b"")
        with replacing(path) as temporary:
            _merge(parts, temporary)


def _merge(parts: tuple[Path, Path], out: Path) -> None:
    """Rerun's own merge: files that are put one behind the other play, but Rerun's readers refuse their checksums."""
    line = [sys.executable, "-m", "rerun", "rrd", "merge", *map(str, parts), "-o", str(out)]
    quiet = {**os.environ, "RUST_LOG": "error"}
    done = subprocess.run(line, capture_output=True, text=True, check=False, env=quiet)
    if done.returncode or not out.exists():
        raise SaveFailed(f"{parts[0].parent.parent}: Rerun could not merge a recording: {done.stderr[-300:]}")


def _lines(recording: "rr.RecordingStream", index: Any, entity: str, rows: np.ndarray, names: list[str]) -> None:
    """Lines (n, frames) with names, in one plot."""
    import rerun as rr

    recording.log(entity, rr.SeriesLines(names=names), static=True)
    scalars = rr.Scalars.columns(scalars=np.ascontiguousarray(rows.T, np.float64).ravel())
    recording.send_columns(entity, [index], scalars.partition(np.full(rows.shape[1], len(rows))))


def _blueprint(episode: Episode) -> Any:
    import rerun.blueprint as rrb

    cameras = [s for s in episode.streams.values() if s.kind in ("camera", "depth")]
    rows: list[Any] = [rrb.Horizontal(*(rrb.Spatial2DView(origin=entity_path(c.name), name=c.name) for c in cameras))]
    charts = [
        rrb.TimeSeriesView(origin="critic", name="Q and return"),
        rrb.TimeSeriesView(origin="label", name="reward, decided"),
    ]
    return rrb.Blueprint(rrb.Vertical(*(rows if cameras else []), *charts))
