"""Reading what everyone labelled, from few files and from many, warm and cold."""

import time
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from jiti.annotate import labels_cache
from jiti.annotate.folder import labels_version, segments_path
from jiti.annotate.labels import Labels, read_labels, read_segments
from jiti.annotate.partition import Partition
from jiti.annotate.segment_file import FileInfo, Recording, encode, to_segments
from jiti.annotate.segments import SCHEMA, Segment
from jiti.annotate.store import LabelStore
from jiti.annotate.web.waiting import progress
from jiti.errors import LabelError, NewerSchema
from tests.builders.labels import RECORDING, full_disk, segment


def save(folder: Path, annotator: str, episode_id: str, *segments: Segment) -> Partition:
    partition = Partition(folder, annotator, episode_id, RECORDING)
    partition.apply("mark", segments, [s.segment_id for s in partition.segments], based_on=partition.version)
    return partition


def told(labels: Labels) -> list[tuple]:
    rows = labels.segments.select(["annotator", "episode_id", "start_frame"]).to_pylist()
    return [tuple(row.values()) for row in rows]


def test_no_folder_is_no_labels(tmp_path: Path) -> None:
    labels = read_labels(tmp_path / "nowhere", cache_dir=tmp_path / "cache")
    assert labels.segments.schema.names == [*SCHEMA.names, "annotator"]
    assert len(labels.segments) == len(labels.recordings) == 0
    assert labels.by_episode() == {}
    assert labels_version(tmp_path / "nowhere") == labels_version(tmp_path / "nothing")


def test_joins_annotators_and_knows_the_recordings(tmp_path: Path) -> None:
    anna = save(tmp_path, "anna", "ep", segment(10, 20), segment(30, 40, None))
    save(tmp_path, "anna", "empty", row := segment(episode_id="empty"))
    LabelStore(tmp_path).partition("anna", "empty").apply("delete", remove=[row.segment_id], based_on=1)
    save(tmp_path, "bob", "ep", segment(11, 21))
    labels = read_labels(tmp_path)
    assert told(labels) == [("anna", "ep", 10), ("anna", "ep", 30), ("bob", "ep", 11)]
    assert tuple(to_segments(labels.segments.slice(0, 2))) == anna.segments
    assert labels.recordings.to_pylist()[1] == {
        "annotator": "anna",
        "episode_id": "ep",
        "frame_count": 300,
        "frame_rate_hz": 30.0,
        "fingerprint": "f00d",
    }
    assert labels.by_episode() == {"ep": RECORDING, "empty": RECORDING}
    assert read_segments(tmp_path).equals(labels.segments)
    assert told(read_labels(tmp_path, annotators=["bob", "none"])) == [("bob", "ep", 11)]
    assert told(read_labels(tmp_path, episodes=["empty"])) == []
    assert read_labels(tmp_path, episodes=["empty"]).recordings["episode_id"].to_pylist() == ["empty"]


def test_machine_shards_hold_many_episodes_under_any_name(tmp_path: Path) -> None:
    rows = [segment(k, k + 5, episode_id=f"ep{k}", status="proposed", source="vlm", confidence=0.5) for k in range(4)]
    shard = segments_path(tmp_path, "vlm", "whatever").with_name("shard-7.parquet")
    shard.parent.mkdir(parents=True)
    recordings = {f"ep{k}": Recording(100 + k, 30.0, "x") for k in range(4)}
    shard.write_bytes(encode(rows, FileInfo(1, "vlm", recordings)))
    foreign = pa.Table.from_pylist([{**rows[0].to_row(), "more": 1, "reward": 1}])  # int64 rewards, one column more
    pq.write_table(foreign, shard.with_name("by-hand.parquet"))
    labels = read_labels(tmp_path)
    assert labels.problems == ()
    assert labels.segments.schema == pa.schema([*SCHEMA, pa.field("annotator", pa.string())])
    assert told(labels) == [("vlm", "ep0", 0), *(("vlm", f"ep{k}", k) for k in range(4))]
    assert {k: r.frame_count for k, r in labels.by_episode().items()} == {f"ep{k}": 100 + k for k in range(4)}


def test_the_longest_recording_counts_where_annotators_saw_different_ones(tmp_path: Path) -> None:
    for annotator, frames in (("anna", 10), ("bob", 30), ("cleo", 20)):
        Partition(tmp_path, annotator, "ep", Recording(frames, 30.0, annotator)).apply("mark", [segment()], based_on=0)
    assert read_labels(tmp_path).by_episode() == {"ep": Recording(30, 30.0, "bob")}


def test_a_damaged_file_is_named_and_the_rest_is_read(tmp_path: Path) -> None:
    save(tmp_path, "anna", "good", segment(episode_id="good"))
    save(tmp_path, "anna", "ep", segment())
    segments_path(tmp_path, "anna", "ep").write_bytes(b"PAR1")
    labels = read_labels(tmp_path)
    assert told(labels) == [("anna", "good", 10)]
    assert [problem.where for problem in labels.problems] == [str(segments_path(tmp_path, "anna", "ep"))]
    assert labels.problems[0].severity == "error"
    with pytest.raises(LabelError, match=r"ep\.parquet cannot be read as segments.*rebuilds the file from its history"):
        read_segments(tmp_path)
    Partition(tmp_path, "anna", "ep")  # as the remedy says
    assert read_labels(tmp_path).problems == ()


