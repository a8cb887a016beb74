"""LIBERO, imported so that it asks nothing, needs no `~/.libero` and downloads nothing by itself.

hf-libero 0.1.4 asks on standard input where to keep datasets unless `$LIBERO_CONFIG_PATH/config.yaml` is there when it
is imported, and looks for its assets on the Hub when it builds the first object. So a folder with that file is made for
the time of this process, and the asset pack is named before anything is built.
"""

import contextlib
import hashlib
import importlib
import importlib.util
import io
import os
import pickle
import re
import shutil
import sys
import tempfile
import warnings
import zipfile
from functools import cache
from importlib.metadata import version
from multiprocessing.util import Finalize
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from jiti import __version__
from jiti.errors import UsageError
from jiti.runtime.sim.engine import import_robosuite
from jiti.runtime.sim.gl import Graphics

PRIMITIVE = Path(__file__).with_name("packs") / "primitive"
"""The asset pack that comes with jiti: boxes, cylinders and capsules."""
DOWNLOADED = "libero"
"""Name of the full asset pack, which hf-libero downloads from the Hub at its first use."""
CONFIG = "LIBERO_CONFIG_PATH"


def import_libero(assets: Path | str | None = None, graphics: Graphics | None = None) -> ModuleType:
    """`libero.libero.envs`, set to take objects and arenas from an asset pack.

    `assets` is a folder in LIBERO's layout, "primitive" (the default) or "libero". The pack may change between scenes:
    what was built before keeps its own. Raises UsageError when something is not installed or the pack is not there.
    """
    import_robosuite(graphics or Graphics(None, "no pictures are needed"))
    package = _package_folder()
    if not (Path(os.environ.get(CONFIG) or Path.home() / ".libero") / "config.yaml").is_file():
        _write_config(package)
    pack = pack_folder(assets)
    try:
        with warnings.catch_warnings():
            # Its sources have escapes in strings that Python 3.12 warns of when it compiles them.
            warnings.simplefilter("ignore")
            root: Any = importlib.import_module("libero.libero")
            root._assets_path_cache = str(pack) if pack else None
            envs = importlib.import_module("libero.libero.envs")
    except (ImportError, EOFError) as error:
        raise UsageError(f"hf-libero cannot be imported: {error}. Run: pip install 'jiti[sim]'") from error
    if pack is None:
        root._assets_path_cache = str(_download(root))
    return envs


def pack_folder(assets: Path | str | None) -> Path | None:
    """Folder of an asset pack; None for the one that is downloaded. Raises UsageError when it is no pack."""
    if assets == DOWNLOADED:
        return None
    folder = PRIMITIVE if assets in (None, "primitive") else Path(str(assets)).expanduser().resolve()
    if not (folder / "scenes").is_dir():
        raise UsageError(
            f"{folder} is no asset pack: it has no folder 'scenes'. Give --assets a folder in LIBERO's layout, "
            "'primitive' or 'libero'; `jiti tasks check --assets DIR` says what a pack lacks."
        )
    return folder


def pack_name(assets: Path | str | None) -> str:
    """Of an asset pack; of a folder its own name, so that no path of this machine gets into a recording."""
    folder = pack_folder(assets)
    return "libero" if folder is None else "primitive" if folder == PRIMITIVE else f"{folder.name}/"


def pack_fingerprint(assets: Path | str | None) -> str:
    """An asset pack by what is in it: a folder by its name and the names and sizes of its files, wherever it lies; one
    that is installed by name and version. Raises UsageError when it is no pack."""
    folder = pack_folder(assets)
    if folder is None:
        return f"{DOWNLOADED} {version('hf-libero')}"
    if folder == PRIMITIVE:
        return f"{pack_name(assets)} {__version__}"
    digest = hashlib.sha256()
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        digest.update(f"{path.relative_to(folder).as_posix()}\0{path.stat().st_size}\0".encode())
    return f"{folder.name}/ {digest.hexdigest()[:16]}"


