"""What cannot be curated is refused in one message, and nothing is left at the place of the dataset."""

import tomllib
from pathlib import Path

import numpy as np
import pytest

from jiti.curate.export.command import Request, print_features
from jiti.curate.export.journal import Journal
from jiti.episodes.mcap_writer import McapWriter
from jiti.episodes.reader import open_reader
from jiti.errors import JitiError, LabelError, SourceError, UsageError
from tests.builders.curate import curated, mark, propose, write_picks
from tests.builders.labels import names_in
from tests.builders.mcap import Camera

GOOD = [(5, 14, 1)]


@pytest.fixture
def picks(tmp_path: Path) -> Path:
    return write_picks(tmp_path / "demos", [GOOD, GOOD])


def refused(kind: type[JitiError], *sources: Path, out: Path, **options) -> str:
    """The message; nothing may be left behind."""
    with pytest.raises(kind) as error:
        curated(*sources, out=out, **options)
    assert not out.exists()
    assert not any(name.startswith(f".{out.name}") for name in names_in(out.parent))
    return str(error.value)


def own_recording(folder: Path, values: np.ndarray, names: tuple[str, ...] = ("a", "b"), *, hz: float = 20) -> Path:
    """A recording with `/proprio` and `/action` of these values (frames, size), labelled."""
    folder.mkdir(parents=True)
    about = {"rate_hz": str(hz)}
    with McapWriter(folder / "own.mcap", instruction="pick", metadata=about) as writer:
        for k, row in enumerate(values):
            for topic in ("/proprio", "/action"):
                writer.write_vector(topic, 10**9 + round(k * 1e9 / hz), names, row)
    mark(folder, "own", GOOD)
    return folder


def test_a_source_without_labels_names_the_command_that_makes_them(tmp_path):
    demos = write_picks(tmp_path / "demos", [None])
    said = refused(LabelError, demos, out=tmp_path / "d")
    assert "jiti annotate" in said
    assert "jiti autolabel" in said
    propose(demos, "pick_0", GOOD)
    said = refused(LabelError, demos, out=tmp_path / "d")
    assert "--accept sim" in said
    assert "jiti autolabel" not in said


def test_labels_of_an_episode_that_does_not_exist(picks, tmp_path):
    (picks / "pick_1.mcap").unlink()
    said = refused(LabelError, picks, out=tmp_path / "d")
    assert "labels of 'pick_1'" in said
    assert "demos has no such episode" in said


def test_labels_of_another_recording(picks, tmp_path):
    (picks / "pick_1.mcap").write_bytes((picks / "pick_0.mcap").read_bytes())
    said = refused(LabelError, picks, out=tmp_path / "d")
    assert "pick_1.mcap: the recording was changed after it was labelled (it had 36 frames and has 30)" in said
    assert f"jiti validate-rewards {picks} --confirm" in said


def test_labels_of_the_folder_above_are_found(tmp_path):
    for number in (1, 2):
        write_picks(tmp_path / "rec" / f"T{number}", [None])
        mark(tmp_path / "rec", f"T{number}%2Fpick_0", GOOD, itc=f"mine/T{number}/neat")
    one, two = tmp_path / "rec" / "T1", tmp_path / "rec" / "T2"
    hint = f"""of which T2 is a part. Curate that folder and keep this part: `jiti curate {tmp_path / "rec"} --filter"""
    hint += """ "task == 'mine/T2'"`."""
    assert hint.replace("T2 is", "it is") in refused(LabelError, two, out=tmp_path / "d")
    labels = (tmp_path / "rec" / "labels",)
    said = refused(LabelError, two, one, out=tmp_path / "d", labels=labels)
    assert hint in said
    assert "move" not in said
    mark(tmp_path / "rec", "T1%2Fpick_0", GOOD, annotator="ben", itc="mine/T2/neat")
    assert "--filter \"'T2%2F' in episode\"" in refused(LabelError, two, out=tmp_path / "d")
    assert curated(tmp_path / "rec", out=tmp_path / "d", condition="'T2%2F' in episode").episodes == 1


def test_mixed_rates(picks, tmp_path):
    slow = own_recording(tmp_path / "slow", np.zeros((30, 2)))
    said = refused(UsageError, picks, slow, out=tmp_path / "d")
    assert "demos, pick_0.mcap runs at 30 Hz, slow, own.mcap at 20 Hz. Pass --fps 20" in said


def test_a_rate_that_is_no_whole_number(tmp_path):
    odd = own_recording(tmp_path / "odd", np.zeros((30, 2)), hz=12.5)
    assert "12.5 Hz" in refused(UsageError, odd, out=tmp_path / "d")
    assert curated(odd, out=tmp_path / "d", fps=12).fps == 12


def test_features_that_disagree(picks, tmp_path):
    other = own_recording(tmp_path / "other", np.zeros((30, 2)), hz=30)
    said = refused(SourceError, picks, other, out=tmp_path / "d")
    assert "'observation.state' is 7 numbers in demos, pick_0.mcap, and 2 numbers in other, own.mcap" in said
    renamed = own_recording(tmp_path / "renamed", np.zeros((30, 2)), ("b", "a"), hz=30)
    said = refused(SourceError, other, renamed, out=tmp_path / "d")
    assert "number 0 of 'observation.state' is 'a' in other, own.mcap, and 'b' in renamed, own.mcap" in said


