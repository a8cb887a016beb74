"""Which GL library renders here, or a message that says what to install."""

import os
import subprocess
import sys

import pytest

from jiti.runtime.sim.gl import BACKENDS, find_graphics

LIBRARIES = ("EGL", "GL", "OpenGL", "OSMesa")


@pytest.fixture
def without_gl(tmp_path, monkeypatch):
    """The environment of a machine without GL libraries: the dynamic loader finds empty files in their place."""
    for name in LIBRARIES:
        for version in ("", ".0", ".1", ".6", ".8"):
            (tmp_path / f"lib{name}.so{version}").touch()
    monkeypatch.setenv("LD_LIBRARY_PATH", str(tmp_path))
    monkeypatch.delenv("MUJOCO_GL", raising=False)


@pytest.mark.sim
def test_without_gl_libraries_the_message_names_the_debian_packages(without_gl):
    graphics = find_graphics()
    assert graphics.backend is None
    assert "recording without pictures" in graphics.message
    assert "egl: its library is not installed" in graphics.message
    assert "osmesa: its library is not installed" in graphics.message
    assert "apt-get install libegl1 libgl1" in graphics.message
    assert "libosmesa6" in graphics.message


@pytest.mark.sim
@pytest.mark.parametrize("wish", ["", *BACKENDS])
def test_a_process_that_began_without_pictures_renders_them_later_whatever_was_wished(monkeypatch, wish):
    monkeypatch.setenv("MUJOCO_GL", wish)
    monkeypatch.delenv("PYOPENGL_PLATFORM", raising=False)  # which rendering in this process leaves behind
    graphics = find_graphics()
    if graphics.backend is None:
        pytest.skip(graphics.message)
    code = (
        "from jiti.runtime.sim.engine import import_robosuite\n"
        "from jiti.runtime.sim.gl import Graphics\n"
        "import_robosuite(Graphics(None, ''))\n"
        f"import_robosuite(Graphics({graphics.backend!r}, ''))\n"
        "import mujoco\n"
        "model = mujoco.MjModel.from_xml_string('<mujoco/>')\n"
        "with mujoco.Renderer(model, 8, 8) as renderer:\n    print(renderer.render().shape)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=120)
    assert done.stdout == "(8, 8, 3)\n", done.stderr


@pytest.mark.sim
def test_without_opencvs_libraries_the_message_names_them(tmp_path):
    # OpenCV comes in two packages that overwrite each other, and only one of them wants libGL.
    (tmp_path / "cv2.py").write_text("raise ImportError('libGL.so.1: cannot open shared object file')\n")
    code = (
        "from jiti.runtime.sim.engine import import_robosuite\n"
        "from jiti.runtime.sim.gl import Graphics\n"
        "from jiti.errors import UsageError\n"
        "try:\n    import_robosuite(Graphics(None, ''))\nexcept UsageError as error:\n    print(error)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
        env=os.environ | {"PYTHONPATH": str(tmp_path)},
    )
    assert "libGL.so.1: cannot open shared object file" in done.stdout
    assert "apt-get install libgl1" in done.stdout


@pytest.mark.parametrize("value", ["off", "disable", "0"])
def test_rendering_can_be_turned_off(monkeypatch, value):
    monkeypatch.setenv("MUJOCO_GL", value)
    graphics = find_graphics()
    assert graphics.backend is None
    assert f"MUJOCO_GL={value}" in graphics.message


@pytest.mark.sim
def test_an_unknown_backend_is_an_answer_and_not_a_crash(monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "vulkan")
    graphics = find_graphics()
    assert graphics.backend is None
    assert "vulkan: RuntimeError" in graphics.message
    assert "Unset MUJOCO_GL" in graphics.message


@pytest.mark.sim
def test_importing_robosuite_says_nothing_and_writes_no_log(tmp_path):
    log = "/tmp/robosuite.log"  # where robosuite 1.4.0 logs to unless told not to
    code = (
        "import builtins, sys\n"
        f"said = lambda event, args: print('OPENED') if event == 'open' and args[0] == {log!r} else None\n"
        "sys.addaudithook(said)\n"
        "from jiti.runtime.sim.engine import import_robosuite\n"
        "from jiti.runtime.sim.gl import Graphics\n"
        "print(import_robosuite(Graphics(None, '')).__version__)\n"
    )
    # Sources compiled anew, as after an installation, so that warnings of the compiler would show.
    environment = os.environ | {"PYTHONPYCACHEPREFIX": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=240, env=environment
    )
    assert (done.stdout, done.stderr) == ("1.4.0\n", "")
