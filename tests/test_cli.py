"""The command line: light to start, help with an example, and one clear message with an exit code for bad input."""

import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import typer

import jiti
from jiti.annotate.segment_file import Recording
from jiti.annotate.segments import Segment, new_segment_id
from jiti.annotate.store import LabelStore
from jiti.cli import app
from tests.builders.curate import write_picks
from tests.builders.demonstration import write_demonstration
from tests.builders.lerobot import H264, write_v3
from tests.builders.mcap import Camera, write_mcap
from tests.builders.scripted_server import scripted


def _commands(of: typer.Typer, prefix: str = "") -> list[str]:
    """Every command as it is typed, those of groups included."""
    found = [f"{prefix}{c.name or c.callback.__name__}" for c in of.registered_commands if c.callback]
    for group in of.registered_groups:
        found += [f"{prefix}{group.name}", *_commands(group.typer_instance, f"{prefix}{group.name} ")]  # type: ignore[arg-type]
    return sorted(found)


COMMANDS = _commands(app)

Run = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Run:
    """`jiti ARGS` in a process of its own, in the test's folder, with caches and settings of its own."""
    for variable in ("XDG_CACHE_HOME", "XDG_CONFIG_HOME"):
        monkeypatch.setenv(variable, str(tmp_path / ".home"))
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    monkeypatch.setenv("COLUMNS", "200")

    def run(*args: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "jiti", *args]
        return subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False)

    return run


def refused(done: subprocess.CompletedProcess[str], *said: str) -> None:
    """One message on standard error, no traceback, exit code 1."""
    assert done.returncode == 1, done
    assert done.stderr.startswith("jiti: ")
    assert "Traceback" not in done.stderr
    for text in said:
        assert text in done.stderr


def problems(done: subprocess.CompletedProcess[str]) -> str:
    """Everything that `jiti inspect --json` found wrong. It fails only when nothing could be opened."""
    report = json.loads(done.stdout)
    assert done.returncode == (not any(e["clock_reference"] or e["rate_hz"] for e in report["episodes"])), done
    return json.dumps([report["problems"], [e["problems"] for e in report["episodes"]]])


def test_the_command_line_loads_nothing_heavy() -> None:
    heavy = "torch mujoco rerun lerobot robosuite cv2 numpy pyarrow av starlette uvicorn rich.console"
    code = f"import sys, jiti.cli; print([m for m in {heavy.split()} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_help_with_an_example_and_is_in_the_readme(run: Run, command: str) -> None:
    done = run(*command.split(), "--help")
    assert done.returncode == 0
    assert f"Example: jiti {command}" in done.stdout
    assert f"jiti {command}" in (Path(__file__).parents[1] / "README.md").read_text()


def test_a_truncated_recording_opens_with_what_is_missing(run: Run, tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "episode.mcap", duration_s=4, chunk_size=20_000).path
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    found = problems(run("inspect", "episode.mcap", "--json"))
    assert "episode.mcap" in found
    assert "cut" in found or "ends" in found
    frames = json.loads(run("inspect", "episode.mcap", "--json").stdout)["episodes"][0]["frame_count"]
    assert 20 < frames < 120


def test_a_corrupt_chunk_is_named_with_what_it_held(run: Run, tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "episode.mcap", duration_s=4, chunk_size=20_000, compression="none").path
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(data)
    found = problems(run("inspect", "episode.mcap", "--json"))
    assert "chunk" in found
    assert "CRC" in found


def test_an_unknown_encoding_is_listed_with_what_is_supported(run: Run, tmp_path: Path) -> None:
    from tests.builders.mcap import Channel, Message, write_messages

    channels = {"/odd": Channel(None, "flatbuffer")}
    write_messages(tmp_path / "episode.mcap", channels, [Message("/odd", k * 10**8, b"\0" * 8) for k in range(30)])
    done = run("inspect", "episode.mcap", "--json")
    text = done.stdout + done.stderr
    assert "flatbuffer" in text
    assert "protobuf" in text.lower()


def test_pictures_that_do_not_decode_are_counted(run: Run, tmp_path: Path) -> None:
    from tests.builders import mcap_messages
    from tests.builders.mcap import Channel, Message, write_messages

    made = [mcap_messages.picture("protobuf", "jpeg", 320, 240, k, b"no picture") for k in range(3)]
    channels = {"/camera": Channel(made[0][0], made[0][0].message_encoding)}
    write_messages(
        tmp_path / "episode.mcap", channels, [Message("/camera", k * 10**8, m[1]) for k, m in enumerate(made)]
    )
    done = run("inspect", "episode.mcap", "--json")
    assert "/camera" in done.stdout + done.stderr
    assert "jpeg" in (done.stdout + done.stderr).lower()