def test_a_camera_that_only_some_have(tmp_path):
    small = {"/camera/front": Camera(width=64, height=48)}
    one = write_picks(tmp_path / "one", [GOOD], cameras=small)
    two = write_picks(tmp_path / "two", [GOOD], cameras={**small, "/camera/wrist": Camera(width=64, height=48)})
    said = refused(SourceError, one, two, out=tmp_path / "d")
    assert "two, pick_0.mcap has 'observation.images.wrist', and one, pick_0.mcap has not" in said
    large = write_picks(tmp_path / "large", [GOOD], cameras={"/camera/front": Camera(width=96, height=48)})
    assert "64x48 pixels in one" in refused(SourceError, one, large, out=tmp_path / "d")


def test_missing_streams(tmp_path):
    demos = write_picks(tmp_path / "demos", [GOOD], action_topic=None)
    said = refused(SourceError, demos, out=tmp_path / "d")
    assert "demos, pick_0.mcap: no stream is called what 'action' is usually called" in said
    assert "/joint_states" in said
    mapping = tmp_path / "features.toml"
    mapping.write_text('[features."action"]\nstreams = ["/commands"]\n')
    said = refused(SourceError, demos, out=tmp_path / "d", features=mapping)
    assert "'/commands' is not there" in said
    assert "it has: /joint_states" in said
    mapping.write_text('[features."action"]\nstreams = ["/joint_states"]\ncomponents = ["elbow"]\n')
    assert "has no component 'elbow'" in refused(SourceError, demos, out=tmp_path / "d", features=mapping)


def test_nan_in_state_names_recording_stream_frame_and_component(tmp_path):
    values = np.zeros((30, 2))
    values[17, 1] = np.nan
    demos = own_recording(tmp_path / "demos", values)
    said = refused(SourceError, demos, out=tmp_path / "d")
    assert "demos, own.mcap, /proprio, frame 17: b is nan" in said
    assert "--filter \"episode != 'own'\"" in said


def test_a_stream_that_starts_late(tmp_path):
    folder = tmp_path / "demos"
    folder.mkdir()
    with McapWriter(folder / "own.mcap", instruction="pick", metadata={"rate_hz": "20"}) as writer:
        for k in range(40):
            writer.write_vector("/proprio", 10**9 + k * 50_000_000, ["a"], [0.0])
            if k >= 25:
                writer.write_vector("/action", 10**9 + k * 50_000_000, ["a"], [0.0])
    mark(folder, "own", GOOD)
    assert "/action: has nothing before frame 25" in refused(SourceError, folder, out=tmp_path / "d")


def test_a_camera_without_pictures_at_the_start(tmp_path):
    cameras = {"/camera/front": Camera(width=64, height=48), "/camera/wrist": Camera(width=64, height=48, start_s=0.7)}
    demos = write_picks(tmp_path / "demos", [GOOD], cameras=cameras)
    said = refused(SourceError, demos, out=tmp_path / "d")
    assert "pick_0.mcap, /camera/wrist: frames 0 to 20 have no picture" in said


def test_an_existing_dataset_is_replaced_only_when_asked(picks, tmp_path):
    curated(picks, out=tmp_path / "d")
    before = (tmp_path / "d" / "README.md").stat().st_mtime_ns
    with pytest.raises(UsageError, match="--overwrite"):
        curated(picks, out=tmp_path / "d")
    assert (tmp_path / "d" / "README.md").stat().st_mtime_ns == before
    assert curated(picks, out=tmp_path / "d", overwrite=True, condition="episode == 'pick_1'").episodes == 1
    assert names_in(tmp_path) == ["d", "demos"]


def test_what_is_no_dataset_is_never_replaced(picks, tmp_path):
    (tmp_path / "home").mkdir()
    (tmp_path / "home" / "letter.txt").write_text("dear")
    for out in (tmp_path / "home", picks, picks.parent, tmp_path / "home" / "letter.txt"):
        with pytest.raises(UsageError, match="name another folder"):
            curated(picks, out=out, overwrite=True)
    assert (tmp_path / "home" / "letter.txt").read_text() == "dear"
    with pytest.raises(UsageError, match="--out DATASET"):
        Request(sources=(str(picks),)).check_out()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"rule": "dora"}, "has no labels of 'dora', whom --rule names; there are labels of: ann"),
        ({"accept": ("vlm",)}, "has no labels of 'vlm', whom --accept names"),
        ({"accept": ("ann",)}, "--accept ann is no machine"),
        ({"condition": "reward == 0"}, "leaves none of 2 episodes. What there is: reward 1 (2)."),
        ({"condition": "frames < 9 and itc['pose_alignment']"}, "frames 30 (1), 36 (1); itc['pose_alignment'] 1 (2)"),
        ({"condition": "itc['pose_alignement'] == 1"}, "did you mean 'pose_alignment'?"),
        ({"condition": "task == 'T9'"}, "there is no task 'T9'"),
        ({"condition": "rewards == 0"}, "did you mean 'reward'"),
        ({"split": "1,1,1"}, "--split"),
        ({"unseen": ("elegant/T2",)}, "--unseen elegant/T2: no episode has that task; there are: pick the cube"),
        ({"gamma": 1.5}, "--gamma 0.98"),
        ({"codec": "theora"}, "--codec theora is not one of h264, hevc, av1"),
        ({"codec": "hevc", "crf": 52}, "--crf 52 is not in 0 to 51, which hevc takes"),
        ({"crf": 52}, "--crf 52 is not in 0 to 51, which h264 takes"),
        ({"codec": "av1", "crf": 64}, "--crf 64 is not in 0 to 63, which av1 takes"),
        ({"labels": (Path("nowhere"),)}, "--labels nowhere is not a folder"),
        ({"features": Path("nowhere.toml")}, "cannot be read: no such file"),
    ],
)
def test_flags_that_do_not_fit(picks, tmp_path, options, said):
    assert said in refused(JitiError, picks, out=tmp_path / "d", **options)


