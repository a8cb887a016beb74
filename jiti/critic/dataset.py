"""D_elegant as a critic reads it: the number columns of a LeRobot v3 dataset as arrays, without lerobot itself.

Pictures are not read here: they reach a critic as features (`jiti.critic.features`).
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from jiti.curate.export.split import SPLITS as SEEN
from jiti.curate.export.split import UNSEEN
from jiti.curate.returns import GAMMA, mc_returns
from jiti.episodes.lerobot_index import episode_id_of
from jiti.episodes.lerobot_info import load_info
from jiti.episodes.lerobot_v3 import read_tasks_v3
from jiti.errors import SourceError

SPLITS = (*SEEN, UNSEEN)
"""Of meta/jiti/episodes.parquet; `unseen` are episodes of tasks that no other split has."""
ALL = "all"
"""Every split, where one is asked for."""
NEEDED = {
    "action": "actions",
    "next.reward": "rewards",
    "elegance.annotated": "labels",
    "elegance.mc_return": "Monte-Carlo returns",
}
_ORDER = ("index", "episode_index", "frame_index", "task_index")
_EDGE_BYTES = 1 << 16


@dataclass(frozen=True)
class ElegantData:
    """Frames of all episodes, one episode behind the other, in the dataset's `index` order."""

    root: Path
    gamma: float
    """Discount that `mc_return` was made with."""
    fps: float
    shapes: Mapping[str, tuple[int, ...]]
    """The dataset's features and the shape of each, as meta/info.json has them."""
    offsets: np.ndarray
    """(episodes + 1,) int64: episode `i` is frames `offsets[i]` to `offsets[i + 1] - 1`."""
    action: np.ndarray
    """(frames, A) float32."""
    reward: np.ndarray
    """(frames,) float32, r_t."""
    mc_return: np.ndarray
    """(frames,) float32, V^mu of the frame: r_t + gamma * mc_return[t + 1], 0 behind the last frame."""
    annotated: np.ndarray
    """(frames,) bool: an ITC is decided there."""
    split: np.ndarray
    """(episodes,) of `SPLITS`."""
    task: np.ndarray
    """(episodes,) task ids, or instructions where a task has no id."""
    episode_ids: np.ndarray
    """(episodes,) the recording that an episode comes from: its name and its fingerprint, the same in whatever dataset
    it is; without meta/jiti/episodes.parquet the episode's own name."""

    @property
    def episodes(self) -> int:
        return len(self.offsets) - 1

    @property
    def frames(self) -> int:
        return int(self.offsets[-1])

    @cached_property
    def fingerprint(self) -> str:
        """Hex digest of the numbers, and of the names, sizes, first and last bytes of the videos."""
        return dataset_fingerprint(self.root)

    @cached_property
    def episode_of(self) -> np.ndarray:
        """(frames,) int64: the episode of each frame."""
        return np.repeat(np.arange(self.episodes), np.diff(self.offsets))

    @cached_property
    def labelled(self) -> np.ndarray:
        """(episodes,) bool: an ITC is decided somewhere. The others' rewards are unknown, not 0."""
        return np.add.reduceat(self.annotated.astype(np.int64), self.offsets[:-1]) > 0

    def of_split(self, split: str) -> np.ndarray:
        """Labelled episodes of a split, or with `all` of all, (n,) int64, ascending."""
        return np.flatnonzero(((self.split == split) | (split == ALL)) & self.labelled)

    def recordings_of(self, split: str) -> list[str]:
        """Which recordings the labelled episodes of a split come from, in order."""
        return [str(name) for name in self.episode_ids[self.of_split(split)]]

    def frames_of(self, episodes: np.ndarray) -> np.ndarray:
        """The frames of episodes, (n,) int64, ascending within each."""
        return np.concatenate(
            [np.arange(self.offsets[e], self.offsets[e + 1]) for e in episodes] or [np.zeros(0, np.int64)]
        )

    def with_rewards(self, reward: np.ndarray, gamma: float) -> "ElegantData":
        """The same frames with other rewards (frames,) or another discount, and the returns that follow."""
        returns = mc_returns(reward, self.offsets, gamma)
        return replace(self, gamma=gamma, reward=reward.astype(np.float32), mc_return=returns.astype(np.float32))

    def with_gamma(self, gamma: float | None) -> "ElegantData":
        """The same frames with the returns of another discount; with None, its own."""
        return self if gamma is None or gamma == self.gamma else self.with_rewards(self.reward, gamma)

    def with_splits(self, split: np.ndarray) -> "ElegantData":
        """The same frames with other splits (episodes,)."""
        return replace(self, split=np.asarray(split, dtype=object))


