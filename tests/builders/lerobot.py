"""Small LeRobot datasets with numbered pictures, written with pyarrow and PyAV alone.

In row `i` of episode `e` the picture carries the number `e * number_step + i`, `observation.state` is
`[i, e, gripper]` and `action` is `[-i, gripper]`; the gripper closes in the middle third.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from tests.builders.pictures import numbered

FRONT = "observation.images.front"
WRIST = "observation.images.wrist"


@dataclass(frozen=True)
class Encoder:
    """How PyAV encodes a video."""

    name: str
    options: tuple[tuple[str, str], ...] = ()
    pix_fmt: str = "yuv420p"


H264 = Encoder("libx264", (("preset", "ultrafast"), ("g", "10"), ("bf", "0")))
H264_B_FRAMES = Encoder("libx264", (("preset", "veryfast"), ("g", "12"), ("bf", "2"), ("b-adapt", "0")))
H264_LONG_GOP = Encoder("libx264", (("preset", "ultrafast"), ("g", "1000"), ("bf", "0"), ("sc_threshold", "0")))
H264_444 = Encoder("libx264", (("preset", "ultrafast"), ("g", "10"), ("bf", "0")), "yuv444p")
AV1 = Encoder("libsvtav1", (("g", "2"), ("crf", "30"), ("preset", "8")))
"""lerobot 0.6's default (lerobot/configs/video.py, VideoEncoderConfig) but for its preset 12, which drops changes
between flat test pictures."""
AV1_LONG_GOP = Encoder("libsvtav1", (("g", "64"), ("crf", "30"), ("preset", "8")))
MPEG4 = Encoder("mpeg4", (("g", "12"), ("bf", "0"), ("b", "4M")))
H265 = Encoder("libx265", (("preset", "ultrafast"), ("g", "12"), ("x265-params", "log-level=error")))
VP9 = Encoder("libvpx-vp9", (("g", "12"), ("deadline", "realtime"), ("cpu-used", "8")))
IMAGES = "images"
"""Instead of an encoder: PNG pictures inside the Parquet files."""
ENCODERS = {
    "h264": H264,
    "h264_b_frames": H264_B_FRAMES,
    "h264_long_gop": H264_LONG_GOP,
    "h264_444": H264_444,
    "av1": AV1,
    "av1_long_gop": AV1_LONG_GOP,
    "mpeg4": MPEG4,
    "h265": H265,
    "vp9": VP9,
}


def write_v3(
    root: Path,
    lengths: Sequence[int] = (12, 9, 15),
    *,
    encoder: Encoder | str = H264,
    cameras: Sequence[str] = (FRONT,),
    fps: int = 30,
    size: tuple[int, int] = (160, 120),
    tasks: Sequence[str] = ("Pick up the red cup.",),
    episodes_a_video: int = 1000,
    episodes_a_data_file: int = 1000,
    number_step: int = 0,
) -> Path:
    """Write a v3.0 dataset; returns `root`. `size` is (width, height); episode `e` has task `e % len(tasks)`."""
    images = encoder == IMAGES
    info = _info("v3.0", lengths, tasks, cameras, fps, size, encoder)
    info |= {
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": None if images else "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4",
    }
    write_info(root, info)
    _write_tasks_v3(root, tasks)
    starts = np.concatenate([[0], np.cumsum(lengths)])
    rows: list[dict[str, Any]] = [
        {
            "episode_index": e,
            "tasks": [tasks[e % len(tasks)]],
            "length": length,
            "data/chunk_index": 0,
            "data/file_index": e // episodes_a_data_file,
            "dataset_from_index": int(starts[e]),
            "dataset_to_index": int(starts[e + 1]),
            "stats/action/mean": [0.0, 0.0],
            "meta/episodes/chunk_index": 0,
            "meta/episodes/file_index": 0,
        }
        for e, length in enumerate(lengths)
    ]
    for first in range(0, len(lengths), episodes_a_data_file):
        group = range(first, min(first + episodes_a_data_file, len(lengths)))
        path = root / f"data/chunk-000/file-{first // episodes_a_data_file:03d}.parquet"
        tables = [
            episode_table(
                e, lengths[e], int(starts[e]), e % len(tasks), fps, cameras if images else (), size, number_step
            )
            for e in group
        ]
        write_tables(path, tables)
    if not images:
        for camera in cameras:
            for first in range(0, len(lengths), episodes_a_video):
                group = range(first, min(first + episodes_a_video, len(lengths)))
                file_index = first // episodes_a_video
                path = root / f"videos/{camera}/chunk-000/file-{file_index:03d}.mp4"
                pictures = [episode_pictures(e, lengths[e], camera, size, number_step) for e in group]
                write_video(path, pictures, encoder, fps)  # type: ignore[arg-type]
                start = 0
                for e in group:
                    rows[e] |= {
                        f"videos/{camera}/chunk_index": 0,
                        f"videos/{camera}/file_index": file_index,
                        f"videos/{camera}/from_timestamp": start / fps,
                        f"videos/{camera}/to_timestamp": (start + lengths[e]) / fps,
                    }
                    start += lengths[e]
    write_episodes(root, rows)
    return root


def write_v21(
    root: Path,
    lengths: Sequence[int] = (12, 9, 15),
    *,
    encoder: Encoder | str = H264,
    cameras: Sequence[str] = (FRONT,),
    fps: int = 30,
    size: tuple[int, int] = (160, 120),
    tasks: Sequence[str] = ("Pick up the red cup.",),
    number_step: int = 0,
) -> Path:
    """Write a v2.1 dataset: one Parquet file and one video a camera for each episode; returns `root`."""
    images = encoder == IMAGES
    info = _info("v2.1", lengths, tasks, cameras, fps, size, encoder)
    info |= {
        "total_videos": 0 if images else len(lengths) * len(cameras),
        "total_chunks": 1,
        "data_path": "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet",
        "video_path": "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4",
    }
    write_info(root, info)
    _write_lines(root / "meta/tasks.jsonl", [{"task_index": k, "task": task} for k, task in enumerate(tasks)])
    _write_lines(
        root / "meta/episodes.jsonl",
        [{"episode_index": e, "tasks": [tasks[e % len(tasks)]], "length": length} for e, length in enumerate(lengths)],
    )
    start = 0
    for e, length in enumerate(lengths):
        table = episode_table(e, length, start, e % len(tasks), fps, cameras if images else (), size, number_step)
        write_tables(root / f"data/chunk-000/episode_{e:06d}.parquet", [table])
        start += length
        if not images:
            for camera in cameras:
                path = root / f"videos/chunk-000/{camera}/episode_{e:06d}.mp4"
                write_video(path, [episode_pictures(e, length, camera, size, number_step)], encoder, fps)  # type: ignore[arg-type]
    return root


def episode_pictures(
    episode: int, length: int, camera: str, size: tuple[int, int], number_step: int = 0
) -> list[np.ndarray]:
    """The numbered pictures of one episode; the shade of grey tells cameras apart."""
    shade = 60 + 40 * (sum(camera.encode()) % 3)
    return [numbered(episode * number_step + i, *size, shade=shade) for i in range(length)]


def write_video(path: Path, episodes: Sequence[Sequence[np.ndarray]], encoder: Encoder, fps: int) -> None:
    """Encode each episode on its own, then join the packets into one file, as lerobot does."""
    path.parent.mkdir(parents=True, exist_ok=True)
    parts = []
    for k, pictures in enumerate(episodes):
        part = path.with_name(f".{path.stem}-{k}.mp4")
        _encode(part, pictures, encoder, fps)
        parts.append(part)
    with av.open(str(path), "w", options={"movflags": "faststart"}) as joined:
        stream, start = None, 0.0
        for part, pictures in zip(parts, episodes, strict=True):
            with av.open(str(part)) as source:
                if stream is None:
                    stream = joined.add_stream_from_template(source.streams.video[0], opaque=True)
                for packet in source.demux(video=0):
                    if packet.dts is None or packet.pts is None:
                        continue
                    offset = round(start / fps / packet.time_base)
                    packet.pts, packet.dts = packet.pts + offset, packet.dts + offset
                    packet.stream = stream
                    joined.mux(packet)
            start += len(pictures)
    for part in parts:
        part.unlink()


def _encode(path: Path, pictures: Sequence[np.ndarray], encoder: Encoder, fps: int) -> None:
    with av.open(str(path), "w") as container:
        stream: Any = container.add_stream(encoder.name, rate=Fraction(fps), options=dict(encoder.options))
        stream.height, stream.width = pictures[0].shape[:2]
        stream.pix_fmt = encoder.pix_fmt
        for picture in pictures:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        container.mux(stream.encode())


def png(picture: np.ndarray) -> bytes:
    """An RGB picture (height, width, 3) uint8 as a PNG file."""
    codec: Any = av.CodecContext.create("png", "w")
    codec.height, codec.width = picture.shape[:2]
    codec.pix_fmt, codec.time_base = "rgb24", Fraction(1, 30)
    packets = codec.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")) + codec.encode(None)
    return b"".join(bytes(packet) for packet in packets)


def gripper(length: int) -> np.ndarray:
    """Opening of the gripper (length,) float32: 1, then 0 in the middle third, then 1."""
    opening = np.ones(length, np.float32)
    opening[length // 3 : 2 * length // 3] = 0
    return opening


def episode_table(
    episode: int,
    length: int,
    start: int,
    task_index: int,
    fps: int,
    image_keys: Sequence[str] = (),
    size: tuple[int, int] = (160, 120),
    number_step: int = 0,
) -> pa.Table:
    """The rows of one episode as lerobot lays them out."""
    frames = np.arange(length)
    opening = gripper(length)
    state = np.stack([frames, np.full(length, episode), opening], 1).astype(np.float32)
    action = np.stack([-frames, opening], 1).astype(np.float32)
    columns: dict[str, Any] = {
        "observation.state": pa.FixedSizeListArray.from_arrays(state.ravel(), 3),
        "action": pa.FixedSizeListArray.from_arrays(action.ravel(), 2),
        "next.reward": pa.array((frames == length - 1).astype(np.float32)),
        "timestamp": pa.array((frames / fps).astype(np.float32)),
        "frame_index": pa.array(frames),
        "episode_index": pa.array(np.full(length, episode)),
        "index": pa.array(frames + start),
        "task_index": pa.array(np.full(length, task_index)),
    }
    for key in image_keys:
        cells = [
            {"bytes": png(picture), "path": f"frame-{i:06d}.png"}
            for i, picture in enumerate(episode_pictures(episode, length, key, size, number_step))
        ]
        columns[key] = pa.array(cells, pa.struct([("bytes", pa.binary()), ("path", pa.string())]))
    return pa.table(columns)


def write_tables(path: Path, tables: Sequence[pa.Table]) -> None:
    """Write one row group an episode."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with pq.ParquetWriter(path, tables[0].schema) as writer:
        for table in tables:
            writer.write_table(table)


