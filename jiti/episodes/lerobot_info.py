"""`meta/info.json` of a LeRobot dataset: version, rate, features, and where its files are."""

import json
import math
import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from jiti.errors import SourceError

INFO_PATH = Path("meta/info.json")

INDEX_COLUMNS = ("timestamp", "frame_index", "episode_index", "index", "task_index")
"""Columns that say which row is which (lerobot/utils/constants.py, DEFAULT_FEATURES); they are no measurements."""

_PATHS = {
    3: (
        "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4",
    ),
    2: (
        "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet",
        "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4",
    ),
}
"""Where files are when info.json does not say (lerobot/datasets/utils.py, DEFAULT_DATA_PATH and its v2.1 elder)."""

_PLACEHOLDER = re.compile(r"\{(\w+)(?::0?(\d)d)?\}")


@dataclass(frozen=True, slots=True)
class Feature:
    """One entry of `features`."""

    key: str
    dtype: str
    """`video`, `image`, `string` or a NumPy name."""
    shape: tuple[int, ...]
    names: tuple[str, ...]
    """Of the components, as many as `size`; empty if not given."""
    axes: tuple[str, ...]
    """Of pictures: `("height", "width", "channels")` in the order of `shape`, if given."""
    is_depth: bool
    info: dict[str, Any]
    """Encoder settings and depth quantization, as written."""

    @property
    def size(self) -> int:
        return math.prod(self.shape)

    @property
    def height_width(self) -> tuple[int, int]:
        """Of a picture; the shape is (height, width, channels) unless its names say otherwise."""
        order = self.axes if len(self.axes) == len(self.shape) else ("height", "width", "channel")
        by_axis = dict(zip(order, self.shape, strict=False))
        return by_axis.get("height", 0), by_axis.get("width", 0)


@dataclass(frozen=True)
class DatasetInfo:
    """What info.json says, checked."""

    root: Path
    name: str
    """What messages call the dataset: the folder's name, or its id on the Hub."""
    version: str
    """As written: `v3.0`, `v2.1`."""
    fps: float
    features: tuple[Feature, ...]
    """In the file's order."""
    data_path: str
    video_path: str
    chunk_size: int
    total_episodes: int | None
    text: bytes

    @property
    def layout(self) -> int:
        """3: many episodes a file; 2: one."""
        return int(self.version[1])

    @cached_property
    def file_name(self) -> str:
        """info.json as messages name it."""
        return f"{self.name}/{INFO_PATH.as_posix()}"

    def data_file(self, **fields: int) -> str:
        """Path of a data file inside the dataset. Raises SourceError when the template leads outside."""
        return self._fill("data_path", self.data_path, fields)

    def video_file(self, video_key: str, **fields: int) -> str:
        """Path of a video inside the dataset. Raises SourceError when the template leads outside."""
        return self._fill("video_path", self.video_path, {"video_key": video_key, **fields})

    def _fill(self, name: str, template: str, fields: dict[str, Any]) -> str:
        """Fill in a path template: `{name}` and `{name:03d}`, nothing else that `str.format` can do."""

        def value(match: re.Match[str]) -> str:
            if match[1] not in fields:
                raise SourceError(
                    f"{self.file_name}: {name} {template!r} asks for {match[1]!r}; known are {', '.join(fields)}. "
                    "Correct the template."
                )
            filled = fields[match[1]]
            return f"{filled:0{match[2]}d}" if match[2] and isinstance(filled, int) else str(filled)

        path = _PLACEHOLDER.sub(value, template)
        # Links are followed: files in the Hub's cache are links to its store of blobs.
        if (
            path.startswith(("/", "~"))
            or Path(path).is_absolute()
            or "\0" in path
            or {"..", ".", ""} & set(path.replace("\\", "/").split("/"))
        ):
            raise SourceError(
                f"{self.file_name}: {name} {template!r} gives {path!r}, which is not a place inside the dataset. "
                "Do not open this dataset unless you know who wrote it; correct the template."
            )
        return path