def read_elegant(root: Path) -> ElegantData:
    """Read D_elegant. Raises SourceError, naming the file, for what is missing, damaged, not finite or unlabelled."""
    info = _info(root)
    table = _columns(root, info)
    action = _vectors(table, "action", root)
    reward, mc_return = (_numbers(table, name, root) for name in ("next.reward", "elegance.mc_return"))
    annotated = _flat(table["elegance.annotated"]).astype(bool)
    if not annotated.any():
        raise SourceError(
            f"{root}: no frame is annotated, so there is nothing to learn from. Accept labels with `jiti annotate`, "
            "then make the dataset again with `jiti curate`."
        )
    offsets = _offsets(table, root)
    about = _episodes(root, table, offsets)
    return ElegantData(
        root=root,
        gamma=_gamma(root),
        fps=float(info.get("fps", 0.0)),
        shapes={name: tuple(feature["shape"]) for name, feature in info["features"].items()},
        offsets=offsets,
        action=action,
        reward=reward,
        mc_return=mc_return,
        annotated=annotated,
        **about,
    )


def with_success_rewards(data: ElegantData) -> ElegantData:
    """The same frames with the main paper's sparse label: r = 1 at the last frame of an episode whose recorder saw it
    succeed, and else 0; the last frame is then what is annotated. Raises SourceError without `next.success`."""
    success = state_columns(data.root, ("next.success",))["next.success"][:, 0] > 0
    ends = np.zeros(data.frames, bool)
    ends[data.offsets[1:][data.labelled] - 1] = True
    return replace(data, annotated=ends).with_rewards((ends & success).astype(np.float32), data.gamma)


def spread(frames: np.ndarray, most: int) -> np.ndarray:
    """All of frames (n,), or `most` of them from the first to the last, equally far apart."""
    return frames[np.linspace(0, len(frames) - 1, min(len(frames), most)).astype(np.int64)]


def dataset_fingerprint(root: Path) -> str:
    """Hex digest of meta/info.json, of all data files, and of the videos' names, sizes, first and last bytes."""
    digest = hashlib.sha256((root / "meta/info.json").read_bytes())
    for path in sorted(root.glob("data/**/*.parquet")):
        digest.update(str(path.relative_to(root)).encode())
        with path.open("rb") as file:
            digest.update(hashlib.file_digest(file, "sha256").digest())
    for path in sorted(root.glob("videos/**/*.mp4")):
        size = path.stat().st_size
        digest.update(f"{path.relative_to(root)} {size}".encode())
        with path.open("rb") as file:
            digest.update(file.read(_EDGE_BYTES))
            file.seek(max(0, size - _EDGE_BYTES))
            digest.update(file.read())
    return digest.hexdigest()


def state_columns(root: Path, keys: tuple[str, ...]) -> dict[str, np.ndarray]:
    """Number columns of all frames by name, (frames, n) float32 each, in `index` order. Raises SourceError."""
    table = pa.concat_tables(_read(path, ["index", *keys]) for path in _files(root)).sort_by("index")
    return {key: _vectors(table, key, root) for key in keys}


def instructions(root: Path) -> np.ndarray:
    """The instruction of every frame (frames,), in `index` order. Raises SourceError."""
    table = pa.concat_tables(_read(path, ["index", "task_index"]) for path in _files(root)).sort_by("index")
    told = read_tasks_v3(load_info(root))
    numbers = table["task_index"].to_pylist()
    if unknown := set(numbers) - set(told):
        raise SourceError(f"{root}/meta/tasks.parquet lacks task {min(unknown)}. Make it again with `jiti curate`.")
    return np.array([told[number] for number in numbers], dtype=object)


def _info(root: Path) -> dict[str, Any]:
    path = root / "meta/info.json"
    try:
        info = json.loads(path.read_bytes())
        version, features = str(info["codebase_version"]), info["features"]
    except OSError as error:
        raise SourceError(
            f"{root} is no LeRobot dataset: {path} cannot be read ({error.strerror}). "
            "Make one with `jiti curate SOURCE --out DATASET`."
        ) from error
    except (ValueError, KeyError, TypeError) as error:
        raise SourceError(f"{path} is damaged: {error!r}. Make the dataset again with `jiti curate`.") from error
    if not version.startswith("v3"):
        raise SourceError(
            f"{root} is a LeRobot dataset of version {version}; critics read v3. Convert it with lerobot."
        )
    if missing := [name for name in NEEDED if name not in features]:
        raise SourceError(
            f"{root} has no {' and no '.join(f'{NEEDED[name]} ({name})' for name in missing)}; it has: "
            f"{', '.join(sorted(features))}. A critic needs D_elegant: make it with "
            "`jiti curate SOURCE --out DATASET` from recordings with accepted labels."
        )
    return info


def _files(root: Path) -> list[Path]:
    files = sorted(root.glob("data/**/*.parquet"))
    if not files:
        raise SourceError(f"{root} has no data/*.parquet. Make the dataset again with `jiti curate`.")
    return files


