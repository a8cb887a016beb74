"""Partitions: every acknowledged edit is there again, whatever happened in between."""

import fcntl
import os
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pyarrow.dataset as ds
import pyarrow.parquet as pq
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from jiti.annotate import lock
from jiti.annotate.partition import Partition
from jiti.annotate.segment_file import Recording
from jiti.annotate.segments import SCHEMA, Segment
from jiti.annotate.store import LabelStore
from jiti.errors import LabelError, SaveFailed, StaleWrite
from tests.builders.labels import RECORDING, segment


@pytest.fixture
def store(tmp_path: Path) -> LabelStore:
    return LabelStore(tmp_path / "labels")


def reopened(store: LabelStore) -> Partition:
    return Partition(store.labels_dir, "anna", "ep", RECORDING)


def test_nothing_is_created_by_looking(store: LabelStore) -> None:
    partition = store.partition("anna", "ep", RECORDING)
    assert (partition.version, partition.segments, partition.can_undo, partition.can_redo) == (0, (), False, False)
    assert partition.changes_since(0) == []
    assert not partition.refresh()
    assert not store.labels_dir.exists()
    assert store.annotators() == []


def test_an_edit_is_in_both_files_with_what_it_is_about(store: LabelStore) -> None:
    partition = store.partition("anna", "ep", RECORDING)
    late, early = segment(100, 124, 0, rationale="drops it"), segment(10, 34)
    assert partition.apply("mark", [late, early], based_on=0) == 1
    assert [s.segment_id for s in partition.segments] == [early.segment_id, late.segment_id]
    assert all(s.created_at == s.updated_at > 0 for s in partition.segments)
    path = store.labels_dir / "segments" / "annotator=anna" / "ep.parquet"
    table = pq.ParquetFile(path).read()
    assert table.schema.equals(SCHEMA)
    assert table.to_pylist() == [s.to_row() for s in partition.segments]
    assert pq.read_metadata(path).metadata[b"jiti"].decode() == (
        '{"schema_version": 1, "version": 1, "annotator": "anna", "recordings": '
        '{"ep": {"frame_count": 300, "frame_rate_hz": 30.0, "fingerprint": "f00d"}}}'
    )
    assert sorted(p.name for p in store.labels_dir.rglob("*") if p.is_file()) == ["ep.jsonl", "ep.parquet"]
    again = reopened(store)
    assert again.view == partition.view
    assert again.recording == RECORDING
    assert again.problems == ()


def test_any_dataset_reader_sees_the_annotators(store: LabelStore) -> None:
    for annotator, episode in (("anna", "ep"), ("bob", "ep"), ("bob", "_day%2F2")):
        store.partition(annotator, episode, RECORDING).apply("mark", [segment(episode_id=episode)], based_on=0)
    table = ds.dataset(store.labels_dir / "segments", partitioning="hive").to_table()
    assert table.schema.names == [*SCHEMA.names, "annotator"]
    rows = table.select(["annotator", "episode_id"]).to_pylist()
    assert sorted((row["annotator"], row["episode_id"]) for row in rows) == [
        ("anna", "ep"),
        ("bob", "_day%2F2"),
        ("bob", "ep"),
    ]
    assert store.annotators() == ["anna", "bob"]


def test_undo_and_redo_go_on_after_a_restart(store: LabelStore) -> None:
    partition = store.partition("anna", "ep", RECORDING)
    first = segment(10, 34)
    partition.apply("mark", [first], based_on=0)
    first = partition.segments[0]
    partition.apply("nudge", [first.changed(start_frame=11)], based_on=1)
    partition.apply("delete", remove=[first.segment_id], based_on=2)
    assert partition.segments == ()
    partition = reopened(store)
    assert partition.undo(based_on=3) == 4
    assert partition.segments[0].start_frame == 11
    partition = reopened(store)
    assert partition.undo(based_on=4) == 5
    assert partition.segments == (first,)
    partition = reopened(store)
    assert (partition.can_undo, partition.can_redo) == (True, True)
    assert partition.redo(based_on=5) == 6
    assert partition.segments[0].start_frame == 11
    partition.apply("verdict", [partition.segments[0].changed(reward=0)], based_on=6)
    assert not partition.can_redo
    with pytest.raises(LabelError, match="nothing to redo"):
        partition.redo(based_on=7)
    for version in range(7, 10):
        if partition.can_undo:
            partition.undo(based_on=version)
    assert partition.segments == ()
    with pytest.raises(LabelError, match="nothing to undo"):
        partition.undo(based_on=partition.version)
    assert [(c["kind"], c["action"]) for c in reopened(store).changes_since(3)] == [
        ("undo", "delete"),
        ("undo", "nudge"),
        ("redo", "nudge"),
        ("edit", "verdict"),
        ("undo", "verdict"),
        ("undo", "nudge"),
        ("undo", "mark"),
    ]


def test_an_edit_that_changes_nothing_is_no_edit(store: LabelStore) -> None:
    partition = store.partition("anna", "ep", RECORDING)
    partition.apply("mark", [segment()], based_on=0)
    assert partition.apply("verdict", partition.segments, based_on=1) == 1
    assert partition.apply("nothing", based_on=1) == 1
    assert partition.changes_since(1) == []


