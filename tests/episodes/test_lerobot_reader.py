"""LeRobot datasets: every number and every picture at its frame, in every layout and codec."""

import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import av
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from jiti.episodes.episode import Episode, ImageBatch, NumericBatch, numbers
from jiti.episodes.lerobot_reader import LeRobotReader
from jiti.episodes.video import decode_frames
from jiti.episodes.video_decode import SampleDecoder, to_rgb
from jiti.errors import SourceError
from tests.builders.lerobot import (
    ENCODERS,
    FRONT,
    H264,
    H264_B_FRAMES,
    IMAGES,
    MPEG4,
    WRIST,
    episode_table,
    gripper,
    png,
    read_episodes,
    read_info,
    write_episodes,
    write_info,
    write_tables,
    write_v3,
    write_v21,
)
from tests.builders.pictures import numbered, read_number

LENGTHS = (12, 9, 15)
STEP = 100
"""Added to the pictures' numbers for each episode, so that another episode's picture is noticed."""


def shown(episode: Episode, camera: str = FRONT) -> tuple[list[int], list[int]]:
    """Numbers and times of all pictures that a viewer gets."""
    times, pictures = [], []
    decoder: SampleDecoder | None = None
    for batch in episode.read([camera]):
        assert isinstance(batch, ImageBatch)
        decoder = decoder or SampleDecoder(batch.encoding)
        for sample in batch.data:
            pictures += decoder.decode(sample, len(times))
            times.append(0)
        times[-len(batch.data) :] = batch.time_ns.tolist()
    pictures += decoder.flush() if decoder else []
    return [read_number(to_rgb(picture)) for _, picture in pictures], times


def clock_ns(length: int, fps: float = 30) -> list[int]:
    return [round(i * 1e9 / fps) for i in range(length)]


@pytest.mark.parametrize("encoder", [*ENCODERS, IMAGES])
@pytest.mark.parametrize("write", [write_v3, write_v21])
def test_every_picture_stands_at_its_frame(write: Any, encoder: str, tmp_path: Path) -> None:
    root = write(
        tmp_path / "d", LENGTHS, encoder=ENCODERS.get(encoder, IMAGES), cameras=(FRONT, WRIST), number_step=STEP
    )
    reader = LeRobotReader(root)
    assert [ref.episode_id for ref in reader.episodes()] == ["episode_000000", "episode_000001", "episode_000002"]
    assert [ref.frame_count for ref in reader.episodes()] == list(LENGTHS)
    for e, ref in enumerate(reader.episodes()):
        episode = reader.open(ref.episode_id)
        for camera in (FRONT, WRIST):
            found, times = shown(episode, camera)
            assert found == [e * STEP + i for i in range(LENGTHS[e])]
            assert times == clock_ns(LENGTHS[e])
            wanted = [0, 4, LENGTHS[e] - 1]
            direct = {f: read_number(picture) for f, picture in decode_frames(episode, camera, wanted)}
            assert direct == {f: e * STEP + f for f in wanted}
        assert episode.clock.reference == FRONT
        assert episode.clock.frame_ns.tolist() == clock_ns(LENGTHS[e])
        assert episode.problems == []
        size = sum(len(s) for b in episode.read([FRONT, WRIST]) if isinstance(b, ImageBatch) for s in b.data)
        assert size <= episode.image_bytes


@pytest.mark.parametrize("write", [write_v3, write_v21])
def test_numbers_have_the_episodes_rows_and_names(write: Any, tmp_path: Path) -> None:
    reader = LeRobotReader(write(tmp_path / "d", LENGTHS, tasks=("pick", "place")))
    for e, ref in enumerate(reader.episodes()):
        episode = reader.open(ref.episode_id)
        frames = np.arange(LENGTHS[e])
        times, state = numbers(episode, "observation.state")
        assert times.tolist() == clock_ns(LENGTHS[e])
        assert state.tolist() == np.stack([frames, np.full(LENGTHS[e], e), gripper(LENGTHS[e])], 1).tolist()
        assert numbers(episode, "action")[1][:, 0].tolist() == (-frames).tolist()
        assert numbers(episode, "next.reward")[1][:, 0].tolist() == [0.0] * (LENGTHS[e] - 1) + [1.0]
        assert episode.task == ref.task == ("pick", "place")[e % 2]
        assert list(episode.streams) == ["observation.state", "action", FRONT, "next.reward"]
        assert episode.streams["observation.state"].names == ("frame", "episode", "gripper.pos")
        assert episode.streams["action"].names == ("frame", "gripper.pos")
        assert episode.streams["next.reward"].names == ()
        assert {s.count for s in episode.streams.values()} == {LENGTHS[e]}
        assert {s.rate_hz for s in episode.streams.values()} == {30.0}