def test_without_a_camera_frames_run_at_a_fixed_rate(run: Run, tmp_path: Path) -> None:
    write_mcap(tmp_path / "episode.mcap", cameras={}, duration_s=2)
    episode = json.loads(run("inspect", "episode.mcap", "--json").stdout)["episodes"][0]
    assert episode["clock_reference"] is None
    assert episode["rate_hz"] == pytest.approx(30)
    assert abs(episode["frame_count"] - 60) <= 1


def test_a_clock_that_jumps_back_is_named(run: Run, tmp_path: Path) -> None:
    times = [k / 30 for k in range(60)] + [k / 30 - 3 for k in range(60, 120)]
    from tests.builders import mcap_messages
    from tests.builders.encode import encode_numbered
    from tests.builders.mcap import START_NS, Channel, Message, write_messages

    pictures = encode_numbered(range(120), "jpeg", 64, 48)
    stamps = [START_NS + round(t * 1e9) for t in times]
    made = [
        mcap_messages.picture("protobuf", "jpeg", 64, 48, stamp, data)
        for stamp, data in zip(stamps, pictures, strict=True)
    ]
    channels = {"/camera": Channel(made[0][0], made[0][0].message_encoding)}
    messages = [Message("/camera", stamp, m[1]) for stamp, m in zip(stamps, made, strict=True)]
    write_messages(tmp_path / "episode.mcap", channels, messages)
    done = run("inspect", "episode.mcap", "--json")
    assert "/camera" in problems(done)
    assert "back" in problems(done)
    assert json.loads(done.stdout)["episodes"][0]["frame_count"] == 120


@pytest.mark.parametrize("args", [["annotate"], ["validate-rewards", "--check"]], ids=lambda args: args[0])
@pytest.mark.parametrize(("content", "said"), [(b"", "empty"), (b"hello, this is a text\n" * 20, "MCAP")])
def test_a_file_that_is_no_recording_is_refused(
    run: Run, tmp_path: Path, args: list[str], content: bytes, said: str
) -> None:
    (tmp_path / "episode.mcap").write_bytes(content)
    refused(run(*args, "episode.mcap"), "episode.mcap", said)
    assert said in problems(run("inspect", "episode.mcap", "--json"))


def test_a_folder_of_good_and_bad_files_opens_the_good_ones(run: Run, tmp_path: Path) -> None:
    write_mcap(tmp_path / "good.mcap", duration_s=1)
    (tmp_path / "bad.mcap").write_bytes(b"no")
    done = run("inspect", "--json")
    assert "bad.mcap" in problems(done)
    rows = {e["title"]: e["frame_count"] for e in json.loads(done.stdout)["episodes"]}
    assert rows["good.mcap"] == 30


def test_a_folder_without_recordings_says_what_it_looked_for(run: Run) -> None:
    refused(run("annotate"), "MCAP", "LeRobot")
    refused(run("annotate", "nowhere"), "nowhere")


def test_a_missing_lerobot_video_is_named_and_the_rest_opens(run: Run, tmp_path: Path) -> None:
    root = write_v3(tmp_path / "dataset", (10, 10), encoder=H264)
    shutil.rmtree(root / "videos")
    found = problems(run("inspect", "dataset", "--json"))
    assert "videos/" in found
    assert ".mp4" in found


def label(folder: Path) -> Path:
    """Segments of `episode` by `ada`; gives the Parquet file."""
    partition = LabelStore(folder / "labels").partition("ada", "episode", Recording(30, 30.0, "x"))
    row = Segment(new_segment_id(), "episode", "generic/pose_alignment", "pose_alignment", 2, 20, 2, 20, 1)
    partition.apply("mark", [row], based_on=0)
    return folder / "labels" / "segments" / "annotator=ada" / "episode.parquet"


def test_labels_of_a_newer_version_are_refused_and_kept(run: Run, tmp_path: Path) -> None:
    write_mcap(tmp_path / "episode.mcap", duration_s=1)
    path = label(tmp_path)
    table = pq.read_table(path, partitioning=None)
    about = json.loads(table.schema.metadata[b"jiti"])
    about["schema_version"] = 99
    pq.write_table(pa.table(table).replace_schema_metadata({b"jiti": json.dumps(about).encode()}), path)
    before = path.read_bytes()
    refused(run("validate-rewards", "--check"), "episode.parquet", "99", "pip install")
    refused(run("validate-rewards", "--write"), "episode.parquet", "99", "pip install")
    assert path.read_bytes() == before


def test_the_version_is_printed(run: Run) -> None:
    assert run("--version").stdout == f"jiti {jiti.__version__}\n"