def write_info(root: Path, info: dict[str, Any]) -> None:
    (root / "meta").mkdir(parents=True, exist_ok=True)
    (root / "meta/info.json").write_text(json.dumps(info, indent=4))


def read_info(root: Path) -> dict[str, Any]:
    return json.loads((root / "meta/info.json").read_text())


def write_episodes(root: Path, rows: Sequence[dict[str, Any]]) -> None:
    path = root / "meta/episodes/chunk-000/file-000.parquet"
    path.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(pa.Table.from_pylist(list(rows)), path)


def read_episodes(root: Path) -> list[dict[str, Any]]:
    return pq.read_table(root / "meta/episodes/chunk-000/file-000.parquet").to_pylist()


def _write_tasks_v3(root: Path, tasks: Sequence[str]) -> None:
    """As pandas writes a frame that is indexed by the task."""
    table = pa.table({"task_index": pa.array(range(len(tasks)), pa.int64()), "__index_level_0__": list(tasks)})
    pq.write_table(table, root / "meta/tasks.parquet")


def _write_lines(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    path.write_text("".join(json.dumps(row) + "\n" for row in rows))


def _info(
    version: str,
    lengths: Sequence[int],
    tasks: Sequence[str],
    cameras: Sequence[str],
    fps: int,
    size: tuple[int, int],
    encoder: Encoder | str,
) -> dict[str, Any]:
    width, height = size
    picture = {"shape": [height, width, 3], "names": ["height", "width", "channels"]}
    if isinstance(encoder, Encoder):
        codec = {"libx264": "h264", "libsvtav1": "av1", "libx265": "hevc", "libvpx-vp9": "vp9"}.get(
            encoder.name, encoder.name
        )
        picture |= {"dtype": "video", "info": {"video.fps": fps, "video.codec": codec, "video.is_depth_map": False}}
    else:
        picture |= {"dtype": "image"}
    scalar = {"shape": [1], "names": None}
    return {
        "codebase_version": version,
        "robot_type": "so100",
        "total_episodes": len(lengths),
        "total_frames": sum(lengths),
        "total_tasks": len(tasks),
        "chunks_size": 1000,
        "fps": fps,
        "splits": {"train": f"0:{len(lengths)}"},
        "features": {
            "observation.state": {
                "dtype": "float32",
                "shape": [3],
                "names": {"motors": ["frame", "episode", "gripper.pos"]},
            },
            "action": {"dtype": "float32", "shape": [2], "names": ["frame", "gripper.pos"]},
            **dict.fromkeys(cameras, picture),
            "next.reward": {"dtype": "float32", **scalar},
            "timestamp": {"dtype": "float32", **scalar},
            "frame_index": {"dtype": "int64", **scalar},
            "episode_index": {"dtype": "int64", **scalar},
            "index": {"dtype": "int64", **scalar},
            "task_index": {"dtype": "int64", **scalar},
        },
    }
