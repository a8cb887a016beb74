"""Rewards by hand and against a model that goes frame by frame."""

import time
from itertools import pairwise

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jiti.annotate.segments import SCHEMA, Segment
from jiti.curate.rewards import frame_rewards
from jiti.curate.verdicts import spans
from tests.builders.labels import segment, table

HOLD, PLACE = "t/hold", "t/place"


def one(*rows: tuple[str, Segment], frames: int = 10) -> tuple[list[int], list[int]]:
    """Rewards and annotated frames of the one episode `ep`."""
    found = frame_rewards(table(*rows), {"ep": frames})
    return found.reward.astype(int).tolist(), np.flatnonzero(found.annotated).tolist()


def test_a_segment_covers_both_its_ends() -> None:
    assert one(("anna", segment(2, 4, 1))) == ([0, 0, 1, 1, 1, 0, 0, 0, 0, 0], [2, 3, 4])
    assert one(("anna", segment(0, 0, 1)), ("anna", segment(9, 9, 0))) == ([1, *[0] * 9], [0, 9])


def test_a_frame_is_elegant_when_every_itc_decided_there_is_satisfied() -> None:
    rows = [
        ("anna", segment(0, 5, 1, itc_id=HOLD)),
        ("anna", segment(3, 7, 0, itc_id=PLACE)),
        ("anna", segment(7, 9, 1, itc_id=HOLD)),
    ]
    assert one(*rows) == ([1, 1, 1, 0, 0, 0, 0, 0, 1, 1], list(range(10)))


def test_only_accepted_verdicts_count() -> None:
    rows = [
        ("anna", segment(0, 9, None)),
        ("anna", segment(0, 9, 1, status="rejected")),
        ("vlm", segment(0, 9, 1, status="proposed", source="vlm")),
    ]
    assert one(*rows) == ([0] * 10, [])
    assert one(*rows, ("anna", segment(4, 4, 1, source="vlm"))) == ([0, 0, 0, 0, 1, 0, 0, 0, 0, 0], [4])


def test_of_one_annotator_the_lower_verdict_holds() -> None:
    assert one(("anna", segment(0, 6, 1)), ("anna", segment(5, 9, 0)))[0] == [1, 1, 1, 1, 1, 0, 0, 0, 0, 0]


def test_the_majority_decides_and_ties_fail() -> None:
    rows = [("anna", segment(0, 9, 1)), ("bob", segment(2, 9, 0)), ("cleo", segment(5, 9, 1))]
    assert one(*rows) == ([1, 1, 0, 0, 0, 1, 1, 1, 1, 1], list(range(10)))


def test_the_majority_is_taken_for_each_itc_by_itself() -> None:
    rows = [
        ("anna", segment(0, 9, 1, itc_id=HOLD)),
        ("bob", segment(0, 9, 1, itc_id=HOLD)),
        ("anna", segment(0, 9, 0, itc_id=PLACE)),
    ]
    assert one(*rows)[0] == [0] * 10


def test_what_is_settled_replaces_what_it_names_and_everyone_on_its_frames() -> None:
    rows = [
        ("anna", segment(0, 9, 0, itc_id=HOLD)),
        ("bob", segment(0, 9, 0, itc_id=HOLD)),
        ("adjudicated", segment(2, 5, 1, itc_id=HOLD)),
        ("anna", segment(4, 9, 1, itc_id=PLACE)),
    ]
    assert one(*rows) == ([0, 0, 1, 1, 1, 1, 0, 0, 0, 0], list(range(10)))
    parents = [row.segment_id for _, row in rows[:2]]
    settled = [("adjudicated", segment(0, 9, 0, itc_id=HOLD, status="rejected", parent_id=name)) for name in parents]
    assert one(*rows, *settled) == ([0, 0, 1, 1, 1, 1, 1, 1, 1, 1], list(range(2, 10)))
    assert one(*rows[:2], *settled) == ([0] * 10, [])  # settled: there is no such segment
    assert one(*rows[:2], settled[0]) == ([0] * 10, list(range(10)))  # bob's is still there
    elsewhere = segment(0, 3, 1, itc_id=HOLD, episode_id="other")
    found = frame_rewards(table(*rows[:2], ("adjudicated", elsewhere)), {"ep": 10, "other": 5})
    assert found.reward.tolist() == [0] * 10 + [1, 1, 1, 1, 0]


def test_what_lies_outside_an_episode_is_left_out() -> None:
    rows = [("anna", segment(8, 500, 1)), ("anna", segment(10, 20, 0)), ("anna", segment(0, 3, 1, episode_id="gone"))]
    assert one(*rows) == ([0] * 8 + [1, 1], [8, 9])


def test_episodes_come_in_the_given_order() -> None:
    rows = [("anna", segment(0, 0, 1, episode_id=name)) for name in "abc"]
    found = frame_rewards(table(*rows), {"c": 2, "none": 3, "a": 1, "empty": 0, "b": 2})
    assert found.episode_ids == ["c", "none", "a", "empty", "b"]
    assert found.offsets.tolist() == [0, 2, 5, 6, 6, 8]
    assert found.reward.tolist() == [1, 0, 0, 0, 0, 1, 1, 0]
    assert found.reward.dtype == np.float32
    assert found.reward[found.frames("b")].tolist() == [1, 0]
    assert found.frames("empty") == slice(6, 6)
    with pytest.raises(KeyError, match="nowhere"):
        found.frames("nowhere")