def test_the_check_fails_a_script_when_labels_are_wrong(run: Run, tmp_path: Path) -> None:
    write_mcap(tmp_path / "episode.mcap", duration_s=0.5)
    label(tmp_path)
    done = run("validate-rewards", "--check", "--json")
    assert done.returncode == 1
    kinds = {s["kind"] for s in json.loads(done.stdout)["suspects"]}
    assert "outside_episode" in kinds


def test_rewards_are_written_for_learning(run: Run, tmp_path: Path) -> None:
    write_mcap(tmp_path / "episode.mcap", duration_s=1)
    label(tmp_path)
    assert "rewards.parquet" in run("validate-rewards", "--write", "--gamma", "0.5").stdout
    rows = pq.read_table(tmp_path / "labels" / "rewards.parquet").to_pylist()
    assert [row["frame_index"] for row in rows if row["reward"] == 1] == list(range(2, 21))
    assert rows[20]["mc_return"] == 1.0
    assert rows[19]["mc_return"] == 1.5


@pytest.mark.parametrize(
    ("args", "said"),
    [
        (["annotate", "--annotator", "a/b"], "--annotator"),
        (["annotate", "--tasks", "nothing.toml"], "nothing.toml"),
        (["validate-rewards", "--json"], "--check"),
        (["validate-rewards", "--check", "--write"], "one of them"),
        (["validate-rewards", "--check", "--labels", "typo"], "--labels typo"),
        (["annotate", "--labels", "episode.mcap"], "--labels episode.mcap"),
        (["validate-rewards", "--agreement", "ada", "ben"], "no labels"),
        (["annotate", "someone/dataset"], "someone/dataset"),
    ],
)
def test_flags_that_do_not_fit_name_themselves(run: Run, tmp_path: Path, args: list[str], said: str) -> None:
    write_mcap(tmp_path / "episode.mcap", cameras={"/camera": Camera(width=64, height=48)}, duration_s=0.2)
    refused(run(*args), said)


def test_a_port_in_use_is_refused(run: Run, tmp_path: Path) -> None:
    from jiti.annotate.web.serve import bind

    write_mcap(tmp_path / "episode.mcap", cameras={"/camera": Camera(width=64, height=48)}, duration_s=0.2)
    with bind(0) as taken:
        refused(run("annotate", "--port", str(taken.getsockname()[1])), "--port")


def test_recording_on_an_arm_asks_for_what_fits_together(run: Run, tmp_path: Path) -> None:
    arm = ("record", "--robot", "so100", "--task", "so100/T5")
    refused(run(*arm), "which port? Pass --port /dev/ttyACM0")
    for option in (
        ("--cameras", "front"),
        ("--workers", "2"),
        ("--assets", "libero"),
        ("--start", "file"),
        ("--disturbance", "0.3"),
    ):
        refused(run(*arm, "--port", "virtual", *option), f"{option[0]}: for simulation")
    refused(run(*arm, "--port", "/dev/ttyNONE", "--quality", "0.5"), "--quality is for the hand that demonstrates")
    refused(run(*arm, "--port", "/dev/ttyNONE", "--leader", "virtual"), "pass --port virtual")
    refused(run(*arm, "--port", "/dev/ttyNONE", "--leader", "/dev/ttyNONE"), "leader and follower are both at")
    other = run("record", "--robot", "so100", "--port", "virtual", "--task", "so100/T4")
    refused(other, "no one demonstrates so100/T4 on a virtual arm; the hand there knows: so100/T5")
    refused(run("record", "--task", "T2", "--leader", "/dev/ttyACM1"), "--leader: for an arm; pass --robot so100")
    refused(run("record", "--robot", "so100", "--port", "virtual", "--task", "so100/T55"), "did you mean so100/T5")
    assert not list(tmp_path.glob("jiti-*"))


def test_a_task_that_cannot_be_simulated_is_answered_with_those_that_can(run: Run, tmp_path: Path) -> None:
    refused(run("record", "--task", "T9", "--out", "demos"), "no task of simulation is 'T9'", "elegant/T0")
    refused(run("record", "--task", "so100/T0"), "no task of simulation is 'so100/T0'")
    refused(run("record", "--task", "ketchupp"), "did you mean ketchup")
    refused(run("record", "--task", "T2", "--cameras", "side"), "there is no camera 'side'; there are: front, wrist")
    refused(run("record", "--task", "T2", "--assets", str(tmp_path)), "is no asset pack", "jiti tasks check")
    assert list(tmp_path.glob("*demos*")) == []


