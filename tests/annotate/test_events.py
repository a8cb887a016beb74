"""Events are where they were put, on the frames of the clock, and nowhere else."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jiti.annotate.channels import find_channels, words
from jiti.annotate.events import find_events, turning_points
from jiti.episodes.reader import open_reader
from tests.builders.numbers import Numbers, NumbersEpisode

FRAMES = 200
CLOSE, OPEN = 60, 140


def gripper(*, ramp: int = 0, open_at: float = 1.0, closed_at: float = 0.0) -> np.ndarray:
    """(FRAMES, 1): open, closed from frame CLOSE to OPEN, each over `ramp` frames that start there."""
    knots = [0, CLOSE - 1, CLOSE + ramp, OPEN - 1, OPEN + ramp, FRAMES]
    levels = [open_at, open_at, closed_at, closed_at, open_at, open_at]
    return np.interp(np.arange(FRAMES), knots, levels)[:, None]


def found(name: str, values: np.ndarray, names=(), **kwargs) -> list[tuple[int, str]]:
    episode = NumbersEpisode({name: Numbers(values, names, **kwargs)}, FRAMES)
    return [(e.frame, e.kind) for e in find_events(episode)]


@pytest.mark.parametrize(
    ("name", "values", "names"),
    [
        ("/gripper/opening", gripper(), ()),
        ("/gripper", gripper(open_at=100, closed_at=35), ("gripper.pos",)),
        ("/gripper_closed", gripper(open_at=0, closed_at=1), ()),
        ("/joint_states", gripper(open_at=0.04, closed_at=0.021), ("panda_finger_joint1",)),
        ("/joint_states", gripper() * [[0.04, -0.04]], ("left_finger", "right_finger")),
        ("action", gripper(open_at=-1, closed_at=1), ("gripper",)),
        ("observation.state", np.hstack([gripper() * k for k in (40, -200, 0)]), ("hand.j1", "hand.j2", "hand.j3")),
    ],
    ids=["binary", "partly", "named closed", "metres", "pair", "command", "hand"],
)
def test_a_gripper_closes_and_opens_at_the_frames_where_it_does(name, values, names):
    assert found(name, values, names) == [(CLOSE, "gripper_close"), (OPEN, "gripper_open")]


def test_a_slow_gripper_is_found_in_the_middle_of_its_way_and_is_less_sharp():
    fast, slow = (find_events(NumbersEpisode({"gripper": Numbers(gripper(ramp=ramp))}, FRAMES)) for ramp in (0, 30))
    assert [e.kind for e in slow] == ["gripper_close", "gripper_open"]
    assert all(start <= e.frame <= start + 30 for e, start in zip(slow, (CLOSE, OPEN), strict=True))
    assert all(e.sharpness == 1 for e in fast)
    assert all(0 < e.sharpness < 0.4 for e in slow)


@given(seed=st.integers(0, 10_000), scale=st.sampled_from([1e-4, 0.01, 1.0, 300.0]))
def test_noise_is_no_transition(seed, scale):
    noise = np.random.default_rng(seed).normal(0, scale, (FRAMES, 1))
    for name in ("/gripper", "/contact", "/wrench", "/joint_states"):
        assert found(name, noise + 5 * scale) == []
    assert found("/gripper", noise[::3] + 5 * scale, rate_hz=10) == []


@given(seed=st.integers(0, 10_000))
def test_a_noisy_gripper_still_has_exactly_its_two_transitions(seed):
    noisy = gripper(ramp=8) + np.random.default_rng(seed).normal(0, 0.02, (FRAMES, 1))
    noisy[[20, 100]] = [[0.0], [1.0]]  # single samples that are lost
    (close, _), (opened, _) = events = found("/gripper", noisy)
    assert [kind for _, kind in events] == ["gripper_close", "gripper_open"]
    assert abs(close - CLOSE - 4) <= 3
    assert abs(opened - OPEN - 4) <= 3


def test_two_grippers_are_two_sides():
    left, right = gripper(), np.roll(gripper(), 20, axis=0)
    names = ("left_gripper.pos", "right_gripper.pos")
    episode = NumbersEpisode({"observation.state": Numbers(np.hstack([left, right]), names)}, FRAMES)
    events = find_events(episode)
    assert [(e.frame, e.side) for e in events] == [
        (CLOSE, "left"),
        (CLOSE + 20, "right"),
        (OPEN, "left"),
        (OPEN + 20, "right"),
    ]


def test_an_idle_hand_beside_a_busy_one_says_nothing():
    trembling = 0.3 + 0.03 * np.sin(np.arange(FRAMES) / 9)[:, None]
    names = ("kLeftHandThumbBend", "kRightHandThumbBend")
    episode = NumbersEpisode({"/joint_states": Numbers(np.hstack([trembling, gripper(ramp=5)]), names)}, FRAMES)
    assert {e.side for e in find_events(episode) if e.kind.startswith("gripper")} == {"right"}


def test_one_transition_seen_in_two_streams_is_one_event_and_commands_are_left_out():
    episode = NumbersEpisode(
        {
            "/joint_states": Numbers(np.roll(gripper(open_at=0.04), 2, axis=0), ("finger_joint1",)),
            "/gripper/opening": Numbers(gripper()),
            "/command/gripper": Numbers(np.roll(gripper(), -20, axis=0)),
        },
        FRAMES,
    )
    events = [e for e in find_events(episode) if e.kind.startswith("gripper")]
    assert [e.kind for e in events] == ["gripper_close", "gripper_open"]
    assert len(episode.passes) == 1
    assert "/command/gripper" not in episode.passes[0]


def test_streams_that_start_late_run_slower_or_hold_nan_keep_the_frames():
    every_third = gripper()[30::3]
    assert found("/gripper", every_third, rate_hz=10, start_s=1.0) == [
        (CLOSE, "gripper_close"),
        (OPEN + 1, "gripper_open"),
    ]
    holey = np.hstack([gripper(), np.full((FRAMES, 1), np.nan)])
    holey[10:20, 0] = np.nan
    assert found("/gripper", holey) == [(CLOSE, "gripper_close"), (OPEN, "gripper_open")]


@pytest.mark.parametrize("values", [np.full((FRAMES, 2), np.nan), np.zeros((FRAMES, 2)), np.zeros((1, 2))])
def test_a_stream_without_numbers_or_without_change_gives_nothing(values):
    for name in ("/gripper", "/joint_states", "/contact", "/wrench", "/eef_pose"):
        assert found(name, values, ("position.x", "position.y")) == []
    assert find_events(NumbersEpisode({}, FRAMES)) == ()


def test_stops_are_found_and_a_long_rest_has_two_ends():
    speed = np.zeros(FRAMES)
    speed[10:60] = speed[100:150] = np.hanning(50)
    speed[150:190] = np.hanning(40)
    place = np.cumsum(speed)[:, None] * [[1, 0.5, 0]] * 0.01
    events = found("/eef_pose", place, ("position.x", "position.y", "position.z"))
    assert [kind for _, kind in events] == ["velocity_zero"] * len(events)
    for frame in (10, 60, 100, 150, 190):
        assert any(abs(f - frame) <= 5 for f, _ in events), f"no stop near {frame} in {events}"
    assert len(events) == 5


def test_a_slow_stream_does_not_seem_to_stop_between_its_samples():
    steady = np.linspace(0, 1, FRAMES // 6)[:, None] * [[1.0, 2.0]]
    assert found("/joint_states", steady, ("joint1", "joint2"), rate_hz=5.0) == []


def test_contacts_and_forces_begin_and_end():
    touching = np.zeros((FRAMES, 1))
    touching[CLOSE:OPEN] = 1
    touching[100] = 0  # flickers
    assert found("/contact", touching) == [(CLOSE, "contact_on"), (OPEN, "contact_off")]
    force = np.random.default_rng(0).normal(0, 0.05, (FRAMES, 3)) + touching * [[0.0, 3.0, -9.0]]
    assert found("/wrench", force, ("force.x", "force.y", "force.z")) == [(CLOSE, "contact_on"), (OPEN, "contact_off")]


def test_contacts_with_different_things_are_told_apart():
    cube, table = np.zeros((2, FRAMES, 1))
    cube[CLOSE:OPEN], table[30:40] = 2, 1
    assert found("/contact", np.hstack([cube, table]), ("cube", "table")) == [
        (30, "contact_on"),
        (40, "contact_off"),
        (CLOSE, "contact_on"),
        (OPEN, "contact_off"),
    ]


@given(st.lists(st.floats(-5, 5), min_size=1, max_size=60), st.floats(0.1, 3))
def test_turning_points_alternate_and_differ_by_the_swing(values, swing):
    signal = np.array(values)
    pivots = turning_points(signal, swing)
    steps = np.diff(signal[pivots])
    assert (np.abs(steps) >= swing).all()
    assert (np.sign(steps[1:]) == -np.sign(steps[:-1])).all()
    assert pivots == sorted(set(pivots))
    # Nothing is missed: a whole span of twice the swing cannot pass without a turning point.
    assert pivots or np.ptp(signal) < 2 * swing


def test_names_are_read_as_words():
    assert words("kLeftHandThumbBend") == ("k", "left", "hand", "thumb", "bend")
    assert words("robot0_eye_in_hand/TCPPose.position.x") == (
        *("robot", "0", "eye", "in", "hand"),
        *("tcp", "pose", "position", "x"),
    )


def test_the_end_effector_is_preferred_to_joints_and_an_object_is_neither():
    xyz = ("position.x", "position.y", "position.z", "orientation.x", "orientation.y", "orientation.z", "orientation.w")
    episode = NumbersEpisode(
        {
            "/joint_states": Numbers(np.zeros((9, 2)), ("joint1", "velocity.joint1")),
            "/cube_pose": Numbers(np.zeros((9, 7)), xyz),
            "/eef_pose": Numbers(np.zeros((9, 7)), xyz),
        },
        9,
    )
    assert [(c.role, c.stream, c.columns) for c in find_channels(episode.streams)] == [
        ("motion", "/eef_pose", (0, 1, 2))
    ]


@pytest.mark.parametrize(
    ("source", "episode_number", "close", "opened"),
    [
        ("mcap/g1_pick.mcap", 0, 188, 315),
        ("lerobot/bimanual_v3", 0, 55, 263),
        ("lerobot/bimanual_v3", 3, 43, 369),
    ],
)
def test_hands_of_real_robots_grasp_and_release_where_their_plots_show_it(
    shared, source, episode_number, close, opened
):
    reader = open_reader(shared / source)
    episode = reader.open(reader.episodes()[episode_number].episode_id)
    events = [e for e in find_events(episode) if e.kind.startswith("gripper")]
    assert {e.side for e in events} == {"right"}
    # Read off the plots of the finger joints; hands take ten frames to close.
    assert min(abs(e.frame - close) for e in events if e.kind == "gripper_close") <= 5
    assert min(abs(e.frame - opened) for e in events if e.kind == "gripper_open") <= 5
    assert len(events) <= 3
