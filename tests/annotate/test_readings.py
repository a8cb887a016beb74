"""Poses, contacts and openings on an episode's frames, from recordings that are written here."""

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jiti.annotate.readings import Readings
from jiti.episodes.episode import Batch, Episode
from jiti.episodes.mcap_writer import McapWriter
from jiti.episodes.reader import open_reader
from jiti.tasks.rotation import about, quaternion_xyzw
from tests.builders.encode import encode_numbered

START_NS = 1_735_689_600_000_000_000
STEP_NS = 50_000_000
"""20 Hz, as `jiti record` writes."""
FRAMES = 24

Poses = Mapping[str, np.ndarray | tuple[np.ndarray, np.ndarray]]
"""By topic: places (steps, 3) in m, alone or with rotations (steps, 3, 3)."""


def recording(
    folder: Path,
    poses: Poses | None = None,
    contacts: Mapping[str, Sequence[float] | np.ndarray] | None = None,
    opening_m: Sequence[float] | np.ndarray | None = None,
    hand_m: np.ndarray | None = None,
    rate_hz: int = 20,
) -> Episode:
    """An episode without pictures, a step a frame, with topics as `jiti record` names them."""
    tracks = {topic: pose if isinstance(pose, tuple) else (pose, None) for topic, pose in (poses or {}).items()}
    if hand_m is not None:
        tracks["/eef_pose"] = (hand_m, None)
    lengths = [len(place) for place, _ in tracks.values()] + [len(held) for held in (contacts or {}).values()]
    steps = max([*lengths, 0 if opening_m is None else len(opening_m)])
    with McapWriter(folder / "a.mcap", metadata={"rate_hz": str(rate_hz)}) as writer:
        for step in range(steps):
            time_ns = START_NS + round(step * 1e9 / rate_hz)
            for topic, (place, rotation) in tracks.items():
                quaternion = [0, 0, 0, 1] if rotation is None else quaternion_xyzw(rotation[step])
                writer.write_pose(topic, time_ns, place[step], quaternion, frame_id="world")
            if contacts:
                writer.write_vector(
                    "/contacts", time_ns, [*contacts], [float(held[step]) for held in contacts.values()]
                )
            if opening_m is not None:
                writer.write_vector("/gripper", time_ns, ["opening_m"], [opening_m[step]])
            # Something that goes on to the last step, whatever else there is.
            writer.write_vector("/battery", time_ns, ["volts"], [24.0])
    return opened(folder)


def opened(folder: Path) -> Episode:
    reader = open_reader(folder)
    (ref,) = reader.episodes()
    return reader.open(ref.episode_id)


def line(steps: int = FRAMES) -> np.ndarray:
    """(steps, 3) m: a place that tells its step."""
    return np.arange(steps)[:, None] * [0.01, -0.02, 0.03]


@settings(max_examples=40, deadline=None)
@given(st.sets(st.integers(0, (FRAMES - 1) * STEP_NS), min_size=1, max_size=2 * FRAMES).map(sorted))
def test_a_frame_shows_the_latest_sample_at_or_before_it_and_the_first_where_there_is_none(offsets_ns):
    with tempfile.TemporaryDirectory() as folder:
        with McapWriter(Path(folder) / "a.mcap", metadata={"rate_hz": "20"}) as writer:
            for step in range(FRAMES):
                writer.write_vector("/battery", START_NS + step * STEP_NS, ["volts"], [24.0])
            for k, offset_ns in enumerate(offsets_ns):
                writer.write_pose("/objects/bowl_1", START_NS + offset_ns, [k, 0, 0], [0, 0, 0, 1], frame_id="world")
        readings = Readings(opened(Path(folder)))
        place = readings.position_m("bowl_1")
    assert place is not None
    shown = [max([0, *(k for k, t in enumerate(offsets_ns) if t <= frame * STEP_NS)]) for frame in range(FRAMES)]
    assert place[:, 0].tolist() == shown
    assert (readings.frames, readings.rate_hz) == (FRAMES, pytest.approx(20))


