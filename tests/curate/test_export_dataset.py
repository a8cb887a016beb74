"""What `jiti curate` writes, read back: with pyarrow, with our own reader; lerobot's is in test_export_lerobot."""

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from jiti.annotate.labels import read_labels
from jiti.annotate.proposals import accept, edit, reject
from jiti.annotate.web.session import open_session
from jiti.curate.rewards import frame_rewards
from jiti.curate.validate import check_labels
from jiti.episodes.episode import numbers
from jiti.episodes.reader import open_reader
from jiti.errors import LabelError
from jiti.tasks.catalogue import load_catalogue
from tests.builders.curate import ITC, curated, mark, propose, put, write_picks
from tests.builders.labels import segment

GOOD, BAD = [(5, 14, 1)], [(5, 14, 1), (20, 29, 0)]


def rows(dataset: Path) -> dict[str, np.ndarray]:
    table = pq.read_table(dataset / "data")
    return {name: np.array(table[name].to_pylist()) for name in table.column_names}


def of_meta(dataset: Path, name: str) -> list[dict]:
    return pq.read_table(dataset / "meta" / "jiti" / name).to_pylist()


@pytest.fixture
def picks(tmp_path: Path) -> Path:
    return write_picks(tmp_path / "demos", [GOOD, BAD, None, GOOD])


def test_rewards_and_returns_are_those_worked_out_by_hand(picks, tmp_path):
    done = curated(picks, out=tmp_path / "d", gamma=0.5)
    found = rows(tmp_path / "d")
    assert (done.episodes, done.unlabelled, done.fps, done.elegant, done.judged) == (3, 1, 30, 2, 3)
    lengths = [30, 36, 30]
    assert done.frames == sum(lengths) == len(found["index"])
    assert found["index"].tolist() == list(range(96))
    assert found["episode_index"].tolist() == [0] * 30 + [1] * 36 + [2] * 30
    assert found["frame_index"].tolist() == [*range(30), *range(36), *range(30)]
    assert found["timestamp"][30:33].tolist() == [np.float32(k / 30) for k in range(3)]
    reward = [0.0] * 5 + [1.0] * 10 + [0.0] * 15
    assert found["next.reward"][:30].tolist() == reward
    assert found["elegance.annotated"][30:66].tolist() == [5 <= k < 15 or 20 <= k < 30 for k in range(36)]
    # 1 + 1/2 + ... of the frames that are left of the segment; then halved for each frame before it.
    assert found["elegance.mc_return"][14] == 1
    assert found["elegance.mc_return"][13] == 1.5
    assert found["elegance.mc_return"][5] == np.float32(2 - 2**-9)
    assert found["elegance.mc_return"][4] == np.float32(1 - 2**-10)
    assert found["elegance.mc_return"][15:30].max() == 0
    assert np.flatnonzero(found["next.done"]).tolist() == [29, 65, 95]
    assert not found["next.success"].any()  # these recordings do not say


def test_numbers_are_the_latest_of_each_frame(picks, tmp_path):
    curated(picks, out=tmp_path / "d")
    found = rows(tmp_path / "d")
    episode = open_reader(picks).open("pick_1")
    time_ns, values = numbers(episode, "/action")
    held = values[np.searchsorted(time_ns, episode.clock.frame_ns, side="right") - 1]
    assert np.array_equal(found["action"][30:66], held.astype(np.float32))
    info = json.loads((tmp_path / "d" / "meta" / "info.json").read_text())
    assert info["features"]["observation.state"]["names"] == list(episode.streams["/joint_states"].names)


def test_the_labels_go_with_it_and_say_the_same(picks, tmp_path):
    curated(picks, out=tmp_path / "d")
    labels = read_labels(tmp_path / "d" / "meta" / "jiti")
    counts = {f"episode_{k:06d}": n for k, n in enumerate((30, 36, 30))}
    again = frame_rewards(labels.segments, counts)
    found = rows(tmp_path / "d")
    assert np.array_equal(again.reward, found["next.reward"])
    assert np.array_equal(again.annotated, found["elegance.annotated"])
    before = {row["segment_id"]: row for row in read_labels(picks / "labels").segments.to_pylist()}
    for row in labels.segments.to_pylist():
        assert row["annotator"] == "ann"
        assert row["created_at"] == before[row["segment_id"]]["created_at"]
    check = check_labels(open_session(str(tmp_path / "d"), annotator=None, labels=None, tasks=None), gamma=0.98)
    assert [s.kind for s in check.suspects if s.severity == "error"] == []
    assert check.labelled == 3


def test_every_episode_says_where_it_is_from(picks, tmp_path):
    curated(picks, out=tmp_path / "d")
    told = of_meta(tmp_path / "d", "episodes.parquet")
    assert [row["episode_id"] for row in told] == ["pick_0", "pick_1", "pick_3"]
    assert {row["source"] for row in told} == {"demos"}
    assert [row["fingerprint"] for row in told] == [
        open_reader(picks).open(row["episode_id"]).fingerprint for row in told
    ]
    assert [row["frames"] for row in told] == [30, 36, 30]
    assert {row["success"] for row in told} == {None}
    about = json.loads((tmp_path / "d" / "meta" / "jiti" / "curate.json").read_text())
    assert (about["gamma"], about["fps"], about["rule"]) == (0.98, 30, "majority")
    assert str(tmp_path) not in json.dumps(about)