def test_stray_files_and_dangling_links_are_passed_by(tmp_path: Path) -> None:
    save(tmp_path, "anna", "ep", segment())
    (tmp_path / "segments" / "annotator=zoe").write_text("no folder")
    segments_path(tmp_path, "anna", "gone").symlink_to(tmp_path / "nowhere")
    labels = read_labels(tmp_path)
    assert (told(labels), labels.problems) == ([("anna", "ep", 10)], ())
    assert labels_version(tmp_path)


def test_a_later_schema_is_an_error(tmp_path: Path) -> None:
    save(tmp_path, "anna", "ep", segment())
    path = segments_path(tmp_path, "anna", "ep")
    pq.write_table(pq.ParquetFile(path).read().replace_schema_metadata({b"jiti": b'{"schema_version": 2}'}), path)
    with pytest.raises(NewerSchema, match=r"ep\.parquet has schema version 2"):
        read_labels(tmp_path)


def test_lists_name_a_later_schema_and_go_on(tmp_path: Path) -> None:
    save(tmp_path, "anna", "ep", segment())
    save(tmp_path, "ben", "ep", segment())
    path = segments_path(tmp_path, "anna", "ep")
    pq.write_table(pq.ParquetFile(path).read().replace_schema_metadata({b"jiti": b'{"schema_version": 2}'}), path)
    labels = read_labels(tmp_path, skip_newer=True)
    assert told(labels) == [("ben", "ep", 10)]
    assert [problem.where for problem in labels.problems] == [str(path)]
    assert set(progress(tmp_path, "ben")) == {"ep"}


@pytest.fixture
def small_caches(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(labels_cache, "WORTH_FILES", 1)
    monkeypatch.setattr(labels_cache, "WORTH_CHANGES", 1)


@pytest.mark.usefixtures("small_caches")
def test_the_cache_never_shows_in_what_is_read(tmp_path: Path) -> None:
    folder, cache = tmp_path / "labels", tmp_path / "cache"

    def read(**which: list[str]) -> list[tuple]:
        with_cache = read_labels(folder, cache_dir=cache, **which)
        fresh = read_labels(folder, cache_dir=tmp_path / "other" / str(time.time_ns()), **which)
        assert with_cache.segments.equals(fresh.segments)
        assert with_cache.recordings.equals(fresh.recordings)
        assert with_cache.problems == fresh.problems
        return told(with_cache)

    for number in range(6):
        save(folder, "anna", f"ep{number}", segment(number, episode_id=f"ep{number}"))
    assert [row[2] for row in read()] == [0, 1, 2, 3, 4, 5]
    assert len(list(cache.rglob("*.arrow"))) == 1
    kept = labels_cache.load(labels_cache.path_for(folder, cache))
    assert (len(kept.index), len(kept.rows)) == (6, 6)

    save(folder, "anna", "ep3", segment(33, 44, episode_id="ep3"), segment(34, 44, episode_id="ep3"))
    segments_path(folder, "anna", "ep1").unlink()
    save(folder, "aaron", "ep9", segment(9, episode_id="ep9"))
    assert [row[2] for row in read()] == [9, 0, 2, 33, 34, 4, 5]
    assert [row[2] for row in read(annotators=["aaron"])] == [9]
    assert [row[2] for row in read(episodes=["ep3", "ep9"])] == [9, 33, 34]
    assert [row[2] for row in read()] == [9, 0, 2, 33, 34, 4, 5]

    segments_path(folder, "anna", "ep2").write_bytes(b"junk")
    for _ in range(2):
        assert [row[2] for row in read()] == [9, 0, 33, 34, 4, 5]
        assert len(read_labels(folder, cache_dir=cache).problems) == 1

    path = labels_cache.path_for(folder, cache)
    for damage in (b"", b"junk", path.read_bytes()[:-500]):
        path.write_bytes(damage)
        assert [row[2] for row in read()] == [9, 0, 33, 34, 4, 5]


@pytest.mark.usefixtures("small_caches")
def test_every_save_is_seen_however_soon(tmp_path: Path) -> None:
    partition = save(tmp_path / "labels", "anna", "ep", segment(10, 60))
    for start in range(11, 41):
        partition.apply("nudge", [partition.segments[0].changed(start_frame=start)], based_on=partition.version)
        assert told(read_labels(tmp_path / "labels", cache_dir=tmp_path)) == [("anna", "ep", start)]


@pytest.mark.usefixtures("small_caches")
def test_a_cache_that_cannot_be_written_costs_nothing_but_time(tmp_path: Path) -> None:
    save(tmp_path / "labels", "anna", "ep", segment())
    with full_disk(10):
        assert len(told(read_labels(tmp_path / "labels", cache_dir=tmp_path / "cache"))) == 1
    assert list((tmp_path / "cache").rglob("*.arrow")) == []


def test_the_version_changes_with_every_edit_and_only_then(tmp_path: Path) -> None:
    seen = [labels_version(tmp_path)]
    partition = Partition(tmp_path, "anna", "ep", RECORDING)
    for number in range(30):
        partition.apply("mark", [segment(number)], based_on=number)
        seen.append(labels_version(tmp_path))
    save(tmp_path, "bob", "ep", segment())
    seen.append(labels_version(tmp_path))
    assert len(set(seen)) == len(seen)
    read_labels(tmp_path)
    Partition(tmp_path, "anna", "ep", RECORDING)
    assert labels_version(tmp_path) == seen[-1]
