"""What stands beside data and videos: info.json, tasks, the table of episodes, statistics; and `meta/jiti/`."""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import batched
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from jiti.annotate.folder import segments_path
from jiti.annotate.segment_file import FileInfo, Recording, encode
from jiti.annotate.segments import Segment
from jiti.curate.export.features import DERIVED, INDEX, Shape
from jiti.curate.export.plan import Plan
from jiti.curate.export.planned import PlannedEpisode
from jiti.curate.export.shards import CHUNK_FILES, DATA_FILE_BYTES, VIDEO_FILE_BYTES, Place, Places
from jiti.curate.export.stats import QUANTILES, Stats
from jiti.episodes.lerobot_index import episode_id_of
from jiti.episodes.lerobot_reader import LeRobotReader
from jiti.tasks.task import Task

DATA_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
VIDEO_PATH = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
EPISODES_PATH = "meta/episodes/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
ROWS_AT_ONCE = 100
"""Episodes of a row group of the table. Our choice: statistics of 130 numbers in 100 episodes are a megabyte."""

EPISODES_SCHEMA = pa.schema(
    [
        pa.field("episode_index", pa.int64(), nullable=False),
        pa.field("source", pa.string(), nullable=False),
        pa.field("episode_id", pa.string(), nullable=False),
        pa.field("fingerprint", pa.string(), nullable=False),
        pa.field("task_id", pa.string()),
        pa.field("success", pa.bool_()),
        pa.field("split", pa.string(), nullable=False),
        pa.field("frames", pa.int64(), nullable=False),
    ]
)
"""Columns of `meta/jiti/episodes.parquet`."""


def write_info(root: Path, plan: Plan, videos: Mapping[str, Mapping[str, Any]], robot: str | None) -> None:
    """`meta/info.json`; `videos` has what lerobot notes of each camera's video."""
    features: dict[str, Any] = {}
    for key, shape in plan.shapes.items():
        features[key] = shape.to_info() | ({"info": dict(videos[key])} if shape.dtype == "video" else {})
    for key, dtype in (DERIVED | INDEX).items():
        features[key] = {"dtype": dtype, "shape": [1], "names": None}
    info = {
        "codebase_version": "v3.0",
        "fps": plan.fps,
        "features": features,
        "total_episodes": len(plan.episodes),
        "total_frames": sum(episode.frames for episode in plan.episodes),
        "total_tasks": len(plan.instructions),
        "chunks_size": CHUNK_FILES,
        "data_files_size_in_mb": DATA_FILE_BYTES >> 20,
        "video_files_size_in_mb": VIDEO_FILE_BYTES >> 20,
        "data_path": DATA_PATH,
        "video_path": VIDEO_PATH if videos else None,
        "robot_type": robot,
        "splits": {"train": f"0:{len(plan.episodes)}"},
    }
    _write(root / "meta" / "info.json", json.dumps(info, indent=4, ensure_ascii=False))


def write_tasks(root: Path, plan: Plan) -> None:
    """`meta/tasks.parquet`, as pandas writes a frame whose index is the instruction: lerobot reads it with pandas."""
    texts = plan.instructions

    def column(name: str | None, kind: str, numpy: str, metadata: Any = None) -> dict[str, Any]:
        return {"name": name, "field_name": name, "pandas_type": kind, "numpy_type": numpy, "metadata": metadata}

    about = {
        "index_columns": ["task"],
        "column_indexes": [column(None, "unicode", "object", {"encoding": "UTF-8"})],
        "columns": [column("task_index", "int64", "int64"), column("task", "unicode", "object")],
        "attributes": {},
        "creator": {"library": "pyarrow", "version": pa.__version__},
        "pandas_version": "2.3.3",
    }
    schema = pa.schema([("task_index", pa.int64()), ("task", pa.string())], metadata={"pandas": json.dumps(about)})
    table = pa.Table.from_arrays([pa.array(range(len(texts)), pa.int64()), pa.array(texts, pa.string())], schema=schema)
    pq.write_table(table, root / "meta" / "tasks.parquet")