def test_the_same_inputs_give_the_same_bytes(picks, tmp_path):
    curated(picks, out=tmp_path / "d", weights=True)
    curated(picks, out=tmp_path / "e", weights=True)
    files = sorted(path.relative_to(tmp_path / "d") for path in (tmp_path / "d").rglob("*") if path.is_file())
    assert any(path.name == "sarm_progress.parquet" for path in files)
    for path in files:
        if path.name != "README.md":  # which has the folder's name
            assert (tmp_path / "d" / path).read_bytes() == (tmp_path / "e" / path).read_bytes(), path


def test_sources_are_merged(picks, tmp_path):
    other = write_picks(tmp_path / "more", [BAD])
    done = curated(picks, other, out=tmp_path / "d")
    assert done.episodes == 4
    assert [row["source"] for row in of_meta(tmp_path / "d", "episodes.parquet")] == ["demos"] * 3 + ["more"]


def test_a_file_alone_takes_its_own_labels(picks, tmp_path):
    assert curated(picks / "pick_1.mcap", out=tmp_path / "d").episodes == 1


def test_unlabelled_episodes_can_be_kept(picks, tmp_path):
    assert curated(picks, out=tmp_path / "d", unlabelled="keep").episodes == 4
    found = rows(tmp_path / "d")
    assert not found["elegance.annotated"][66:].reshape(2, -1)[0][:34].any()


def test_proposals_count_when_they_are_accepted_and_no_one_has_settled_them(tmp_path):
    demos = write_picks(tmp_path / "demos", [None] * 4)
    made = {name: propose(demos, name, [(5, 14, 1)])[0] for name in ("pick_0", "pick_1", "pick_2", "pick_3")}
    put(demos, "pick_1", [reject(made["pick_1"])], annotator="ann")
    put(demos, "pick_2", [edit(made["pick_2"], start_frame=7, reward=0)], annotator="ann")
    put(demos, "pick_3", [accept(made["pick_3"])], annotator="ann")
    with pytest.raises(LabelError, match="sim"):
        curated(write_picks(tmp_path / "none", [None]), out=tmp_path / "n", accept=("sim",), unlabelled="leave")
    done = curated(demos, out=tmp_path / "d", accept=("sim",))
    told = of_meta(tmp_path / "d", "episodes.parquet")
    assert [row["episode_id"] for row in told] == ["pick_0", "pick_2", "pick_3"]
    labels = read_labels(tmp_path / "d" / "meta" / "jiti").segments.to_pylist()
    assert [(row["annotator"], row["start_frame"], row["reward"], row["status"]) for row in labels] == [
        ("ann", 7, 0, "accepted"),
        ("ann", 5, 1, "accepted"),
        ("sim", 5, 1, "accepted"),
    ]
    about = json.loads((tmp_path / "d" / "meta" / "jiti" / "curate.json").read_text())
    assert about["rule"] == "majority, and proposals of sim that no one has settled"
    assert done.elegant == 2
    assert curated(demos, out=tmp_path / "e").episodes == 2  # what people accepted, without the flag


def test_annotators_are_reconciled_by_the_rule(tmp_path):
    demos = write_picks(tmp_path / "demos", [[(5, 14, 1)], [(5, 14, 1)]])
    mark(demos, "pick_0", [(5, 14, 0)], annotator="ben")
    theirs = mark(demos, "pick_0", [(5, 14, 0)], annotator="cat")
    settled = segment(5, 14, 1, episode_id="pick_0", itc_id=ITC, parent_id=theirs[0].segment_id)
    put(demos, "pick_0", [settled], annotator="adjudicated")

    def reward(name: str, **options) -> list[float]:
        curated(demos, out=tmp_path / name, **options)
        return rows(tmp_path / name)["next.reward"][[5, -31]].tolist()

    assert reward("majority") == [1, 1]  # adjudicated speaks for all
    assert curated(demos, out=tmp_path / "adjudicated", rule="adjudicated").episodes == 1
    assert reward("ann", rule="ann") == [1, 1]
    assert curated(demos, out=tmp_path / "ben", rule="ben").elegant == 0
    for name in ("ben", "adjudicated", "majority"):
        labels = tmp_path / name / "meta" / "jiti"
        assert read_labels(labels).segments["status"].unique().to_pylist() == ["accepted"]


def test_what_one_annotator_said_counts_also_where_it_was_settled(tmp_path):
    demos = write_picks(tmp_path / "demos", [None])
    (said,) = mark(demos, "pick_0", [(5, 14, 1)], annotator="ann")
    mark(demos, "pick_0", [(5, 14, 0)], annotator="ben")
    settled = segment(7, 16, 0, episode_id="pick_0", itc_id=ITC, parent_id=said.segment_id)
    put(demos, "pick_0", [settled], annotator="adjudicated")

    def counted(rule: str) -> list[tuple[str, int, int]]:
        curated(demos, out=tmp_path / rule, rule=rule)
        kept = read_labels(tmp_path / rule / "meta" / "jiti").segments.to_pylist()
        return [(row["annotator"], row["start_frame"], row["reward"]) for row in kept]

    assert counted("ann") == [("ann", 5, 1)]
    assert rows(tmp_path / "ann")["next.reward"].sum() == 10
    assert counted("adjudicated") == [("adjudicated", 7, 0)]
    assert counted("majority") == [("adjudicated", 7, 0), ("ben", 5, 0)]


