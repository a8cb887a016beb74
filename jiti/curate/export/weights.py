"""Weights for `lerobot-train`, in the form that lerobot's RA-BC reads: a progress for each frame.

lerobot (lerobot/rewards/sarm/rabc.py, 0.6.1) weighs the chunk that begins at frame t by how much the progress grows
over it, d = progress[t + K] - progress[t]: 1 where d > kappa (0.01), 0 where d < 0, and for d in between a share that
is near one half at d = 0. At an episode's end, its last frame stands for what is behind it.
"""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from jiti.annotate.segments import DEFAULT_WINDOW_FRAMES
from jiti.durable import replacing
from jiti.errors import UsageError

WEIGHTS_FILE = "sarm_progress.parquet"
"""Where lerobot looks in a dataset when no `--sample_weighting.progress_path` is given."""
SCHEMA = pa.schema(
    [
        pa.field("index", pa.int64(), nullable=False),
        pa.field("episode_index", pa.int64(), nullable=False),
        pa.field("frame_index", pa.int64(), nullable=False),
        pa.field("progress_sparse", pa.float32(), nullable=False),
    ]
)
"""Columns that lerobot reads (and `frame_index`, which its own files have); `sparse` is its default head."""


def label_progress(reward: np.ndarray, annotated: np.ndarray) -> np.ndarray:
    """(frames,) float32 of one episode: rewarded minus violated frames before each, in windows of 25.

    So a chunk that reaches into a satisfied segment weighs 1, one that reaches into a violated segment 0, and one
    without any label about one half.
    """
    gain = np.where(annotated, np.where(reward > 0, 1.0, -1.0), 0.0) / DEFAULT_WINDOW_FRAMES
    return np.concatenate([[0.0], np.cumsum(gain)[:-1]]).astype(np.float32)


def value_progress(value: np.ndarray, reward: np.ndarray) -> np.ndarray:
    """(frames,) float32 of one episode, by a critic: what was rewarded before each frame and is expected from it on.

    `value` (frames,) is Q of the chunk that was done at each frame. Alone it would not do: it falls while a segment
    is rewarded, for less is left to come. With what was rewarded it never falls where all goes as the critic expects
    (by 1 - gamma of the next value it grows), grows more where a chunk does better, and falls where one does worse.
    In windows of 25 frames, as `label_progress`.
    """
    before = np.concatenate([[0.0], np.cumsum(reward)[:-1]])
    return ((before + value) / DEFAULT_WINDOW_FRAMES).astype(np.float32)


def write_weights(path: Path, progress: Iterable[tuple[int, np.ndarray]]) -> None:
    """Write `(episode_index, progress (frames,))` of all episodes of a dataset, from 0 on, in order.

    From labels it is `label_progress`, from a critic `value_progress`. Raises UsageError for values that are not
    finite or an episode out of order.
    """
    with replacing(path) as temporary, pq.ParquetWriter(temporary, SCHEMA) as writer:
        first = 0
        for expected, (index, of_episode) in enumerate(progress):
            values = np.asarray(of_episode, np.float32)
            if index != expected:
                raise UsageError(f"weights for {path}: episode {index} follows {expected - 1}; give all, in order.")
            if values.ndim != 1 or not np.isfinite(values).all():
                raise UsageError(f"weights for {path}: those of episode {index} are not one finite number a frame.")
            frames = np.arange(len(values))
            columns = [frames + first, np.full(len(values), index), frames, values]
            arrays = [pa.array(column, field.type) for column, field in zip(columns, SCHEMA, strict=True)]
            writer.write_table(pa.Table.from_arrays(arrays, schema=SCHEMA))
            first += len(values)
