"""A folder of MCAP files as one source; a file that cannot be opened does not stop the others."""

import os
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from jiti.episodes.episode import Episode, EpisodeRef, Problem
from jiti.episodes.mcap_reader import SUFFIX, McapReader, mcap_episode_id
from jiti.episodes.summary_cache import Summary, SummaryCache
from jiti.errors import SourceError

LABELS_FOLDER = "labels"
ROLLOUTS_FILE, ROLLOUTS_FORMAT = "plan.json", "jiti rollout"
"""The file by which a folder of rollouts is known, and what its first line says."""


class FolderReader:
    """All MCAP files in a folder and below it, in natural order (`pick2` before `pick10`).

    Hidden folders, folders of labels, of rollouts and links to folders are not entered: what a policy did is no
    demonstration. A folder of rollouts that is opened itself is read. The listing opens no recording: frame counts
    and tasks come from the cache of those that were open before.
    """

    def __init__(self, root: Path) -> None:
        """Raises SourceError when the folder holds no MCAP file that could be opened."""
        self.root = root.absolute()
        self.labels_dir = str(self.root / LABELS_FOLDER)
        self._problems: list[Problem] = []
        self.problems: Sequence[Problem] = self._problems
        self._cache = SummaryCache(self.root)
        self._paths: dict[str, Path] = {}
        self._rollouts: list[str] = []
        other: Counter[str] = Counter()
        for path in self._files():
            if path.suffix == SUFFIX:
                self._paths[mcap_episode_id(path, self.root)] = path
            else:
                other[path.suffix.lower() or "no suffix"] += 1
        self._refs = {episode_id: self._ref(path) for episode_id, path in self._paths.items()}
        if all(ref.problem for ref in self._refs.values()):
            raise self._nothing(other)
        count = len(self._refs)
        self.title = f"{count} recording{'s' if count != 1 else ''} in {self.root.name or self.root}"

    def episodes(self) -> Sequence[EpisodeRef]:
        return list(self._refs.values())

    def open(self, episode_id: str) -> Episode:
        path = self._paths.get(episode_id)
        if path is None:
            has = ", ".join(list(self._paths)[:5]) + (", ..." if len(self._paths) > 5 else "")
            raise SourceError(f"{self.root} has no recording {episode_id!r}; it has {len(self._paths)}: {has}.")
        try:
            stat = path.stat()
        except OSError as error:
            raise SourceError(f"{path}: cannot be opened ({error.strerror}). Open the folder again.") from error
        try:
            episode = McapReader(path, root=self.root).open(episode_id)
        except SourceError as error:
            problem = _as_problem(self._inside(path), error)
            self._refs[episode_id] = replace(self._refs[episode_id], problem=problem)
            self._remember(path, Summary(stat.st_size, stat.st_mtime_ns, problem=_parts(problem)))
            raise
        count, task = episode.clock.frame_count, episode.task
        self._refs[episode_id] = replace(self._refs[episode_id], frame_count=count, task=task, problem=None)
        self._remember(path, Summary(stat.st_size, stat.st_mtime_ns, count, task, episode.fingerprint))
        return episode

    def _files(self) -> list[Path]:
        found = []
        for folder, names, files in os.walk(self.root, onerror=self._unreadable):
            names[:] = [n for n in names if not n.startswith(".") and n != LABELS_FOLDER and not n.endswith(".labels")]
            inside = [n for n in names if is_rollouts(Path(folder, n))]
            self._rollouts += [Path(folder, n).relative_to(self.root).as_posix() for n in inside]
            names[:] = [n for n in names if n not in inside]
            found += [Path(folder, name) for name in files if not name.startswith(".")]
        return sorted(found, key=lambda path: natural_key(self._inside(path)))

    def _unreadable(self, error: OSError) -> None:
        where = str(error.filename)
        self._problems.append(
            Problem(where, f"the folder cannot be read ({error.strerror})", "Its recordings are not listed.", "error")
        )

    def _ref(self, path: Path) -> EpisodeRef:
        """From the cache, or else from the file's first bytes."""
        (ref,) = McapReader(path, root=self.root).episodes()
        try:
            known = self._cache.get(self._inside(path), path.stat())
        except OSError:
            return ref
        if known is None:
            return ref
        problem = Problem(*known.problem, "error") if known.problem else None
        return replace(ref, frame_count=known.frame_count, task=known.task, problem=problem)

    def _remember(self, path: Path, summary: Summary) -> None:
        self._cache.put(self._inside(path), summary)

    def _inside(self, path: Path) -> str:
        return path.relative_to(self.root).as_posix()

    def _nothing(self, other: Counter[str]) -> SourceError:
        looked = f"{self.root}: no recording in this folder can be opened."
        if self._refs:
            first = next(ref.problem for ref in self._refs.values())
            return SourceError(f"{looked} It has {len(self._refs)} MCAP files; the first: {first}")
        found = ", ".join(f"{count} {suffix}" for suffix, count in other.most_common(6)) or "nothing"
        what = f"{looked} Looked for MCAP files (*.mcap) here and below, and for a LeRobot dataset (meta/info.json)"
        if self._rollouts:
            return SourceError(f"{what}; found rollouts in {', '.join(self._rollouts[:5])}. Open one of them.")
        if datasets := self._datasets():
            names = ", ".join(datasets[:5])
            return SourceError(f"{what}; found LeRobot datasets in {names}. Open one of them.")
        if (self.root / "data").is_dir() and (self.root / "meta").is_dir():
            return SourceError(
                f"{what}; found meta/ and data/ without meta/info.json. Download the LeRobot dataset again."
            )
        return SourceError(f"{what}; found {found}. Give the folder or file that holds the recordings.")

    def _datasets(self) -> list[str]:
        """LeRobot datasets one or two folders down."""
        found = [*self.root.glob("*/meta/info.json"), *self.root.glob("*/*/meta/info.json")]
        return sorted(path.parent.parent.relative_to(self.root).as_posix() for path in found)


def is_rollouts(folder: Path) -> bool:
    """Whether `jiti rollout` wrote into a folder."""
    try:
        with (folder / ROLLOUTS_FILE).open("rb") as file:
            return f'"format": "{ROLLOUTS_FORMAT}"'.encode() in file.read(64)
    except OSError:
        return False


def natural_key(text: str) -> list[tuple[int, int, str]]:
    """Numbers in the text compare as numbers; folders stay together."""
    parts = [part for part in re.split(r"(\d+|/)", text) if part]
    return [(0, 0, "") if p == "/" else (1, int(p), p) if p.isdecimal() else (2, 0, p.casefold()) for p in parts]


def _as_problem(inside: str, error: SourceError) -> Problem:
    return Problem(inside, str(error).rstrip("."), "The other recordings can be used.", "error")


def _parts(problem: Problem) -> tuple[str, str, str]:
    return problem.where, problem.what, problem.remedy