def test_streams_are_read_together_in_order_of_time(tmp_path: Path) -> None:
    episode = LeRobotReader(write_v3(tmp_path / "d", (100,), cameras=(FRONT, WRIST))).open("episode_000000")
    batches = list(episode.read())
    starts = [int(batch.time_ns[0]) for batch in batches]
    assert starts == sorted(starts)
    assert {batch.stream for batch in batches} == set(episode.streams)
    assert [type(b) for b in episode.read(["action"])] == [NumericBatch]
    with pytest.raises(SourceError, match=r"episode_000000 has no stream 'wrist'; it has: observation\.state, action"):
        list(episode.read(["wrist"]))


@pytest.mark.parametrize("encoder", [H264, MPEG4, H264_B_FRAMES])
def test_several_files_of_several_episodes(encoder: Any, tmp_path: Path) -> None:
    lengths = (7, 5, 6, 4, 8)
    root = write_v3(
        tmp_path / "d", lengths, encoder=encoder, number_step=STEP, episodes_a_video=2, episodes_a_data_file=3
    )
    reader = LeRobotReader(root)
    for e, length in enumerate(lengths):
        episode = reader.open(f"episode_{e:06d}")
        assert shown(episode)[0] == [e * STEP + i for i in range(length)]
        assert numbers(episode, "observation.state")[1][:, 1].tolist() == [e] * length
        assert episode.problems == []


def test_only_the_row_groups_of_the_episode_are_read(tmp_path: Path) -> None:
    """A damaged row group of another episode does no harm."""
    root = write_v3(tmp_path / "d", (50, 50, 50), encoder=IMAGES, size=(64, 48))
    path = root / "data/chunk-000/file-000.parquet"
    metadata = pq.read_metadata(path)
    assert metadata.num_row_groups == 3
    start = metadata.row_group(1).column(0).dictionary_page_offset or metadata.row_group(1).column(0).data_page_offset
    content = bytearray(path.read_bytes())
    content[start : start + metadata.row_group(1).total_byte_size // 2] = bytes(
        metadata.row_group(1).total_byte_size // 2
    )
    path.write_bytes(content)
    reader = LeRobotReader(root)
    for e in (0, 2):
        assert numbers(reader.open(f"episode_{e:06d}"), "action")[1].shape == (50, 2)
    with pytest.raises(SourceError, match=r"d/data/chunk-000/file-000\.parquet"):
        list(reader.open("episode_000001").read())


def test_one_row_group_for_all_episodes(tmp_path: Path) -> None:
    root = write_v3(tmp_path / "d", LENGTHS, encoder=IMAGES, number_step=STEP)
    path = root / "data/chunk-000/file-000.parquet"
    pq.write_table(pq.read_table(path), path)
    reader = LeRobotReader(root)
    for e, length in enumerate(LENGTHS):
        episode = reader.open(f"episode_{e:06d}")
        assert shown(episode)[0] == [e * STEP + i for i in range(length)]
        assert numbers(episode, "observation.state")[1][:, 1].tolist() == [e] * length


def test_a_rate_that_no_number_of_nanoseconds_gives(tmp_path: Path) -> None:
    root = write_v3(tmp_path / "d", (5,), encoder=IMAGES)
    info = read_info(root)
    write_info(root, {**info, "fps": 29.97})
    episode = LeRobotReader(root).open("episode_000000")
    assert episode.clock.frame_ns.tolist() == clock_ns(5, 29.97)


