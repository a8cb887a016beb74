"""Proposals stand where their criterion is decided, undecided, inside the episode."""

import pytest

from jiti.annotate.events import Event
from jiti.annotate.segments import DEFAULT_WINDOW_FRAMES
from jiti.annotate.signals import AFTER_FRAMES, propose_segments
from jiti.tasks.task import ITC, Criterion, Task
from tests.builders.numbers import NumbersEpisode

TASK = Task("t", "put it there", tuple(ITC(f"t/{c.value}", "…", c) for c in Criterion))
CLOSE, OPEN = Event(60, "gripper_close", "/gripper", 0.9), Event(140, "gripper_open", "/gripper", 0.7)


def ends(events, frame_count=200, task=TASK) -> dict[str, list[int]]:
    found: dict[str, list[int]] = {}
    for segment in propose_segments(NumbersEpisode({}, frame_count), task, tuple(events)):
        found.setdefault(segment.criterion, []).append(segment.end_frame)
    return found


def test_each_criterion_has_its_place_around_grasp_and_release():
    assert ends([CLOSE, OPEN]) == {
        "task_sequence_integrity": [140 + AFTER_FRAMES],
        "target_pose_accuracy": [140],
        "pose_alignment": [140],
        "collision_free_execution": [140 - DEFAULT_WINDOW_FRAMES],
    }


def test_every_proposal_is_an_undecided_window_with_a_reason():
    episode = NumbersEpisode({}, 200)
    proposals = propose_segments(episode, TASK, (CLOSE, OPEN))
    assert len({p.segment_id for p in proposals}) == len(TASK.itcs)
    for p in proposals:
        assert (p.status, p.source, p.reward, p.parent_id) == ("proposed", "signal", None, None)
        assert p.frame_count == DEFAULT_WINDOW_FRAMES
        assert (p.start_ns, p.end_ns) == tuple(episode.clock.frame_ns[[p.start_frame, p.end_frame]])
        assert p.confidence is not None
        assert 0 < p.confidence <= 0.9
        assert p.rationale is not None
        assert "140" in p.rationale


def test_a_contact_on_the_way_draws_the_collision_window():
    touched = Event(100, "contact_on", "/contact", 1.0)
    (end,) = ends([CLOSE, touched, OPEN])["collision_free_execution"]
    assert end - DEFAULT_WINDOW_FRAMES < 100 < end


def test_a_second_hold_gets_its_own_windows_and_opening_wider_before_a_grasp_gets_none():
    wider = Event(20, "gripper_open", "/gripper", 0.3)
    again = Event(150, "gripper_close", "/gripper", 0.9), Event(180, "gripper_open", "/gripper", 0.9)
    assert ends([wider, CLOSE, OPEN, *again])["target_pose_accuracy"] == [140, 180]


def test_a_grasp_without_release_is_decided_at_the_grasp():
    assert ends([CLOSE])["task_sequence_integrity"] == [60 + AFTER_FRAMES]
    assert ends([CLOSE])["pose_alignment"] == [60]


def test_a_release_without_grasp_counts_when_the_object_was_held_from_the_start():
    assert ends([OPEN])["pose_alignment"] == [140]


def test_a_push_ends_where_the_motion_ends_and_no_event_proposes_nothing():
    stops = [Event(frame, "velocity_zero", "/joint_states", 1.0) for frame in (50, 120)]
    assert ends(stops) == {c.value: [120 + AFTER_FRAMES] for c in Criterion}
    assert ends([]) == {}
    assert ends([CLOSE, OPEN], task=Task("t", "nothing else asked", ())) == {}


@pytest.mark.parametrize("frame_count", [10, 25, 61, 141])
def test_windows_never_leave_the_episode(frame_count):
    events = [e for e in (CLOSE, OPEN) if e.frame < frame_count] or [Event(3, "gripper_close", "/gripper", 1.0)]
    for p in propose_segments(NumbersEpisode({}, frame_count), TASK, tuple(events)):
        assert 0 <= p.start_frame <= p.end_frame < frame_count
        assert p.frame_count == min(DEFAULT_WINDOW_FRAMES, frame_count)


def test_two_hands_at_once():
    right = Event(80, "gripper_close", "/gripper", 0.9, "right"), Event(120, "gripper_open", "/gripper", 0.9, "right")
    left = Event(60, "gripper_close", "/gripper", 0.9, "left"), Event(140, "gripper_open", "/gripper", 0.9, "left")
    assert ends(sorted([*right, *left], key=lambda e: e.frame))["pose_alignment"] == [120, 140]