def test_resampling_moves_segments_with_time(tmp_path):
    demos = write_picks(tmp_path / "demos", [[(6, 14, 1), (21, 21, 0)]])
    curated(demos, out=tmp_path / "d", fps=10)
    found = rows(tmp_path / "d")
    assert len(found["index"]) == 10
    # Frames 0, 3, 6, ... of the recording: 6 to 14 are the new 2 to 4; 21 is the new 7.
    assert np.flatnonzero(found["next.reward"]).tolist() == [2, 3, 4]
    assert np.flatnonzero(found["elegance.annotated"]).tolist() == [2, 3, 4, 7]
    episode = open_reader(demos).open("pick_0")
    time_ns, values = numbers(episode, "/joint_states")
    at = np.searchsorted(time_ns, episode.clock.frame_ns[::3], side="right") - 1
    assert np.array_equal(found["observation.state"], values[at].astype(np.float32))


def test_a_segment_between_two_new_frames_keeps_one(tmp_path):
    demos = write_picks(tmp_path / "demos", [[(7, 8, 1)]])
    curated(demos, out=tmp_path / "d", fps=10)
    assert np.flatnonzero(rows(tmp_path / "d")["next.reward"]).tolist() == [3]


def test_filtered_data_have_the_same_episodes_held_out(tmp_path):
    demos = write_picks(tmp_path / "demos", [GOOD if k % 2 else BAD for k in range(8)])
    curated(demos, out=tmp_path / "all", split="0.5,0.25,0.25", seed=4)
    curated(demos, out=tmp_path / "good", split="0.5,0.25,0.25", seed=4, condition="reward == 1")
    split = {row["episode_id"]: row["split"] for row in of_meta(tmp_path / "all", "episodes.parquet")}
    good = {row["episode_id"]: row["split"] for row in of_meta(tmp_path / "good", "episodes.parquet")}
    assert good == {name: split[name] for name in split if int(name.removeprefix("pick_")) % 2}
    assert sorted(split.values()) == ["test"] * 2 + ["train"] * 4 + ["validation"] * 2
    curated(demos, out=tmp_path / "train", split="0.5,0.25,0.25", seed=4, condition="split == 'train'")
    assert {row["split"] for row in of_meta(tmp_path / "train", "episodes.parquet")} == {"train"}


def test_a_task_can_be_unseen(picks, tmp_path):
    write_picks(tmp_path / "bowls", [GOOD], instruction="put the bowl on the plate")
    curated(picks, tmp_path / "bowls", out=tmp_path / "d", unseen=("elegant/T2",))
    told = of_meta(tmp_path / "d", "episodes.parquet")
    assert [row["split"] for row in told if row["source"] == "bowls"] == ["unseen"]
    assert "unseen" not in {row["split"] for row in told if row["source"] == "demos"}
    assert [row["task_id"] for row in told] == [None, None, None, "elegant/T2"]
    catalogue = load_catalogue(tmp_path / "d" / "meta" / "jiti" / "catalogue.toml")
    assert catalogue.task("elegant/T2") == load_catalogue().task("elegant/T2")


def test_weights_raise_what_is_satisfied_and_drop_what_is_violated(tmp_path):
    demos = write_picks(tmp_path / "demos", [[(5, 14, 1), (20, 24, 0)]])
    curated(demos, out=tmp_path / "d", weights=True)
    table = pq.read_table(tmp_path / "d" / "sarm_progress.parquet")
    progress = table["progress_sparse"].to_numpy()
    assert table["index"].to_pylist() == list(range(30))
    gained = progress[4:] - progress[:-4]  # over chunks of four frames
    assert gained[0] == 0
    assert (gained[2:15] > 0.01).all()  # chunks that reach into 5 to 14
    assert (gained[17:25] < 0).all()


def test_the_card_tells_the_labels(picks, tmp_path):
    curated(picks, out=tmp_path / "d")
    card = (tmp_path / "d" / "README.md").read_text()
    assert "| generic/pose_alignment | 2 | 1 | 67% |" in card
    assert "| ann | human | 4 | 3 |" in card
    assert "- LeRobot" in card.split("---")[1]


def test_a_dataset_can_be_curated_again(picks, tmp_path):
    curated(picks, out=tmp_path / "d", gamma=0.5)
    done = curated(tmp_path / "d", out=tmp_path / "e", gamma=0.5)
    assert done.episodes == 3
    first, second = rows(tmp_path / "d"), rows(tmp_path / "e")
    assert first.keys() == second.keys()
    for name in first:
        assert np.array_equal(first[name], second[name]), name