@pytest.mark.parametrize("frames", [{}, {"ep": 0}, {"ep": 4}])
def test_without_segments_nothing_is_annotated(frames: dict[str, int]) -> None:
    found = frame_rewards(table(), frames)
    assert found.reward.tolist() == [0] * sum(frames.values())
    assert not found.annotated.any()
    assert frame_rewards(table(("anna", segment(0, 3, 1, episode_id="x"))), frames).annotated.sum() == 0


annotators = st.sampled_from(["anna", "bob", "cleo", "adjudicated"])
rows = st.lists(
    st.tuples(
        annotators,
        st.builds(
            lambda start, more, reward, status, itc, episode, name, parent: segment(
                start,
                start + more,
                reward,
                status=status,
                itc_id=itc,
                episode_id=episode,
                segment_id=name,
                parent_id=parent,
            ),
            st.integers(0, 12),
            st.integers(0, 8),
            st.sampled_from([None, 0, 1, 1]),
            st.sampled_from(["accepted", "accepted", "accepted", "rejected", "proposed"]),
            st.sampled_from([HOLD, PLACE]),
            st.sampled_from(["a", "b", "gone"]),
            st.sampled_from(["s1", "s2", "s3", "s4"]),
            st.sampled_from([None, "s1", "s2"]),
        ),
    ),
    max_size=12,
)


def modelled(rows: list[tuple[str, Segment]], episode: str, frame: int) -> int | None:
    """The reward of one frame straight from the rule; None where nothing is decided."""
    verdicts = []
    for itc in (HOLD, PLACE):
        settled = {row.parent_id for who, row in rows if who == "adjudicated" and row.status != "proposed"}
        here = [(who, row) for who, row in rows if row.episode_id == episode and row.itc_id == itc]
        here = [(who, row) for who, row in here if who == "adjudicated" or row.segment_id not in settled]
        votes = {}
        for who, row in here:
            if row.status == "accepted" and row.reward is not None and row.start_frame <= frame <= row.end_frame:
                votes[who] = min(row.reward, votes.get(who, 1))
        if "adjudicated" in votes:
            votes = {"adjudicated": votes["adjudicated"]}
        if votes:
            verdicts.append(1 if 2 * sum(votes.values()) > len(votes) else 0)
    return min(verdicts) if verdicts else None


@settings(deadline=None)
@given(rows)
def test_every_frame_is_as_the_rule_says(rows: list[tuple[str, Segment]]) -> None:
    counts = {"b": 10, "a": 15}
    found = frame_rewards(table(*rows), counts)
    expected = [modelled(rows, episode, frame) for episode, count in counts.items() for frame in range(count)]
    assert found.annotated.tolist() == [verdict is not None for verdict in expected]
    assert found.reward.tolist() == [verdict or 0 for verdict in expected]


@settings(deadline=None)
@given(rows)
def test_spans_are_in_order_apart_and_inside_the_episode(rows: list[tuple[str, Segment]]) -> None:
    found = spans(table(*rows), {"b": 10, "a": 15})
    assert (found.start <= found.end).all()
    assert (found.end < np.array([10, 15])[found.episode]).all()
    assert ((found.passes + found.fails) > 0).all()
    places = list(zip(found.episode, found.itc, found.start, found.end, strict=True))
    assert places == sorted(places)
    for (episode, itc, _, end), (episode_2, itc_2, start_2, _) in pairwise(places):
        assert (episode, itc) != (episode_2, itc_2) or end < start_2


def test_ten_thousand_episodes_take_no_time() -> None:
    count = 30_000
    rng = np.random.default_rng(0)
    start = rng.integers(0, 270, count)
    columns = {
        "segment_id": [str(k) for k in range(count)],
        "episode_id": [f"episode_{k // 3:06}" for k in range(count)],
        "itc_id": [f"t/{k % 3}" for k in range(count)],
        "criterion": ["pose_alignment"] * count,
        "start_frame": start,
        "end_frame": start + 24,
        "reward": rng.integers(0, 2, count).astype(np.int8),
        "status": ["accepted"] * count,
        "source": ["human"] * count,
    }
    for name in SCHEMA.names:
        columns.setdefault(name, [None] * count if SCHEMA.field(name).nullable else np.zeros(count, np.int64))
    segments = pa.table({name: columns[name] for name in SCHEMA.names}, schema=SCHEMA)
    segments = segments.append_column("annotator", pa.array(["anna"] * count))
    begin = time.process_time()
    found = frame_rewards(segments, {f"episode_{k:06}": 300 for k in range(10_000)})
    assert time.process_time() - begin < 2  # 0.1 s; one step of Python for each of 3 million frames takes longer
    assert found.reward.shape == (3_000_000,)
    assert 0.05 < found.reward.mean() < 0.2