def load_info(root: Path, title: str | None = None) -> DatasetInfo:
    """Read and check `meta/info.json`. Raises SourceError that names the file and the key."""
    path = root / INFO_PATH
    title = title or root.absolute().name
    name = f"{title}/{INFO_PATH.as_posix()}"
    try:
        text = path.read_bytes()
    except OSError as error:
        raise SourceError(f"{name}: cannot be read ({error.strerror}). Download the dataset again.") from error
    try:
        info = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise SourceError(f"{name}: is not JSON ({error}). Correct it, or download the dataset again.") from error
    if not isinstance(info, dict):
        raise SourceError(f"{name}: is a JSON {type(info).__name__}; it must be an object with codebase_version.")
    for key in ("codebase_version", "fps", "features"):
        if key not in info:
            has = ", ".join(info) or "nothing"
            raise SourceError(f"{name}: has no {key!r}; it has {has}. Add it, or download the dataset again.")
    version = _version(name, info["codebase_version"])
    fps = info["fps"]
    if isinstance(fps, bool) or not isinstance(fps, int | float) or not 0 < fps <= 1e6:
        raise SourceError(f"{name}: fps is {fps!r}; it must be a number above 0. Write the rate of the recording.")
    features = info["features"]
    if not isinstance(features, dict):
        raise SourceError(f"{name}: features is {type(features).__name__}; it must be an object of features by name.")
    data_path, video_path = _PATHS[int(version[1])]
    chunk_size = info.get("chunks_size", 1000)
    total = info.get("total_episodes")
    return DatasetInfo(
        root=root,
        name=title,
        version=version,
        fps=float(fps),
        features=tuple(_feature(name, key, value) for key, value in features.items()),
        data_path=_text(name, info, "data_path", data_path),
        video_path=_text(name, info, "video_path", video_path),
        chunk_size=chunk_size if isinstance(chunk_size, int) and chunk_size > 0 else 1000,
        total_episodes=total if isinstance(total, int) else None,
        text=text,
    )


def _version(name: str, version: object) -> str:
    if isinstance(version, str) and re.fullmatch(r"v3\.\d+|v2\.[01]", version):
        return version
    remedy = "Update jiti."
    if isinstance(version, str) and re.match(r"v?[01]\.", version):
        remedy = "Convert the dataset with the tools of the lerobot release that wrote it."
    raise SourceError(f"{name}: codebase_version is {version!r}; jiti reads v3.0, v2.1 and v2.0. {remedy}")


def _text(name: str, info: dict[str, Any], key: str, default: str) -> str:
    value = info.get(key)
    if value is None:  # lerobot writes null for the video path of a dataset without videos.
        return default
    if not isinstance(value, str):
        raise SourceError(f"{name}: {key} is {value!r}; it must be a path template like {default!r}.")
    return value


def _feature(name: str, key: str, value: object) -> Feature:
    if not isinstance(value, dict) or not isinstance(value.get("dtype"), str):
        raise SourceError(f"{name}: feature {key!r} has no dtype; write one such as 'float32' or 'video'.")
    shape = value.get("shape") or [1]
    if not isinstance(shape, list) or not all(isinstance(n, int) and n >= 0 for n in shape):
        raise SourceError(f"{name}: the shape of feature {key!r} is {shape!r}; it must be a list of whole numbers.")
    info = {}
    for part in (value.get("video_info"), value.get("info")):
        info |= part if isinstance(part, dict) else {}
    names = _flat_names(value.get("names"))
    picture = value["dtype"] in ("video", "image")
    return Feature(
        key=key,
        dtype=value["dtype"],
        shape=tuple(shape),
        names=names if not picture and len(names) == math.prod(shape) else (),
        axes=tuple("channels" if n == "channel" else n for n in names) if picture else (),
        is_depth=bool(info.get("is_depth_map") or info.get("video.is_depth_map")),
        info=info,
    )


def _flat_names(names: object) -> tuple[str, ...]:
    """`names` may be a list, a dict of lists (`{"motors": [...]}`), a dict of positions (`{"x": 0}`) or null."""
    if isinstance(names, dict):
        if names and all(isinstance(position, int) for position in names.values()):
            return tuple(sorted(names, key=lambda n: names[n]))
        return tuple(n for part in names.values() for n in _flat_names(part))
    if isinstance(names, list):
        return tuple(n for part in names for n in _flat_names(part))
    return () if names is None else (str(names),)