def test_a_source_is_given_once(picks, tmp_path):
    assert "given twice" in refused(UsageError, picks, picks / ".", out=tmp_path / "d")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "there is no [features.NAME] in it"),
        ("x = 1", "line 1: there is no key 'x'"),
        ("features = 3", "there is no [features.NAME] in it"),
        ("[features", "is not valid TOML"),
        ('[features.a]\nstream = ["/a"]', "line 2: a feature has no key 'stream'; did you mean 'streams'?"),
        ("[features.a]\nstreams = []", "line 2: streams is []; it must be a list of texts"),
        ("[features.a]\n\n", "line 1: the feature 'a' needs one of"),
        ('[features."next.reward"]\nstreams = ["/a"]', "worked out from the labels"),
        ('[features.front]\ncamera = "/camera/front"', "observation.images.NAME"),
    ],
)
def test_a_mapping_that_is_wrong_names_its_line(picks, tmp_path, text, said):
    mapping = tmp_path / "features.toml"
    mapping.write_text(text)
    assert said in refused(UsageError, picks, out=tmp_path / "d", features=mapping)


def test_the_printed_mapping_is_the_automatic_one(tmp_path):
    demos = write_picks(tmp_path / "demos", [GOOD], cameras={"/camera/front/image_raw": Camera(width=64, height=48)})
    mapping = tmp_path / "features.toml"
    mapping.write_text(print_features(Request(sources=(str(demos),))))
    curated(demos, out=tmp_path / "d")
    curated(demos, out=tmp_path / "e", features=mapping)
    for name in ("data/chunk-000/file-000.parquet", "meta/info.json"):
        assert (tmp_path / "d" / name).read_bytes() == (tmp_path / "e" / name).read_bytes()
    assert "observation.images.front" in (tmp_path / "d" / "meta" / "info.json").read_text()
    assert open_reader(tmp_path / "d").open("episode_000000").streams["observation.images.front"].count == 30


def test_recordings_that_the_printed_mapping_does_not_fit_are_told(picks, tmp_path):
    alone = print_features(Request(sources=(str(picks),)))
    assert "differ" not in alone
    small = {"/camera/front": Camera(width=64, height=48)}
    write_picks(tmp_path / "seen", [None, None], cameras=small)
    own_recording(tmp_path / "own", np.zeros((30, 2)), hz=30)
    write_picks(tmp_path / "lame", [None], action_topic=None)
    sources = tuple(str(tmp_path / name) for name in ("demos", "seen", "own", "lame"))
    mixed = print_features(Request(sources=sources))
    assert tomllib.loads(mixed) == tomllib.loads(alone)
    assert [line for line in mixed.splitlines() if line.startswith("#")][1:] == [
        "# Of other recordings the automatic ones differ:",
        "# seen, pick_0.mcap and 1 more: 'observation.images.front' besides, /camera/front (64x48 pixels).",
        "# own, own.mcap: 'observation.state' is /proprio (2 numbers), not /joint_states (7 numbers); "
        "'action' is /action (2 numbers), not /action (7 numbers).",
        "# lame, pick_0.mcap: no stream is called what 'action' is usually called; streams of numbers are: "
        "/joint_states.",
    ]


def test_two_runs_do_not_write_into_one_folder(picks, tmp_path):
    folder = tmp_path / ".d.partial"
    held = Journal.open(folder, "other")
    try:
        with pytest.raises(UsageError, match="another jiti curate writes"):
            curated(picks, out=tmp_path / "d")
    finally:
        held.close()
    assert curated(picks, out=tmp_path / "d").episodes == 2


def test_lost_frames_are_told(tmp_path):
    times = [k / 30 for k in range(30) if k not in (11, 12)]
    camera = Camera(width=64, height=48, times_s=times)
    demos = write_picks(tmp_path / "demos", [GOOD], cameras={"/camera/front": camera})
    (note,) = curated(demos, out=tmp_path / "d").notes
    assert "demos, pick_0.mcap: 1 times the next picture came late" in note
    assert curated(demos, out=tmp_path / "e", fps=30).notes == ()
