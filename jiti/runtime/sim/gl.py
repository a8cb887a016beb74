"""Which GL library MuJoCo renders with: found out in a process of its own, because a bad one ends the process."""

import importlib
import os
import subprocess
import sys
from dataclasses import dataclass
from typing import Any

BACKENDS = ("egl", "osmesa")
"""In this order: egl uses a graphics card where there is one, osmesa is always software."""

OFF = frozenset({"disable", "disabled", "off", "false", "0"})
"""Values of MUJOCO_GL that MuJoCo takes for no rendering at all."""

PACKAGES = {"egl": "libegl1 libgl1 libgles2", "osmesa": "libosmesa6"}
"""The Debian packages that each backend needs."""

PROBE_TIMEOUT_S = 120
"""Our choice: a cold import of MuJoCo takes 10 s on a slow disk."""

_PROBE = """
import mujoco
model = mujoco.MjModel.from_xml_string('<mujoco><worldbody><light/><geom size="1"/></worldbody></mujoco>')
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
with mujoco.Renderer(model, 8, 8) as renderer:
    renderer.update_scene(data)
    assert renderer.render().any(), "the picture is black"
"""


@dataclass(frozen=True, slots=True)
class Graphics:
    """What MuJoCo can render with here."""

    backend: str | None
    """Value for MUJOCO_GL; None when there are no pictures."""
    message: str
    """For a person: what is used, or why nothing is and which packages give pictures."""


def find_graphics() -> Graphics:
    """The first backend that renders a picture. An explicit MUJOCO_GL is the only one tried."""
    wish = os.environ.get("MUJOCO_GL", "").lower().strip()
    if wish in OFF:
        return Graphics(None, f"MUJOCO_GL={wish}: recording without pictures. Unset it to render.")
    backends = (wish,) if wish else BACKENDS
    failures = []
    for backend in backends:
        failure = _failure(backend)
        if failure is None:
            return Graphics(backend, f"rendering with MUJOCO_GL={backend}")
        failures.append(f"{backend}: {failure}")
    packages = " or ".join(f"`apt-get install {PACKAGES[b]}` ({b})" for b in backends if b in PACKAGES)
    remedy = f"On Debian, {packages} gives pictures." if packages else "Unset MUJOCO_GL to try egl, then osmesa."
    return Graphics(None, f"no GL library renders here ({'; '.join(failures)}): recording without pictures. {remedy}")


def use(backend: str) -> None:
    """Let MuJoCo render with this library from now on; it chooses one when it is imported, and here anew."""
    wished = os.environ.get("MUJOCO_GL") == backend
    os.environ["MUJOCO_GL"] = backend
    if "mujoco" in sys.modules:
        renderer: Any = sys.modules[sys.modules["mujoco"].Renderer.__module__]
        # MuJoCo may have been imported to render nothing, whatever the user's MUJOCO_GL says.
        if not (wished and hasattr(renderer.gl_context, "GLContext")):
            importlib.reload(renderer.gl_context)


def _failure(backend: str) -> str | None:
    """Last line of what went wrong; None when a picture came out."""
    # PyOpenGL takes one platform a process; an inherited one would decide for the backend.
    environment = {k: v for k, v in os.environ.items() if k != "PYOPENGL_PLATFORM"} | {"MUJOCO_GL": backend}
    try:
        done = subprocess.run(
            [sys.executable, "-c", _PROBE],
            env=environment,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=PROBE_TIMEOUT_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return f"no picture after {PROBE_TIMEOUT_S} s"
    if done.returncode == 0:
        return None
    lines = [line.strip() for line in done.stderr.splitlines() if line.strip()]
    # PyOpenGL's destructors complain after the first error; the error itself ends the first traceback.
    errors = [line for line in lines if line.split(":")[0].split(".")[-1].endswith(("Error", "Exception"))]
    first = (errors or lines or [f"ended with {done.returncode}"])[0]
    # PyOpenGL puts None where the dynamic loader found no library, and trips over it later.
    return "its library is not installed" if "'NoneType' object has no attribute" in first else first