def test_proposals_are_written_from_what_a_recording_has(run: Run, tmp_path: Path) -> None:
    write_mcap(tmp_path / "a.mcap", cameras={"front": Camera()})
    refused(run("autolabel", "--from", "sim"), "nothing was proposed", "has no stream '/predicates'", "--from signal")
    done = run("autolabel", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["source"] == "signal"


def test_without_a_model_it_says_which_to_start(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_mcap(tmp_path / "a.mcap", cameras={"front": Camera()})
    # A port that no one listens on, in case a model runs at the usual one here.
    monkeypatch.setenv("JITI_VLM_URL", "http://127.0.0.1:9/v1")
    refused(run("autolabel", "--vlm"), "no model server answers", "vllm serve nvidia/Cosmos-Reason2-2B", "--vlm-model")
    told = run("autolabel", "--vlm", "--dry-run", "--json", "--prices", "1", "2")
    assert told.returncode == 0, told.stderr
    assert json.loads(told.stdout)["requests"] == 16


def test_a_model_is_asked_through_a_server(run: Run, tmp_path: Path) -> None:
    write_demonstration(tmp_path / "a.mcap", poses=False, steps=30)
    with scripted() as server:
        done = run("autolabel", "--vlm", "--vlm-url", server.url, "--samples", "2")
    assert done.returncode == 0, done.stderr
    assert "1 proposals from vlm for 1 episodes, 1 satisfied and 0 violated." in done.stdout
    assert "3 requests" in done.stdout
    refused(run("autolabel", "--vlm", "--evaluate", "ada"), "'ada' has no labels", "There are: vlm")


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        (("--vlm", "--from", "sim"), "pass one of them"),
        (("--stage", "verdicts"), "add --vlm"),
        (("--libero",), "--libero is of --vlm --stage itcs"),
        (("--calibrate",), "--calibrate is of --evaluate"),
        (("--dry-run",), "--dry-run is of --vlm"),
        (("--vlm", "--vlm-model", "some-model"), "neither a folder nor a Hub id"),
        (("--vlm", "--vlm-url", "localhost"), "is no address"),
    ],
)
def test_flags_of_autolabel_that_do_not_fit_name_themselves(run: Run, tmp_path: Path, flags, said) -> None:
    write_mcap(tmp_path / "a.mcap", cameras={"front": Camera()})
    refused(run("autolabel", *flags), said)


def test_a_dataset_is_curated_in_one_command(run: Run, tmp_path: Path) -> None:
    write_picks(tmp_path / "demos", [[(5, 14, 1)], [(5, 14, 0)], None])
    done = run("curate", "demos", "--out", "d", "--weights", "--report", "--filter", "frames > 1")
    assert done.returncode == 0, done
    assert "2 episodes, 66 frames at 30 Hz in d." in done.stdout
    assert "1 of 2 judged episodes are elegant" in done.stdout
    assert "Left out: 1 episodes without labels" in done.stdout
    for name in ("sarm_progress.parquet", "meta/jiti/report.html", "meta/info.json", "README.md"):
        assert (tmp_path / "d" / name).is_file(), name
    told = json.loads(run("curate", "demos", "--out", "e", "--json").stdout)
    assert (told["episodes"], told["frames"], told["unlabelled"], told["weights"]) == (2, 66, 1, None)
    assert json.loads(run("inspect", "e", "--json").stdout)["episodes"][1]["frame_count"] == 36


def test_labels_of_changed_recordings_are_confirmed(run: Run, tmp_path: Path) -> None:
    demos = write_picks(tmp_path / "demos", [[(5, 14, 1)]])
    write_picks(demos, [None], instruction="pick the red cube")
    refused(run("curate", "demos", "--out", "d"), "`jiti validate-rewards demos --confirm`")
    assert "Confirmed the labels of 1 episodes" in run("validate-rewards", "demos", "--confirm").stdout
    assert run("curate", "demos", "--out", "d").returncode == 0


def test_the_current_folder_is_curated_and_the_mapping_printed(run: Run, tmp_path: Path) -> None:
    write_picks(tmp_path, [[(5, 14, 1)]])
    done = run("curate", "--print-features")
    assert done.stdout.endswith('[features."action"]\nstreams = ["/action"]\n')
    done = run("curate", "--out", "d")
    assert done.returncode == 0, done
    assert (tmp_path / "d" / "meta" / "info.json").is_file()


def test_what_cannot_be_curated_is_refused(run: Run, tmp_path: Path) -> None:
    write_picks(tmp_path / "demos", [None])
    refused(run("curate", "demos", "--out", "d"), "jiti annotate demos", "--unlabelled keep")
    refused(run("curate", "demos"), "--out DATASET")
    refused(run("curate", "--report", "demos"), "is no dataset of jiti curate")
    refused(run("curate", "--report"), "jiti curate --report DATASET")
    assert not (tmp_path / "d").exists()
