"""LIBERO imported in a bare place: no config, no home, no network, no standard input, and no word of its own."""

import io
import os
import pickle
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from jiti import __version__
from jiti.errors import UsageError
from jiti.runtime.sim import libero
from jiti.runtime.sim.libero import (
    PRIMITIVE,
    _ArraysOnly,
    bddl_file,
    bddl_fingerprint,
    import_libero,
    initial_states,
    pack_fingerprint,
    pack_folder,
)
from jiti.tasks.catalogue import load_catalogue

SIMULATED = [task for task in load_catalogue() if task.bddl]

BARE = """
import socket, sys

def refuse(*_):
    raise OSError("no network here")

socket.socket.connect = refuse
socket.getaddrinfo = refuse
from jiti.runtime.sim.scene import Scene
from jiti.tasks.catalogue import load_catalogue
with Scene(load_catalogue().task("elegant/T2")) as scene:
    scene.reset(0)
    print(scene.succeeded())
"""


@pytest.mark.sim
def test_a_scene_is_built_with_nothing_at_hand(tmp_path: Path) -> None:
    """The primitive pack needs no download; without GL libraries, a home folder, a network or standard input."""
    for name in ("EGL", "GL", "OpenGL", "OSMesa"):
        for version in ("", ".0", ".1", ".6", ".8"):
            (tmp_path / f"lib{name}.so{version}").touch()
    home = tmp_path / "home"
    home.mkdir()
    environment = {k: v for k, v in os.environ.items() if k not in ("LIBERO_CONFIG_PATH", "MUJOCO_GL")}
    done = subprocess.run(
        [sys.executable, "-c", BARE],
        env=environment | {"HOME": str(home), "LD_LIBRARY_PATH": str(tmp_path), "TMPDIR": str(tmp_path)},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "False\n", "")
    assert not (home / ".libero").exists()
    assert not list(tmp_path.glob("jiti-libero-*"))


@pytest.mark.sim
def test_the_downloaded_pack_says_what_to_do_when_there_is_no_network(tmp_path: Path) -> None:
    code = "from jiti.runtime.sim.libero import import_libero\nimport_libero('libero')\n"
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | {"HOME": str(tmp_path), "HF_HOME": str(tmp_path), "HF_HUB_OFFLINE": "1"},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )
    assert done.returncode == 1
    assert "give a folder with --assets DIR, or take the pack that needs no download: --assets primitive" in done.stderr
    assert done.stdout == ""


@pytest.mark.sim
@pytest.mark.parametrize("task", SIMULATED, ids=lambda task: task.task_id)
def test_every_task_has_its_problem_and_its_initial_states(task) -> None:
    assert bddl_file(task.bddl).is_file()
    states = initial_states(task.bddl)
    assert states.shape[0] == 50
    assert np.isfinite(states).all()


def test_a_file_of_initial_states_can_run_nothing(tmp_path: Path) -> None:
    class Evil:
        def __reduce__(self):
            return (os.system, ("true",))

    with pytest.raises(pickle.UnpicklingError, match="has no place in a file of initial states"):
        _ArraysOnly(io.BytesIO(pickle.dumps(Evil()))).load()


@pytest.mark.sim
def test_the_arrays_are_those_that_torch_reads() -> None:
    torch = pytest.importorskip("torch")
    name = SIMULATED[0].bddl
    path = bddl_file(name).parents[2] / "init_files" / f"{name}.pruned_init"
    assert zipfile.is_zipfile(path)
    expected = torch.load(path, weights_only=False)  # a file of the installed wheel
    np.testing.assert_array_equal(initial_states(name), np.asarray(expected))


def test_a_folder_that_is_no_pack_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"is no asset pack: it has no folder 'scenes'.*jiti tasks check"):
        pack_folder(tmp_path)
    assert pack_folder(None) == pack_folder("primitive") == PRIMITIVE


def test_without_libero_the_message_says_what_to_install(monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "libero", None)
    with pytest.raises(UsageError, match=r"hf-libero.* pip install 'jiti\[sim\]'"):
        bddl_file("libero_goal/put_the_bowl_on_the_plate")


@pytest.mark.sim
def test_a_users_own_configuration_is_left_alone(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setenv("LIBERO_CONFIG_PATH", str(tmp_path))
    (tmp_path / "config.yaml").write_text("assets: /nowhere\n")
    import_libero()
    assert os.environ["LIBERO_CONFIG_PATH"] == str(tmp_path)
    assert (tmp_path / "config.yaml").read_text() == "assets: /nowhere\n"


def test_a_pack_is_known_by_its_files_and_not_by_its_place(tmp_path: Path) -> None:
    packs = [tmp_path / place / "assets" for place in ("a", "b", "c")]
    for pack, size in zip(packs, (3, 3, 4), strict=True):
        (pack / "scenes").mkdir(parents=True)
        (pack / "scenes" / "table.xml").write_bytes(b"x" * size)
    first, same, other = (pack_fingerprint(pack) for pack in packs)
    assert first == same != other
    assert first.startswith("assets/ ")
    (packs[0] / "scenes" / "table.xml").rename(packs[0] / "scenes" / "desk.xml")
    assert pack_fingerprint(packs[0]) != first
    assert pack_fingerprint(None) == pack_fingerprint("primitive") == f"primitive {__version__}"
    with pytest.raises(UsageError, match="is no asset pack"):
        pack_fingerprint(tmp_path)


def test_a_problem_is_known_by_its_name_and_content(tmp_path: Path, monkeypatch) -> None:
    known = bddl_fingerprint("libero_goal/put_the_bowl_on_the_plate")
    assert known.startswith("libero_goal/put_the_bowl_on_the_plate ")
    assert known != bddl_fingerprint("libero_goal/push_the_plate_to_the_front_of_the_stove")
    (tmp_path / "other.bddl").write_text("(define (problem other))")
    monkeypatch.setattr(libero, "bddl_file", lambda _name: tmp_path / "other.bddl")
    assert bddl_fingerprint.__wrapped__("libero_goal/put_the_bowl_on_the_plate") != known