def test_frames_are_the_cameras_where_there_is_one(tmp_path):
    with McapWriter(tmp_path / "a.mcap") as writer:
        for step in range(10):
            writer.write_pose("/objects/bowl_1", START_NS + step * STEP_NS, [step, 0, 0], [0, 0, 0, 1], frame_id="w")
            if step % 3 == 0:  # pictures of steps 0, 3, 6, 9, each a little late
                data = encode_numbered([step], "jpeg", 64, 48)[0]
                writer.write_picture("/camera/front", START_NS + step * STEP_NS + 1000, data)
    place = Readings(opened(tmp_path)).position_m("bowl_1")
    assert place is not None
    assert place[:, 0].tolist() == [0, 3, 6, 9]


def test_poses_come_by_the_last_part_of_their_topic_as_they_were_written(tmp_path):
    turns = np.array([about([1, 2, 3], 0.1 * step) for step in range(FRAMES)])
    readings = Readings(recording(tmp_path, {"/objects/bowl_1": (line(), turns), "/table/slot_2": line()}))
    assert sorted(readings.things) == ["bowl_1", "slot_2"]
    place, rotation, level = readings.position_m("bowl_1"), readings.rotation("bowl_1"), readings.rotation("slot_2")
    assert place is not None
    assert rotation is not None
    assert level is not None
    np.testing.assert_array_equal(place, line())
    np.testing.assert_allclose(rotation, turns, atol=1e-12)
    np.testing.assert_allclose(level, np.broadcast_to(np.eye(3), (FRAMES, 3, 3)), atol=1e-12)


def test_what_was_not_recorded_is_none(tmp_path):
    readings = Readings(recording(tmp_path, {"/objects/bowl_1": line()}))
    assert readings.position_m("plate_1") is None
    assert readings.rotation("plate_1") is None
    assert readings.position_m("battery") is None  # a number is no pose
    assert readings.touching("gripper", "bowl_1") is None
    assert readings.opening is None
    assert readings.hand_m is None


def test_a_thing_that_was_lost_for_a_moment_has_no_pose(tmp_path):
    place = line()
    place[7, 1] = np.nan
    readings = Readings(recording(tmp_path, {"/objects/bowl_1": place, "/objects/plate_1": line()}))
    assert readings.position_m("bowl_1") is None
    assert readings.rotation("bowl_1") is None
    assert readings.position_m("plate_1") is not None


def test_a_place_without_an_orientation_has_no_rotation(tmp_path):
    with McapWriter(tmp_path / "a.mcap") as writer:
        for step in range(10):
            writer.write_pose("/objects/bowl_1", START_NS + step * STEP_NS, [0, 0, 0], [0, 0, 0, 0], frame_id="w")
    readings = Readings(opened(tmp_path))
    assert readings.rotation("bowl_1") is None
    assert readings.position_m("bowl_1") is not None


@pytest.mark.parametrize("topics", [("/objects/bowl_1", "/regions/bowl_1"), ("/regions/bowl_1", "/objects/bowl_1")])
def test_an_objects_own_place_goes_before_what_else_is_called_so(tmp_path, topics):
    places = {"/objects/bowl_1": line(), "/regions/bowl_1": line() + 5}
    found = Readings(recording(tmp_path, {topic: places[topic] for topic in topics})).position_m("bowl_1")
    assert found is not None
    np.testing.assert_array_equal(found, line())


def test_contacts_know_no_order_and_count_a_region_as_what_it_belongs_to(tmp_path):
    held, rests = np.arange(FRAMES) > 9, np.arange(FRAMES) > 15
    contacts = {"gripper-bowl_1": held, "bowl_1-caddy_1": rests, "bowl_1-caddy_10": ~rests}
    readings = Readings(recording(tmp_path, contacts=contacts))
    for pair, expected in (
        (("gripper", "bowl_1"), held),
        (("bowl_1", "caddy_1"), rests),
        (("bowl_1", "caddy_1_back_contain_region"), rests),
        (("bowl_1", "caddy_10"), ~rests),
        (("bowl_1", "caddy_10_back_contain_region"), ~rests),
    ):
        for one, other in (pair, pair[::-1]):
            touching = readings.touching(one, other)
            assert touching is not None
            assert touching.tolist() == expected.tolist(), (one, other)
    assert readings.touching("gripper", "caddy_1") is None  # that pair was not watched
    assert readings.touching("bowl_1", "caddy") is None


def test_a_contact_that_is_missing_once_is_not_known(tmp_path):
    held = np.ones(FRAMES)
    held[5] = np.nan
    readings = Readings(recording(tmp_path, contacts={"gripper-bowl_1": held, "gripper-cup_1": np.ones(FRAMES)}))
    assert readings.touching("gripper", "bowl_1") is None
    touching = readings.touching("gripper", "cup_1")
    assert touching is not None
    assert touching.all()


