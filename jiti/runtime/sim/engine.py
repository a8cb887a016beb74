"""robosuite, imported so that a user hears nothing of it.

robosuite 1.4.0 warns on import of a settings file that no one needs, opens a log in `/tmp` that another user of the
machine may own, and forces MUJOCO_GL to egl. All three are switches in its `macros` module, which it reads while it is
imported and which cannot be imported before it in the ordinary way. So that module is loaded from its file, set, and
put where robosuite looks for it. Nothing of robosuite's code is replaced.
"""

import importlib
import importlib.util
import logging
import os
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType

import numpy as np

from jiti.errors import UsageError
from jiti.runtime.sim.gl import Graphics, use

_GL = "MUJOCO_GL"
"""The environment variable that MuJoCo and robosuite take their GL library from."""


def import_robosuite(graphics: Graphics) -> ModuleType:
    """robosuite, set to render with `graphics`. Raises UsageError when it or a library it needs is not installed.

    A process that began without pictures may ask for them later.
    """
    if "robosuite" in sys.modules:
        if graphics.backend:
            use(graphics.backend)
        return sys.modules["robosuite"]
    _set_macros(find_robosuite() / "macros.py")
    # Without a handler of its own, Python would print what robosuite logs.
    logging.getLogger("robosuite_logs").addHandler(logging.NullHandler())
    wish = os.environ.get(_GL)
    os.environ[_GL] = graphics.backend or "disable"
    try:
        with warnings.catch_warnings():
            # Its sources have escapes in strings that Python 3.12 warns of when it compiles them.
            warnings.simplefilter("ignore")
            return importlib.import_module("robosuite")
    except ImportError as error:
        raise UsageError(
            f"robosuite cannot be imported: {error}. On Debian, `apt-get install libgl1 libegl1 libglib2.0-0` installs "
            "the libraries that it and OpenCV need; `pip install 'jiti[sim]'` the Python packages."
        ) from error
    finally:
        if graphics.backend is None:
            os.environ.pop(_GL)
            os.environ.update({} if wish is None else {_GL: wish})


def find_robosuite() -> Path:
    """Its folder, without importing it. Raises UsageError when it or MuJoCo is not installed."""
    for package in ("mujoco", "robosuite"):
        spec = importlib.util.find_spec(package)
        if spec is None or spec.origin is None:
            raise UsageError(f"{package}, which simulates the robot, is not installed. Run: pip install 'jiti[sim]'")
    return Path(spec.origin).parent


def _set_macros(file: Path) -> None:
    spec = importlib.util.spec_from_file_location("robosuite.macros", file)
    if spec is None or spec.loader is None:
        raise UsageError(
            f"robosuite is damaged: {file} cannot be read. Run: pip install --force-reinstall robosuite==1.4.0"
        )
    macros = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(macros)
    vars(macros).update(CONSOLE_LOGGING_LEVEL=None, FILE_LOGGING_LEVEL=None, MUJOCO_GPU_RENDERING=False)
    sys.modules["robosuite.macros"] = macros
    sys.modules["robosuite.macros_private"] = macros


@contextmanager
def global_seed(seed: int) -> Iterator[None]:
    """Seed numpy's global generator, from which robosuite draws, and put it back as it was."""
    before = np.random.get_state()
    np.random.seed(seed)
    try:
        yield
    finally:
        np.random.set_state(before)