def write_stats(root: Path, stats: Mapping[str, Stats]) -> None:
    """`meta/stats.json`."""
    plain = {key: {name: value.tolist() for name, value in one.items()} for key, one in stats.items()}
    _write(root / "meta" / "stats.json", json.dumps(plain, indent=4))


def stats_to_json(stats: Mapping[str, Stats]) -> dict[str, Any]:
    """For the journal; `stats_from_json` gives the same numbers of the same types back."""
    return {
        key: {name: [str(value.dtype), value.tolist()] for name, value in one.items()} for key, one in stats.items()
    }


def stats_from_json(told: Mapping[str, Any]) -> dict[str, Stats]:
    """See `stats_to_json`."""
    return {key: {name: np.array(value, dtype) for name, (dtype, value) in one.items()} for key, one in told.items()}


def write_episode_table(
    root: Path, plan: Plan, rows: Iterable[tuple[PlannedEpisode, Mapping[str, Any], Mapping[str, Stats]]]
) -> None:
    """`meta/episodes/**`, a few episodes at a time. A row gives the episode, its places by column, its statistics."""
    schema = _table_schema(plan.shapes)
    places = Places(DATA_FILE_BYTES)
    writer: pq.ParquetWriter | None = None
    try:
        for group in batched(rows, ROWS_AT_ONCE):
            made = [_row(planned, where, stats) for planned, where, stats in group]
            # What a row takes as float64; a bound that needs no look at the file.
            size = sum(8 * sum(value.size for one in stats.values() for value in one.values()) for _, _, stats in group)
            place = places.next(size, len(made))
            if place.frames_before == 0:
                if writer is not None:
                    writer.close()
                path = root / place.path(EPISODES_PATH)
                path.parent.mkdir(parents=True, exist_ok=True)
                writer = pq.ParquetWriter(path, schema, compression="snappy", use_dictionary=True)
            for row in made:
                row |= {"meta/episodes/chunk_index": place.chunk, "meta/episodes/file_index": place.file}
            assert writer is not None
            writer.write_table(pa.Table.from_pylist(made, schema=schema))
    finally:
        if writer is not None:
            writer.close()


def data_columns(place: Place, planned: PlannedEpisode) -> dict[str, Any]:
    """Where the rows of an episode are."""
    return {
        "data/chunk_index": place.chunk,
        "data/file_index": place.file,
        "dataset_from_index": planned.first_frame,
        "dataset_to_index": planned.first_frame + planned.frames,
    }


def video_columns(key: str, place: Place, frames: int, fps: int) -> dict[str, Any]:
    """Where the pictures of a camera of an episode are."""
    return {
        f"videos/{key}/chunk_index": place.chunk,
        f"videos/{key}/file_index": place.file,
        f"videos/{key}/from_timestamp": place.frames_before / fps,
        f"videos/{key}/to_timestamp": (place.frames_before + frames) / fps,
    }


def write_labels(root: Path, plan: Plan) -> None:
    """`meta/jiti/segments/**`: what counts, as the label store has it; needs everything else of the dataset.

    Readers know a labelled recording by its fingerprint, which is that of the finished dataset.
    """
    reader = LeRobotReader(root)
    for planned in plan.episodes:
        name = episode_id_of(planned.index)
        by_annotator: dict[str, list[Segment]] = {}
        for annotator, segment in planned.segments:
            by_annotator.setdefault(annotator, []).append(segment)
        if not by_annotator:
            continue
        recording = Recording(planned.frames, float(plan.fps), reader.fingerprint(name))
        for annotator, segments in by_annotator.items():
            path = segments_path(root / "meta" / "jiti", annotator, name)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(memoryview(encode(segments, FileInfo(1, annotator, {name: recording}))))