def bddl_file(name: str) -> Path:
    """LIBERO's problem file of a task, by `suite/name`. Raises UsageError when it is not installed."""
    return _shipped("bddl_files", f"{name}.bddl")


@cache
def bddl_fingerprint(name: str) -> str:
    """A problem file by its name and content. Raises UsageError when it is not installed."""
    return f"{name} {hashlib.sha256(bddl_file(name).read_bytes()).hexdigest()[:16]}"


def instructions() -> list[tuple[str, str]]:
    """`suite/name` and instruction of every task of LIBERO, by name. Raises UsageError when it is not installed."""
    folder = _package_folder() / "bddl_files"
    found = []
    for path in sorted(folder.glob("libero_*/*.bddl")):
        said = re.search(r"\(:language\s+([^)]*)\)", path.read_text(encoding="utf-8"))
        if said:
            found.append((f"{path.parent.name}/{path.stem}", " ".join(said[1].split())))
    return found


def has_initial_states(name: str) -> bool:
    """Whether LIBERO comes with initial states of a task."""
    return (_package_folder() / "init_files" / f"{name}.pruned_init").is_file()


def initial_states(name: str) -> np.ndarray:
    """LIBERO's own initial states of a task (N, 1 + nq + nv), float64: time, qpos, qvel.

    The files are pickles inside a zip; only arrays are let out of them, and only files of the installed wheel are read.
    """
    path = _shipped("init_files", f"{name}.pruned_init")
    with zipfile.ZipFile(path) as archive:
        data = archive.read(next(n for n in archive.namelist() if n.endswith("/data.pkl")))
    return np.asarray(_ArraysOnly(io.BytesIO(data)).load(), dtype=np.float64)


class _ArraysOnly(pickle.Unpickler):
    """Refuses everything but what an array of numbers is made of."""

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) == ("numpy.core.multiarray", "_reconstruct"):
            return np._core.multiarray._reconstruct  # type: ignore[attr-defined]
        if (module, name) in {("numpy", "ndarray"), ("numpy", "dtype"), ("_codecs", "encode")}:
            return super().find_class(module, name)
        raise pickle.UnpicklingError(f"{module}.{name} has no place in a file of initial states")


def _shipped(kind: str, name: str) -> Path:
    path = _package_folder() / kind / name
    if not path.is_file():
        raise UsageError(
            f"{path} is not there: hf-libero is damaged or of another version. Run: pip install 'jiti[sim]'"
        )
    return path


def _package_folder() -> Path:
    spec = importlib.util.find_spec("libero")
    if spec is None or spec.origin is None:
        raise UsageError("hf-libero, which has LIBERO's tasks, is not installed. Run: pip install 'jiti[sim]'")
    return Path(spec.origin).parent / "libero"


def _write_config(package: Path) -> None:
    folder = Path(tempfile.mkdtemp(prefix="jiti-libero-"))
    names = {"bddl_files": "bddl_files", "init_states": "init_files", "assets": "assets", "datasets": "datasets"}
    lines = [f"benchmark_root: {package}", *(f"{key}: {package / name}" for key, name in names.items())]
    (folder / "config.yaml").write_text("\n".join(lines) + "\n")
    os.environ[CONFIG] = str(folder)
    # Unlike what is registered with atexit, this is called in processes of a pool too, and not in those that fork.
    Finalize(None, shutil.rmtree, args=(folder,), kwargs={"ignore_errors": True}, exitpriority=0)


def _download(root: Any) -> Path:
    """The full pack: a local copy, or the Hub's. Raises UsageError when neither can be had."""
    with contextlib.redirect_stdout(sys.stderr):  # where it tells of its download
        path = Path(root.get_assets_path())
    if not (path / "scenes").is_dir():
        raise UsageError(
            "LIBERO's own assets are not on this machine and could not be downloaded from the Hub. Connect to the "
            "network once, give a folder with --assets DIR, or take the pack that needs no download: --assets primitive"
        )
    return path