def test_edits_that_make_no_sense_change_nothing(store: LabelStore) -> None:
    partition = store.partition("anna", "ep", RECORDING)
    row = segment()
    partition.apply("mark", [row], based_on=0)
    with pytest.raises(LabelError, match="segment nope cannot be removed: there is none"):
        partition.apply("delete", remove=["nope"], based_on=1)
    with pytest.raises(LabelError, match="is of episode 'other'; it cannot go to the labels of 'ep'"):
        partition.apply("mark", [segment(episode_id="other")], based_on=1)
    with pytest.raises(LabelError, match="named twice in one edit 'mark'"):
        partition.apply("mark", [row, row.changed(reward=0)], based_on=1)
    with pytest.raises(LabelError, match="the first edit of 'new' must say what is labelled"):
        store.partition("anna", "new").apply("mark", [segment(episode_id="new")], based_on=0)
    assert partition.version == reopened(store).version == 1


def test_a_stale_write_says_what_changed(store: LabelStore) -> None:
    mine, theirs = store.partition("anna", "ep", RECORDING), reopened(store)
    mine.apply("mark", [segment()], based_on=0)
    changed = mine.segments[0].changed(reward=0)
    mine.apply("verdict", [changed], based_on=1)
    with pytest.raises(StaleWrite, match=r"are at version 2, .* on version 0: 2 edits .* last one 'verdict'") as stale:
        theirs.apply("mark", [segment(50, 60)], based_on=0)
    assert [change["action"] for change in stale.value.changes] == ["mark", "verdict"]
    assert stale.value.changes[1]["before"][0]["reward"] == 1
    assert stale.value.changes[1]["after"][0]["reward"] == 0
    assert theirs.view == mine.view  # it has taken the edits in
    theirs.apply("mark", [segment(50, 60)], based_on=2)
    with pytest.raises(StaleWrite, match="1 edits were saved in between"):
        mine.undo(based_on=2)
    with pytest.raises(StaleWrite, match="knows version 9, which is not on the disk") as ahead:
        mine.apply("mark", [segment()], based_on=9)
    assert ahead.value.changes == []


def test_refresh_takes_in_what_another_process_wrote(store: LabelStore) -> None:
    mine, theirs = store.partition("anna", "ep", RECORDING), reopened(store)
    theirs.apply("mark", [segment()], based_on=0)
    assert mine.version == 0
    assert mine.refresh()
    assert mine.view == theirs.view
    assert not mine.refresh()
    theirs.undo(based_on=1)
    assert store.partition("anna", "ep") is mine
    assert mine.version == 2


def test_another_recording_is_told_and_can_be_confirmed(store: LabelStore) -> None:
    store.partition("anna", "ep", RECORDING).apply("mark", [segment()], based_on=0)
    other = Recording(310, 30.0, "beef")
    partition = Partition(store.labels_dir, "anna", "ep", other)
    assert [p.what for p in partition.problems] == [
        "the labels were made on a recording of 300 frames with fingerprint f00d; "
        "the one here has 310 frames and fingerprint beef"
    ]
    partition.apply("mark", [segment(40, 50)], based_on=1)
    assert partition.recording == RECORDING
    assert partition.confirm(other, based_on=2) == 3
    assert partition.problems == ()
    again = Partition(store.labels_dir, "anna", "ep", other)
    assert (again.recording, again.problems) == (other, ())
    again.undo(based_on=3)  # of the mark: what is labelled is no edit of rows
    assert len(again.segments) == 1
    assert again.recording == other


def test_many_partitions_stay_right_when_few_are_kept_open(store: LabelStore) -> None:
    for number in range(300):
        name = f"ep{number:03}"
        store.partition("anna", name, RECORDING).apply("mark", [segment(episode_id=name)], based_on=0)
    for number in range(0, 300, 50):
        assert store.partition("anna", f"ep{number:03}").version == 1


def test_kill_at_any_moment_keeps_every_acknowledged_edit(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-m", "tests.builders.killed_writer", tmp_path, "60", str(os.getpid())],
        cwd=Path(__file__).parents[2],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.startswith("60 kills")
    assert int(done.stdout.split()[2]) > 5


WRITER = """
import sys
from pathlib import Path
from jiti.annotate import lock
from jiti.annotate.partition import Partition
from jiti.errors import StaleWrite
from tests.builders.labels import RECORDING, segment
partition = Partition(Path(sys.argv[1]), sys.argv[2], "ep", RECORDING)
for number in range(25):
    row = segment(number, 290, rationale=sys.argv[3])
    while True:
        try:
            partition.apply("mark", [row], based_on=partition.version)
            break
        except StaleWrite:
            partition.refresh()
"""


def test_writers_in_several_processes_lose_nothing(tmp_path: Path) -> None:
    writers = [
        subprocess.Popen([sys.executable, "-c", WRITER, tmp_path, *who], cwd=Path(__file__).parents[2])
        for who in (("anna", "one"), ("anna", "two"), ("bob", "one"))
    ]
    assert [writer.wait() for writer in writers] == [0, 0, 0]
    anna, bob = (Partition(tmp_path, name, "ep", RECORDING) for name in ("anna", "bob"))
    assert (anna.version, bob.version) == (50, 25)
    assert sorted((s.start_frame, s.rationale) for s in anna.segments) == sorted(
        (number, who) for number in range(25) for who in ("one", "two")
    )
    assert len(bob.segments) == 25


def test_threads_that_share_a_store_lose_nothing(store: LabelStore) -> None:
    def annotate(who: int) -> None:
        for number in range(10):
            row = segment(number, 100 + who)
            while True:
                partition = store.partition("anna", "ep", RECORDING)
                try:
                    partition.apply("mark", [row], based_on=partition.version)
                    break
                except StaleWrite:
                    continue

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(annotate, range(4)))
    assert reopened(store).version == 40
    assert len({(s.start_frame, s.end_frame) for s in reopened(store).segments}) == 40