def write_own(root: Path, plan: Plan, about: Mapping[str, Any]) -> None:
    """`meta/jiti/`: episodes with source and split, the tasks, and how the dataset was made."""
    folder = root / "meta" / "jiti"
    folder.mkdir(parents=True, exist_ok=True)
    rows = [
        {name: getattr(e, name) for name in EPISODES_SCHEMA.names if name != "episode_index"}
        | {"episode_index": e.index}
        for e in plan.episodes
    ]
    pq.write_table(pa.Table.from_pylist(rows, schema=EPISODES_SCHEMA), folder / "episodes.parquet")
    _write(folder / "catalogue.toml", to_toml(plan.tasks))
    _write(folder / "curate.json", json.dumps(about, indent=2, ensure_ascii=False) + "\n")


def to_toml(tasks: Sequence[Task]) -> str:
    """Tasks as `jiti.tasks.catalogue_file` reads them; those of the package with `replace`, so that they can be read
    beside it."""
    return "\n".join(line for task in tasks for line in _task_lines(task))


def _task_lines(task: Task) -> Iterator[str]:
    yield "[[task]]"
    yield f"id = {json.dumps(task.task_id)}"
    yield f"instruction = {_text(task.instruction)}"
    if task.aliases:
        yield f"aliases = [{', '.join(map(_text, task.aliases))}]"
    if task.source:
        yield f"source = {_text(task.source)}"
    if task.bddl:
        yield f"bddl = {_text(task.bddl)}"
    yield "replace = true"
    for itc in task.itcs:
        yield ""
        yield "[[task.itc]]"
        yield f"id = {_text(itc.itc_id.removeprefix(f'{task.task_id}/'))}"
        yield f"criterion = {_text(str(itc.criterion))}"
        yield f"statement = {_text(itc.statement)}"
        for name, value in (("check", itc.check), ("goal", itc.goal)):
            if value:
                yield f"{name} = {_text(value)}"
    yield ""


def _text(value: str) -> str:
    """A TOML string; JSON's escapes are TOML's, but for DEL."""
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def _table_schema(shapes: Mapping[str, Shape]) -> pa.Schema:
    numbers: pa.DataType = pa.list_(pa.float64())
    pictures: pa.DataType = pa.list_(pa.list_(pa.list_(pa.float64())))
    fields = [
        pa.field("episode_index", pa.int64()),
        pa.field("tasks", pa.list_(pa.string())),
        pa.field("length", pa.int64()),
        *(pa.field(name, pa.int64()) for name in ("data/chunk_index", "data/file_index")),
        *(pa.field(name, pa.int64()) for name in ("dataset_from_index", "dataset_to_index")),
    ]
    for key in (key for key, shape in shapes.items() if shape.dtype == "video"):
        fields += [pa.field(f"videos/{key}/{name}", pa.int64()) for name in ("chunk_index", "file_index")]
        fields += [pa.field(f"videos/{key}/{name}", pa.float64()) for name in ("from_timestamp", "to_timestamp")]
    kinds = {key: pictures if shape.dtype == "video" else numbers for key, shape in shapes.items()}
    kinds |= dict.fromkeys((*DERIVED, *INDEX), numbers)
    for key, kind in kinds.items():
        for name in ("min", "max", "mean", "std", "count", *QUANTILES):
            fields.append(pa.field(f"stats/{key}/{name}", pa.list_(pa.int64()) if name == "count" else kind))
    fields += [pa.field(f"meta/episodes/{name}", pa.int64()) for name in ("chunk_index", "file_index")]
    return pa.schema(fields)


def _row(planned: PlannedEpisode, where: Mapping[str, Any], stats: Mapping[str, Stats]) -> dict[str, Any]:
    row = {"episode_index": planned.index, "tasks": [planned.instruction], "length": planned.frames, **where}
    for key, one in stats.items():
        row |= {f"stats/{key}/{name}": value.tolist() for name, value in one.items()}
    return row


def _write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
