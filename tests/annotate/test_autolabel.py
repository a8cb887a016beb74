"""Proposals for a whole source: from a simulator's trace, with its verdicts, and from numbers, without."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest

from jiti.annotate.autolabel import autolabel, best_source
from jiti.annotate.labels import read_segments
from jiti.annotate.proposals import accept
from jiti.annotate.proposer import Proposer
from jiti.annotate.segment_file import Recording, to_segments
from jiti.annotate.simulator import propose_from_simulator, read_trace
from jiti.annotate.store import LabelStore
from jiti.episodes.mcap_writer import McapWriter
from jiti.episodes.reader import open_reader
from jiti.errors import SourceError, UsageError
from jiti.tasks.catalogue import load_catalogue
from tests.builders.encode import encode_numbered

CATALOGUE = load_catalogue()
STEP_NS = 50_000_000
START_NS = 1_735_689_600_000_000_000

HELD, RESTS = "IsGrasping ketchup_1", "IsOnBottomOf ketchup_1 basket_1"
GOOD = {HELD: range(20, 61), RESTS: range(55, 100)}
"""Held from step 20 to 60, over the basket's floor from 55 on."""
BAD = {HELD: range(20, 51), RESTS: range(55, 100)}
"""Let go at 50, in the air."""


def write(
    path: Path,
    holds: Mapping[str, Sequence[int]],
    *,
    task: str = "elegant/T0",
    camera: bool = True,
    steps: int = 100,
    **metadata: str,
) -> None:
    """A recording as `jiti record` makes it, with predicates that hold at the given steps."""
    with McapWriter(path, instruction=CATALOGUE.task(task).instruction, metadata={"task": task} | metadata) as writer:
        for step in range(steps):
            time_ns = START_NS + step * STEP_NS
            if camera:
                writer.write_picture("/camera/front", time_ns, encode_numbered([step], "jpeg", 64, 48)[0])
            writer.write_vector("/gripper", time_ns, ["opening_m"], [0.04 if step in holds[HELD] else 0.08])
            writer.write_vector("/predicates", time_ns, list(holds), [float(step in at) for at in holds.values()])


def label(folder: Path, **options):
    reader = open_reader(folder)
    proposer = Proposer(str(folder), Path(reader.labels_dir), by=options.pop("source", "sim"), **options)
    return autolabel(reader, proposer)


def test_a_window_of_the_papers_length_ends_where_the_itc_was_decided(tmp_path):
    write(tmp_path / "good.mcap", GOOD)
    write(tmp_path / "bad.mcap", BAD)
    done = label(tmp_path)
    assert (done.episodes, done.proposals, done.satisfied, done.violated) == (2, 2, 1, 1)
    rows = {row["episode_id"].split(".")[0]: row for row in read_segments(tmp_path / "labels").to_pylist()}
    good, bad = rows["good"], rows["bad"]
    assert (good["start_frame"], good["end_frame"], good["reward"]) == (36, 60, 1)
    assert (bad["start_frame"], bad["end_frame"], bad["reward"]) == (26, 50, 0)
    for row in rows.values():
        assert (row["status"], row["source"], row["annotator"]) == ("proposed", "sim", "sim")
        assert row["itc_id"] == "elegant/T0/release-inside"
        assert row["end_ns"] == START_NS + row["end_frame"] * STEP_NS
    assert "ended when IsOnBottomOf ketchup_1 basket_1 held" in good["rationale"]
    assert "ended before" in bad["rationale"]


def test_the_recorders_task_counts_where_several_share_an_instruction(tmp_path):
    inside = {"In ketchup_1 basket_1_contain_region": range(55, 100)}
    write(tmp_path / "a.mcap", GOOD | inside, task="g4/ketchup")
    assert CATALOGUE.task("g4/ketchup").instruction == CATALOGUE.task("elegant/T0").instruction
    label(tmp_path)
    assert read_segments(tmp_path / "labels")["itc_id"].to_pylist() == ["g4/ketchup/release-inside"]


def test_without_a_camera_the_segment_is_where_it_was_in_time(tmp_path):
    write(tmp_path / "a.mcap", GOOD, camera=False)
    label(tmp_path)
    (row,) = read_segments(tmp_path / "labels").to_pylist()
    assert row["end_frame"] - row["start_frame"] == 24
    assert abs(row["end_ns"] - (START_NS + 60 * STEP_NS)) <= 1e9 / 30


def test_without_a_camera_frames_run_at_the_recorders_rate(tmp_path):
    write(tmp_path / "a.mcap", GOOD, camera=False, rate_hz="20")
    label(tmp_path)
    (row,) = read_segments(tmp_path / "labels").to_pylist()
    assert (row["start_frame"], row["end_frame"]) == (36, 60)