def test_a_writer_that_is_stuck_is_told_of(store: LabelStore, monkeypatch: pytest.MonkeyPatch) -> None:
    partition = store.partition("anna", "ep", RECORDING)
    partition.apply("mark", [segment()], based_on=0)
    monkeypatch.setattr(lock, "PATIENCE_S", 0.1)
    with (store.labels_dir / "history" / "annotator=anna" / "ep.jsonl").open("rb") as stuck:
        fcntl.flock(stuck, fcntl.LOCK_EX)
        with pytest.raises(SaveFailed, match=r"ep\.jsonl is locked by another process .*stopped `jiti annotate`"):
            partition.apply("mark", [segment()], based_on=1)
    assert partition.apply("mark", [segment()], based_on=1) == 2


class Annotating(RuleBasedStateMachine):
    """Any mix of edits, undo, redo and restarts against a list of states."""

    @initialize()
    def begin(self) -> None:
        self.folder = Path(tempfile.mkdtemp())
        self.states: list[dict[str, Segment]] = [{}]
        self.now = 0
        self.version = 0
        self.partition = Partition(self.folder, "anna", "ep", RECORDING)

    def teardown(self) -> None:
        shutil.rmtree(self.folder)

    def expect(self, state: dict[str, Segment]) -> None:
        self.states = [*self.states[: self.now + 1], state]
        self.now += 1
        self.version += 1

    @rule(
        start=st.integers(0, 200),
        length=st.integers(0, 99),
        reward=st.sampled_from([None, 0, 1]),
        count=st.integers(1, 3),
    )
    def mark(self, start: int, length: int, reward: int | None, count: int) -> None:
        rows = [segment(start, start + length, reward) for _ in range(count)]
        assert self.partition.apply("mark", rows, based_on=self.version) == self.version + 1
        self.expect(self.states[self.now] | {row.segment_id: row for row in rows})

    @precondition(lambda self: self.states[self.now])
    @rule(data=st.data(), by=st.integers(1, 20))
    def change(self, data: st.DataObject, by: int) -> None:
        name = data.draw(st.sampled_from(sorted(self.states[self.now])))
        row = self.states[self.now][name].changed(end_frame=self.states[self.now][name].end_frame + by)
        self.partition.apply("nudge", [row], based_on=self.version)
        self.expect(self.states[self.now] | {name: row})

    @precondition(lambda self: self.states[self.now])
    @rule(data=st.data())
    def replace_one(self, data: st.DataObject) -> None:
        name = data.draw(st.sampled_from(sorted(self.states[self.now])))
        row = segment()
        self.partition.apply("split", [row], [name], based_on=self.version)
        self.expect({k: v for k, v in self.states[self.now].items() if k != name} | {row.segment_id: row})

    @precondition(lambda self: self.now > 0)
    @rule()
    def undo(self) -> None:
        self.partition.undo(based_on=self.version)
        self.now -= 1
        self.version += 1

    @precondition(lambda self: self.now + 1 < len(self.states))
    @rule()
    def redo(self) -> None:
        self.partition.redo(based_on=self.version)
        self.now += 1
        self.version += 1

    @rule()
    def write_stale(self) -> None:
        with pytest.raises(StaleWrite):
            self.partition.apply("mark", [segment()], based_on=self.version - 1)

    @rule(parquet=st.booleans())
    def restart(self, *, parquet: bool) -> None:
        if not parquet:
            (self.folder / "segments" / "annotator=anna" / "ep.parquet").unlink(missing_ok=True)
        self.partition = Partition(self.folder, "anna", "ep", RECORDING)

    @invariant()
    def agrees(self) -> None:
        expected = {(s.segment_id, s.start_frame, s.end_frame, s.reward) for s in self.states[self.now].values()}
        found = {(s.segment_id, s.start_frame, s.end_frame, s.reward) for s in self.partition.segments}
        assert found == expected
        assert self.partition.version == self.version
        assert self.partition.can_undo == (self.now > 0)
        assert self.partition.can_redo == (self.now + 1 < len(self.states))


TestAnnotating = Annotating.TestCase
TestAnnotating.settings = settings(max_examples=25, stateful_step_count=25, deadline=None)