def test_features_of_every_kind(tmp_path: Path) -> None:
    root = write_v3(tmp_path / "d", (4,))
    table = episode_table(0, 4, 0, 0, 30)
    columns = {
        "observation.grid": pa.array([[[r, r + 0.5], [r, -r]] for r in range(4)], pa.list_(pa.list_(pa.float32()))),
        "next.done": pa.array([False, False, False, True]),
        "note": pa.array(["a", "b", "c", "d"]),
        "ragged": pa.array([[1.0], [1.0, 2.0, 3.0], None, [None, 5.0]], pa.list_(pa.float64())),
        "by_axis": pa.array([[1.0, 2.0]] * 4, pa.list_(pa.float64(), 2)),
    }
    for name, column in columns.items():
        table = table.append_column(name, column)
    write_tables(root / "data/chunk-000/file-000.parquet", [table])
    info = read_info(root)
    info["features"] |= {
        "observation.grid": {"dtype": "float32", "shape": [2, 2], "names": {"rows": ["a", "b"], "columns": ["c", "d"]}},
        "next.done": {"dtype": "bool", "shape": [1], "names": None},
        "note": {"dtype": "string", "shape": [1], "names": None},
        "ragged": {"dtype": "float64", "shape": [2], "names": ["too", "many", "names"]},
        "by_axis": {"dtype": "float64", "shape": [2], "names": {"y": 1, "x": 0}},
    }
    write_info(root, info)
    episode = LeRobotReader(root).open("episode_000000")
    assert numbers(episode, "observation.grid")[1][3].tolist() == [3.0, 3.5, 3.0, -3.0]
    assert episode.streams["observation.grid"].shape == (4,)
    assert episode.streams["observation.grid"].names == ("a", "b", "c", "d")
    assert numbers(episode, "next.done")[1][:, 0].tolist() == [0, 0, 0, 1]
    assert episode.streams["note"].kind == "other"
    assert np.array_equal(
        numbers(episode, "ragged")[1], [[1, np.nan], [1, 2], [np.nan, np.nan], [np.nan, 5]], equal_nan=True
    )
    assert episode.streams["ragged"].names == ()
    assert episode.streams["by_axis"].names == ("x", "y")
    assert "note" not in {batch.stream for batch in episode.read()}


def test_the_task_is_found_by_its_number_when_the_episode_does_not_name_it(tmp_path: Path) -> None:
    root = write_v3(tmp_path / "d", LENGTHS, tasks=("pick", "place"))
    rows = [{k: v for k, v in row.items() if k != "tasks"} for row in read_episodes(root)]
    write_episodes(root, rows)
    reader = LeRobotReader(root)
    assert [ref.task for ref in reader.episodes()] == [None] * 3
    assert [reader.open(ref.episode_id).task for ref in reader.episodes()] == ["pick", "place", "pick"]


def test_a_task_may_be_a_text_instead_of_a_list(tmp_path: Path) -> None:
    root = write_v3(tmp_path / "d", (2, 2))
    write_episodes(root, [{**row, "tasks": "pick"} for row in read_episodes(root)])
    assert [ref.task for ref in LeRobotReader(root).episodes()] == ["pick", "pick"]
    write_episodes(root, [{**row, "tasks": ["pick", "place", "pick"]} for row in read_episodes(root)])
    assert LeRobotReader(root).open("episode_000000").task == "pick; place"


def test_the_fingerprint_changes_with_the_files(tmp_path: Path) -> None:
    root = write_v3(tmp_path / "d", LENGTHS, episodes_a_video=1)
    first = [LeRobotReader(root).open(f"episode_{e:06d}").fingerprint for e in range(3)]
    assert len(set(first)) == 3
    assert first == [LeRobotReader(root).open(f"episode_{e:06d}").fingerprint for e in range(3)]
    with (root / f"videos/{FRONT}/chunk-000/file-001.mp4").open("ab") as file:
        file.write(b"\0" * 8)
    second = [LeRobotReader(root).open(f"episode_{e:06d}").fingerprint for e in range(3)]
    assert [a == b for a, b in zip(first, second, strict=True)] == [True, False, True]


def test_labels_lie_in_the_dataset_unless_told_otherwise(tmp_path: Path) -> None:
    root = write_v3(tmp_path / "d")
    assert LeRobotReader(root).labels_dir == str(root / "meta" / "jiti")
    reader = LeRobotReader(root, title="user/name", labels_dir="name.labels")
    assert (reader.title, reader.labels_dir) == ("3 episodes in user/name", "name.labels")


def test_pictures_may_lie_beside_the_parquet_file(tmp_path: Path) -> None:
    root = write_v3(tmp_path / "d", (3,), encoder=IMAGES)
    (root / "images").mkdir()
    cells = []
    for i in range(3):
        (root / f"images/{i}.png").write_bytes(png(numbered(40 + i, 160, 120)))
        cells.append({"bytes": None, "path": f"images/{i}.png"})
    table = episode_table(0, 3, 0, 0, 30, (FRONT,))
    table = table.set_column(table.column_names.index(FRONT), FRONT, pa.array(cells))
    write_tables(root / "data/chunk-000/file-000.parquet", [table])
    assert shown(LeRobotReader(root).open("episode_000000"))[0] == [40, 41, 42]