def _columns(root: Path, info: dict[str, Any]) -> pa.Table:
    table = pa.concat_tables(_read(path, [*NEEDED, *_ORDER]) for path in _files(root)).sort_by("index")
    index = table["index"].to_numpy()
    if len(index) != info.get("total_frames", len(index)) or not np.array_equal(index, np.arange(len(index))):
        raise SourceError(
            f"{root}: meta/info.json speaks of {info.get('total_frames')} frames, its data of {len(index)} with index "
            f"{index.min(initial=0)} to {index.max(initial=0)}. A file is missing or there twice; copy it all again."
        )
    return table


def _read(path: Path, columns: list[str]) -> pa.Table:
    try:
        # First, because Arrow takes the dot of a name that is not there for a path into a struct.
        if missing := set(columns) - set(pq.read_schema(path).names):
            raise SourceError(f"{path} has no column {sorted(missing)[0]}. Make the dataset again with `jiti curate`.")
        return pq.read_table(path, columns=columns).replace_schema_metadata()
    except (OSError, pa.ArrowException) as error:
        raise SourceError(f"{path} cannot be read: {str(error)[:200]}. Copy the dataset again.") from error


def _flat(column: pa.ChunkedArray) -> np.ndarray:
    """Values of a column of scalars, or of lists of one: LeRobot writes features of shape (1,) as scalars."""
    joined = column.combine_chunks()
    while pa.types.is_list(joined.type) or pa.types.is_fixed_size_list(joined.type):
        joined = joined.flatten()
    return joined.to_numpy(zero_copy_only=False)


def _numbers(table: pa.Table, name: str, root: Path) -> np.ndarray:
    return _finite(_flat(table[name]).astype(np.float32), name, root)


def _vectors(table: pa.Table, name: str, root: Path) -> np.ndarray:
    flat = _flat(table[name]).astype(np.float32)
    if flat.size % max(1, len(table)):
        raise SourceError(
            f"{root}: vectors of {name} have different lengths. Make the dataset again with `jiti curate`."
        )
    return _finite(flat.reshape(len(table), -1), name, root)


def _finite(values: np.ndarray, name: str, root: Path) -> np.ndarray:
    if not np.isfinite(values).all():
        frame = int(np.argwhere(~np.isfinite(values))[0][0])
        raise SourceError(
            f"{root}: {name} is not a number at index {frame}. Leave that episode out, or mend the recording, and run "
            "`jiti curate` again."
        )
    return values


def _offsets(table: pa.Table, root: Path) -> np.ndarray:
    episode, frame = table["episode_index"].to_numpy(), table["frame_index"].to_numpy()
    begins = np.flatnonzero(np.diff(episode, prepend=-1) != 0)
    offsets = np.append(begins, len(episode)).astype(np.int64)
    expected = np.arange(len(frame)) - np.repeat(offsets[:-1], np.diff(offsets))
    if len(np.unique(episode)) != len(begins) or not np.array_equal(frame, expected):
        raise SourceError(
            f"{root}: frames of an episode are not one behind the other. Make it again with `jiti curate`."
        )
    return offsets


def _gamma(root: Path) -> float:
    path = root / "meta/jiti/curate.json"
    try:
        return float(json.loads(path.read_bytes())["gamma"])
    except FileNotFoundError:
        return GAMMA
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise SourceError(f"{path} is damaged: {error!r}. Make the dataset again with `jiti curate`.") from error


def _episodes(root: Path, table: pa.Table, offsets: np.ndarray) -> dict[str, np.ndarray]:
    """Split, task and name of each episode; without meta/jiti/episodes.parquet all are for training."""
    numbers = table["episode_index"].to_numpy()[offsets[:-1]]
    tasks = [f"task {t}" for t in table["task_index"].to_numpy()[offsets[:-1]]]
    names = [episode_id_of(int(n)) for n in numbers]
    splits = ["train"] * len(numbers)
    path = root / "meta/jiti/episodes.parquet"
    if path.exists():
        wanted = ["episode_index", "episode_id", "fingerprint", "task_id", "split"]
        rows = {row["episode_index"]: row for row in _read(path, wanted).to_pylist()}
        if missing := [int(n) for n in numbers if n not in rows]:
            raise SourceError(f"{path} lacks episode {missing[0]}. Make the dataset again with `jiti curate`.")
        tasks = [rows[n]["task_id"] or task for n, task in zip(numbers, tasks, strict=True)]
        names = [f"{rows[n]['episode_id']} {rows[n]['fingerprint']}" for n in numbers]
        splits = [rows[n]["split"] for n in numbers]
        if unknown := set(splits) - set(SPLITS):
            raise SourceError(f"{path} has split {sorted(map(str, unknown))[0]!r}; there are: {', '.join(SPLITS)}.")
    return {
        "split": np.array(splits, dtype=object),
        "task": np.array(tasks, dtype=object),
        "episode_ids": np.array(names, dtype=object),
    }
