"""The rows of one episode in LeRobot's columns, and the schema of the data files."""

import json
from collections.abc import Mapping

import numpy as np
import pyarrow as pa

from jiti.curate.export.features import DERIVED, INDEX, Shape
from jiti.curate.export.planned import PlannedEpisode, segments_table
from jiti.curate.returns import mc_returns
from jiti.curate.rewards import frame_rewards
from jiti.episodes.lerobot_index import episode_id_of

_TYPES = {"float32": pa.float32(), "bool": pa.bool_(), "int64": pa.int64()}


def data_schema(shapes: Mapping[str, Shape]) -> pa.Schema:
    """Of the data files, as lerobot's `datasets` writes it: lists of a fixed size, a plain value for one number."""
    fields: list[pa.Field] = []
    described: dict[str, object] = {}
    for key, shape in shapes.items():
        if shape.dtype == "video":
            continue
        value = {"dtype": shape.dtype, "_type": "Value"}
        if shape.shape == (1,):
            fields.append(pa.field(key, pa.float32()))
            described[key] = value
        else:
            fields.append(pa.field(key, pa.list_(pa.float32(), shape.shape[0])))
            described[key] = {"feature": value, "length": shape.shape[0], "_type": "List"}
    for key, dtype in (DERIVED | INDEX).items():
        fields.append(pa.field(key, _TYPES[dtype]))
        described[key] = {"dtype": dtype, "_type": "Value"}
    return pa.schema(fields, metadata={"huggingface": json.dumps({"info": {"features": described}})})


def episode_columns(
    planned: PlannedEpisode, numbers: Mapping[str, np.ndarray], fps: int, gamma: float, task_index: int
) -> dict[str, np.ndarray]:
    """All columns of one episode: (frames, size) for vectors, (frames,) for the rest."""
    count = planned.frames
    reward, annotated = frame_labels(planned)
    returns = mc_returns(reward, np.array([0, count]), gamma)
    last = np.zeros(count, bool)
    last[-1] = True
    frame_index = np.arange(count)
    columns = {key: values[:, 0] if values.shape[1] == 1 else values for key, values in numbers.items()}
    return columns | {
        "next.reward": reward,
        "next.done": last,
        "next.success": last & (planned.success is True),
        "elegance.annotated": annotated,
        "elegance.mc_return": returns.astype(np.float32),
        "timestamp": frame_index / fps,  # float64 as in lerobot's statistics; stored as float32
        "frame_index": frame_index,
        "episode_index": np.full(count, planned.index),
        "index": planned.first_frame + frame_index,
        "task_index": np.full(count, task_index),
    }


def frame_labels(planned: PlannedEpisode) -> tuple[np.ndarray, np.ndarray]:
    """Reward (frames,) float32 and whether a constraint is decided there (frames,) bool."""
    rewards = frame_rewards(segments_table(planned.segments), {episode_id_of(planned.index): planned.frames})
    return rewards.reward, rewards.annotated


def to_table(columns: Mapping[str, np.ndarray], schema: pa.Schema) -> pa.Table:
    """The columns as one Arrow table."""
    arrays = []
    for field in schema:
        values = columns[field.name]
        if pa.types.is_fixed_size_list(field.type):
            flat = pa.array(np.ascontiguousarray(values).reshape(-1), pa.float32())
            arrays.append(pa.FixedSizeListArray.from_arrays(flat, type=field.type))
        else:
            arrays.append(pa.array(values, field.type))
    return pa.Table.from_arrays(arrays, schema=schema)