@pytest.mark.parametrize("rate_hz", ["", "fast", "0", "-5", "1e9", "nan"])
def test_a_rate_that_cannot_be_is_not_believed(tmp_path, rate_hz):
    write(tmp_path / "a.mcap", GOOD, camera=False, rate_hz=rate_hz)
    reader = open_reader(tmp_path)
    assert reader.open(reader.episodes()[0].episode_id).clock.rate_hz == pytest.approx(30)


def test_a_decision_near_the_start_keeps_the_windows_length(tmp_path):
    write(tmp_path / "a.mcap", {HELD: range(2, 5), RESTS: range(0)})
    label(tmp_path)
    (row,) = read_segments(tmp_path / "labels").to_pylist()
    assert (row["start_frame"], row["end_frame"], row["reward"]) == (0, 24, 0)


def test_what_people_decided_stays_when_it_runs_again(tmp_path):
    write(tmp_path / "a.mcap", GOOD)
    label(tmp_path)
    (proposal,) = to_segments(read_segments(tmp_path / "labels"))
    reader = open_reader(tmp_path)
    episode = reader.open(reader.episodes()[0].episode_id)
    recording = Recording(episode.clock.frame_count, episode.clock.rate_hz, episode.fingerprint)
    partition = LabelStore(tmp_path / "labels").partition("ada", episode.episode_id, recording)
    partition.apply("accept", [accept(proposal)], based_on=partition.version)
    before = read_segments(tmp_path / "labels").sort_by("segment_id").to_pylist()
    assert label(tmp_path).proposals == 1
    assert read_segments(tmp_path / "labels").sort_by("segment_id").to_pylist() == before


def test_an_episode_without_a_trace_is_left_out_and_said(tmp_path):
    write(tmp_path / "a.mcap", GOOD)
    with McapWriter(tmp_path / "b.mcap") as writer:
        for step in range(30):
            writer.write_vector("/gripper", START_NS + step * STEP_NS, ["opening_m"], [0.08])
    (tmp_path / "c.mcap").write_bytes(b"nothing")
    done = label(tmp_path)
    assert (done.episodes, done.proposals) == (1, 1)
    assert len(done.skipped) == 2
    assert "b.mcap" in done.skipped[0]
    assert "has no stream '/predicates'" in done.skipped[0]
    assert "left out" in str(done)
    assert json.loads(done.to_json())["skipped"] == list(done.skipped)


def test_a_trace_of_other_goals_is_left_out_and_said(tmp_path):
    write(tmp_path / "a.mcap", GOOD)
    write(tmp_path / "b.mcap", GOOD, task="g4/ketchup")
    done = label(tmp_path)
    assert (done.episodes, len(done.skipped)) == (1, 1)
    assert "b.mcap: the trace has no 'In ketchup_1 basket_1_contain_region'" in done.skipped[0]


def test_nothing_at_all_is_an_error(tmp_path):
    with McapWriter(tmp_path / "b.mcap") as writer:
        writer.write_vector("/gripper", START_NS, ["opening_m"], [0.08])
        writer.write_vector("/gripper", START_NS + STEP_NS, ["opening_m"], [0.08])
    with pytest.raises(UsageError, match=r"nothing was proposed .*has no stream '/predicates'"):
        label(tmp_path)


def test_the_source_is_the_simulator_where_it_recorded(tmp_path):
    write(tmp_path / "a.mcap", GOOD)
    assert best_source(open_reader(tmp_path)) == "sim"
    other = tmp_path / "other"
    with McapWriter(other / "b.mcap") as writer:
        for step in range(30):
            writer.write_vector("/gripper", START_NS + step * STEP_NS, ["opening_m"], [0.08])
    assert best_source(open_reader(other)) == "signal"


def test_signals_propose_without_a_verdict(tmp_path):
    write(tmp_path / "a.mcap", GOOD)
    done = label(tmp_path, source="signal")
    assert (done.satisfied, done.violated) == (0, 0)
    rows = read_segments(tmp_path / "labels").to_pylist()
    assert {(row["annotator"], row["source"], row["reward"]) for row in rows} == {("signal", "signal", None)}


def test_a_trace_reads_back_as_it_was_written(tmp_path):
    write(tmp_path / "a.mcap", GOOD)
    reader = open_reader(tmp_path)
    episode = reader.open(reader.episodes()[0].episode_id)
    trace, time_ns = read_trace(episode)
    np.testing.assert_array_equal(time_ns, START_NS + STEP_NS * np.arange(100))
    assert {name: np.flatnonzero(holds).tolist() for name, holds in trace.holds.items()} == {
        name: list(at) for name, at in GOOD.items()
    }
    (segment,) = propose_from_simulator(episode, CATALOGUE.for_episode(episode))
    assert segment.reward == 1
    with McapWriter(tmp_path / "other" / "b.mcap") as writer:
        writer.write_vector("/x", START_NS, ["a"], [0.0])
    other = open_reader(tmp_path / "other")
    without = other.open(other.episodes()[0].episode_id)
    with pytest.raises(SourceError, match="autolabel --from signal"):
        read_trace(without)
