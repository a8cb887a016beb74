"""`rewards.parquet`: rewards and returns of every labelled frame, derived from the segments and never edited."""

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from jiti.annotate.labels import read_labels
from jiti.annotate.segments import SCHEMA_VERSION
from jiti.curate.returns import GAMMA, mc_returns
from jiti.curate.rewards import frame_rewards
from jiti.curate.verdicts import RULE
from jiti.durable import make_folder, replacing

REWARDS_SCHEMA = pa.schema(
    [
        pa.field("episode_id", pa.dictionary(pa.int32(), pa.string()), nullable=False),
        pa.field("frame_index", pa.int64(), nullable=False),
        pa.field("timestamp", pa.float64(), nullable=False),
        pa.field("reward", pa.float32(), nullable=False),
        pa.field("annotated", pa.bool_(), nullable=False),
        pa.field("mc_return", pa.float32(), nullable=False),
    ]
)
"""`timestamp` is in seconds from the first frame at the recording's median rate."""


def write_rewards(labels_dir: Path, *, gamma: float = GAMMA) -> Path:
    """Derive `<labels>/rewards.parquet` again, atomically; the same labels and gamma give the same bytes.

    It has every frame of every episode that someone labelled. Raises LabelError when a label file cannot be read:
    rewards without it would be wrong without a word.
    """
    labels = read_labels(labels_dir).whole()
    recordings = dict(sorted(labels.by_episode().items()))
    rewards = frame_rewards(labels.segments, {name: about.frame_count for name, about in recordings.items()})
    returns = mc_returns(rewards.reward, rewards.offsets, gamma)

    lengths = np.diff(rewards.offsets)
    frame_index = np.arange(len(rewards.reward)) - np.repeat(rewards.offsets[:-1], lengths)
    rates_hz = np.array([about.frame_rate_hz for about in recordings.values()])
    about = {"schema_version": SCHEMA_VERSION, "gamma": gamma, "rule": RULE}
    table = pa.Table.from_arrays(
        [
            pa.DictionaryArray.from_arrays(
                np.repeat(np.arange(len(lengths), dtype=np.int32), lengths), pa.array(rewards.episode_ids, pa.string())
            ),
            pa.array(frame_index),
            pa.array(frame_index / np.repeat(rates_hz, lengths)),
            pa.array(rewards.reward),
            pa.array(rewards.annotated),
            pa.array(returns.astype(np.float32)),
        ],
        schema=REWARDS_SCHEMA.with_metadata({"jiti": json.dumps(about)}),
    )
    path = labels_dir / "rewards.parquet"
    make_folder(labels_dir)
    with replacing(path) as temporary:
        pq.write_table(table, temporary, compression="zstd")
    return path