def test_a_name_belongs_to_the_longest_thing_that_it_begins_with(tmp_path):
    never = [False] * FRAMES
    readings = Readings(recording(tmp_path, contacts={"gripper-box_1": never, "gripper-box_1_lid": never}))
    owners = {
        "box_1": "box_1",
        "box_1_floor": "box_1",
        "box_1_lid": "box_1_lid",
        "box_1_lid_knob": "box_1_lid",
        "box_1_lidless": "box_1",
        "box_11": "box_11",
        "box": "box",
        "shelf_1_top": "shelf_1_top",
    }
    assert {name: readings.owner(name) for name in owners} == owners


def test_a_gripper_is_open_as_a_share_of_its_travel(tmp_path):
    opening_m = np.array([0.08] * 8 + [0.06] * 8 + [0.03] * 8)
    opening = Readings(recording(tmp_path, opening_m=opening_m)).opening
    assert opening is not None
    np.testing.assert_allclose(opening, [1] * 8 + [0.6] * 8 + [0] * 8, atol=1e-9)


def test_a_gripper_that_never_moves_says_nothing(tmp_path):
    assert Readings(recording(tmp_path, opening_m=[0.08] * FRAMES)).opening is None


@pytest.mark.parametrize(("moves", "thing"), [(False, "mug_1"), (True, "left_mug_1")])
def test_what_a_simulator_measured_is_no_gripper(tmp_path, moves, thing):
    with McapWriter(tmp_path / "a.mcap") as writer:
        for step in range(FRAMES):
            time_ns, closed = START_NS + step * STEP_NS, 8 < step < 16
            writer.write_vector("/gripper", time_ns, ["opening_m"], [0.04 if closed and moves else 0.08])
            # As `jiti record` writes it: how many fingers do not touch the mug.
            writer.write_vector("/measures", time_ns, [f"IsGrasping {thing} open_fingers"], [0.0 if closed else 2.0])
    opening = Readings(opened(tmp_path)).opening
    assert (opening is not None) == moves


def test_the_hand_is_where_the_end_effector_is(tmp_path):
    hand = Readings(recording(tmp_path, {"/objects/bowl_1": line() + 3}, hand_m=line())).hand_m
    assert hand is not None
    np.testing.assert_array_equal(hand, line())


def test_three_joints_are_no_place(tmp_path):
    with McapWriter(tmp_path / "a.mcap") as writer:
        for step in range(FRAMES):
            writer.write_vector("/joint_states", START_NS + step * STEP_NS, ["hip", "knee", "ankle"], line()[step])
    assert Readings(opened(tmp_path)).hand_m is None


def test_of_two_arms_neither_is_taken(tmp_path):
    with McapWriter(tmp_path / "a.mcap") as writer:
        for step in range(FRAMES):
            for side in ("left", "right"):
                time_ns = START_NS + step * STEP_NS
                writer.write_vector(f"/{side}/gripper", time_ns, ["opening_m"], [0.08 if step < 9 else 0.04])
                writer.write_pose(f"/{side}/eef_pose", time_ns, line()[step], [0, 0, 0, 1], frame_id="w")
    readings = Readings(opened(tmp_path))
    assert readings.opening is None
    assert readings.hand_m is None


def test_the_file_is_read_once_however_much_is_asked_for(tmp_path, monkeypatch):
    episode = recording(
        tmp_path,
        {"/objects/bowl_1": line(), "/objects/plate_1": line()},
        {"gripper-bowl_1": [True] * FRAMES},
        [0.08] * 12 + [0.04] * 12,
        line(),
    )
    passes: list[Sequence[str] | None] = []
    read = episode.read

    def counted(streams: Sequence[str] | None = None) -> Iterator[Batch]:
        passes.append(streams)
        return read(streams)

    monkeypatch.setattr(episode, "read", counted)
    readings = Readings(episode)
    for _ in range(2):
        assert readings.position_m("bowl_1") is not None
        assert readings.rotation("plate_1") is not None
        assert readings.touching("gripper", "bowl_1") is not None
        assert readings.opening is not None
        assert readings.hand_m is not None
    assert len(passes) == 1
    assert "/battery" not in (passes[0] or ["/battery"])  # nor more than that