# The real dataset


def test_the_real_dataset(shared: Path) -> None:
    reader = LeRobotReader(shared / "lerobot" / "bimanual_v3")
    refs = reader.episodes()
    assert [ref.frame_count for ref in refs] == [429, 395, 449, 408]
    assert {ref.task for ref in refs} == {"lingzu teleoperation"}
    episode = reader.open("episode_000001")
    assert episode.problems == []
    camera = episode.streams["observation.images.front"]
    assert (camera.count, camera.shape, camera.encoding, camera.schema) == (395, (480, 640, 3), "h264", "video/mpeg4")
    assert episode.streams["action"].names[:2] == ("left.joint_1.pos", "left.joint_2.pos")
    assert numbers(episode, "action")[1].shape == (395, 34)

    wanted = [0, 13, 200, 394]
    direct = dict(decode_frames(episode, camera.name, wanted))
    decoder = SampleDecoder("h264")
    samples = [s for b in episode.read([camera.name]) for s in b.data]  # type: ignore[union-attr]
    assert len(samples) == 395
    sent = dict(out for i, s in enumerate(samples) for out in decoder.decode(s, i))
    for frame in wanted:
        near = np.abs(to_rgb(sent[frame]).astype(int) - direct[frame]).mean()
        others = [
            np.abs(to_rgb(sent[f]).astype(int) - direct[frame]).mean() for f in (frame - 3, frame + 3) if f in sent
        ]
        assert near < 4
        assert near < min(others)
    path = shared / "lerobot/bimanual_v3/videos/observation.images.front/chunk-000/file-001.mp4"
    with av.open(str(path)) as container:
        plain = [f.to_ndarray(format="rgb24") for i, f in enumerate(container.decode(video=0)) if i in wanted]
    for frame, picture in zip(wanted, plain, strict=True):
        assert np.array_equal(direct[frame], picture)


# Cost


def test_ten_thousand_episodes_are_listed_in_half_a_second(tmp_path: Path) -> None:
    """In row groups of ten with statistics of twelve features, as lerobot 0.6 writes them."""
    root = tmp_path / "d"
    write_v3(root, (3,))
    write_info(root, read_info(root) | {"total_episodes": 10_000})
    number = np.arange(10_000)
    columns: dict[str, Any] = {
        "episode_index": number,
        "tasks": [["Pick up the red cup."]] * 10_000,
        "length": np.full(10_000, 300),
        "data/chunk_index": np.zeros(10_000, np.int64),
        "data/file_index": number // 1000,
        "dataset_from_index": number * 300,
        "dataset_to_index": number * 300 + 300,
        f"videos/{FRONT}/chunk_index": np.zeros(10_000, np.int64),
        f"videos/{FRONT}/file_index": number // 100,
        f"videos/{FRONT}/from_timestamp": number % 100 * 10.0,
        f"videos/{FRONT}/to_timestamp": number % 100 * 10.0 + 10,
    }
    for feature in range(12):
        for statistic in ("min", "max", "mean", "std", "count"):
            columns[f"stats/feature_{feature}/{statistic}"] = [[0.0] * 6] * 10_000
    table = pa.table(columns)
    with pq.ParquetWriter(root / "meta/episodes/chunk-000/file-000.parquet", table.schema) as writer:
        for start in range(0, 10_000, 10):
            writer.write_table(table.slice(start, 10))

    elapsed_s = []
    for _ in range(3):  # The machine may be busy with something else for one of them.
        started = time.perf_counter()
        refs = LeRobotReader(root).episodes()
        elapsed_s.append(time.perf_counter() - started)
        assert len(refs) == 10_000
        assert (refs[9_999].episode_id, refs[9_999].frame_count) == ("episode_009999", 300)
    assert min(elapsed_s) < 0.5


def test_reading_loads_no_heavy_package(tmp_path: Path) -> None:
    root = write_v3(tmp_path / "d")
    code = (
        "import sys; from pathlib import Path; from jiti.episodes.lerobot_reader import LeRobotReader; "
        f"list(LeRobotReader(Path({str(root)!r})).open('episode_000000').read()); "
        "print(sorted({'torch', 'lerobot', 'pandas', 'rerun', 'huggingface_hub', 'datasets'} & set(sys.modules)))"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"
