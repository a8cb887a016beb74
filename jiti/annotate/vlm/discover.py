"""Stage one: the ITCs of a task, into a task file for review (supplement, G.1)."""

import hashlib
import json
import re
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from jiti.annotate.engine import WorkerLost, run
from jiti.annotate.events import find_events
from jiti.annotate.vlm.answers import Constraint, read_constraints
from jiti.annotate.vlm.ask import Asker
from jiti.annotate.vlm.backend import ModelFailed, Picture, Usage
from jiti.annotate.vlm.cost import Estimate
from jiti.annotate.vlm.prompts import LONGEST_DATA, discover_prompt
from jiti.annotate.vlm.propose import cameras_of
from jiti.annotate.vlm.sampling import overview_frames
from jiti.annotate.vlm.sheets import contact_sheets, sheet_size
from jiti.durable import make_folder, write_atomic
from jiti.episodes.episode import EpisodeReader
from jiti.errors import CatalogueError, SourceError, UsageError
from jiti.progress import Progress
from jiti.tasks.catalogue_file import read_tasks

VIDEOS = 3
"""Episodes of a task that are shown. Our choice: what varies between them is not what the task asks for."""
LONGEST_SLUG = 60
FRAMES = 12
"""Of each: one sheet."""
PROPOSED_FILE = "tasks.proposed.toml"
"""Beside the recordings; becomes a catalogue when a person has read it and copies it to `tasks.toml`."""

_HEADER = """\
# ITCs that {model} proposed: none counts until a person has read it. Delete what is wrong, mend what is nearly right,
# then copy this file to tasks.toml beside the recordings, or pass it with --tasks.
"""


@dataclass(frozen=True, slots=True)
class Unknown:
    """A task whose ITCs are wanted."""

    task_id: str
    instruction: str
    bddl: str | None = None
    episodes: tuple[str, ...] = ()
    """Some that show it; none asks from the instruction alone."""


@dataclass(frozen=True, slots=True)
class Discovered:
    """What was written. Its text is for a person."""

    path: Path
    tasks: int
    """Of this run."""
    constraints: int
    kept: int
    """Tasks that the file had before, which stay as they are."""
    failures: tuple[str, ...]
    usage: Usage

    def __str__(self) -> str:
        lines = [f"{self.constraints} ITCs proposed for {self.tasks} tasks; {self.kept} tasks were there before."]
        lines += [f"no answer: {failure}" for failure in self.failures[:20]]
        if self.failures:
            lines.append(f"{len(self.failures)} tasks failed; the same command tries these again.")
        read, written = self.usage.prompt_tokens, self.usage.completion_tokens
        lines.append(f"{self.usage.requests} requests; {read} tokens read, {written} written.")
        return "\n".join([*lines, f"Read and mend {self.path}, then copy it to tasks.toml beside the recordings."])

    def to_json(self) -> str:
        """For `--json`."""
        told = {field: getattr(self, field) for field in self.__dataclass_fields__}
        usage = {field: getattr(self.usage, field) for field in self.usage.__dataclass_fields__}
        return json.dumps(told | {"path": str(self.path), "usage": usage}, indent=2)


def tasks_in(reader: EpisodeReader) -> list[Unknown]:
    """The instructions of a source, each with episodes that show it. Raises UsageError when there is none."""
    shown: dict[str, list[str]] = {}
    worded: dict[str, str] = {}
    for ref in reader.episodes():
        try:
            instruction = ref.task or reader.open(ref.episode_id).task
        except SourceError:
            continue
        if instruction and instruction.strip():
            # Case and punctuation do not make another task of a wording.
            slug = _slug(instruction)
            worded.setdefault(slug, " ".join(instruction.split()))
            shown.setdefault(slug, []).append(ref.episode_id)
    if not shown:
        raise UsageError(f"no episode of {reader.title} has an instruction, so there is no task to find ITCs of.")
    return [
        Unknown(f"proposed/{slug}", worded[slug], None, tuple(_spread(episodes))) for slug, episodes in shown.items()
    ]


def discover(
    asker: Asker,
    unknown: Sequence[Unknown],
    path: Path,
    *,
    reader: EpisodeReader | None = None,
    cameras: tuple[str, ...] = (),
    reviewed: Collection[str] = (),
    progress: Progress = lambda _share, _what: None,
) -> Discovered:
    """Ask for the ITCs of each task that neither `path` nor `reviewed` has, and add them to `path` as they come.

    Raises UsageError when there is nothing to show for it, CatalogueError when the file is there and cannot be read,
    SaveFailed when the disk refuses.
    """
    text, known = _file(path, asker.model)
    known |= set(reviewed)
    missing = [task for task in unknown if task.task_id not in known]
    failures: dict[str, str] = {}
    answers: dict[str, list[Constraint]] = {}
    work = partial(_ask, asker, reader, cameras)
    progress(0.0, f"asking about {len(missing)} tasks")
    for done, (task, found) in enumerate(run(work, missing, workers=asker.backend.concurrency), 1):
        progress(done / len(missing), task.instruction)
        if isinstance(found, str | WorkerLost):
            failures[task.task_id] = str(found)
            continue
        answers[task.task_id] = found
        # In the order of the tasks, whatever the order of the answers.
        added = [_task(one, answers[one.task_id], asker.model) for one in missing if one.task_id in answers]
        make_folder(path.parent)
        write_atomic(path, (text + "".join(added)).encode())
    said = tuple(f"{task.task_id}: {failures[task.task_id]}" for task in missing if task.task_id in failures)
    if said and not answers and not path.exists():
        raise UsageError(f"no ITCs were proposed, and nothing was written: {'; '.join(said[:3])}")
    count = sum(len(found) for found in answers.values())
    return Discovered(path, len(answers), count, len(unknown) - len(missing), said, asker.take_usage())


def estimate_tasks(
    unknown: Sequence[Unknown], path: Path, reader: EpisodeReader | None = None, reviewed: Collection[str] = ()
) -> Estimate:
    """What `discover` would cost at most: a request a task, with a sheet of each episode that shows it."""
    _, known = _file(path, "")
    total = Estimate(what="tasks", episodes=len(unknown))
    for task in unknown:
        if task.task_id in known or task.task_id in reviewed:
            total.done += 1
            continue
        # Twelve frames of 4:3; other shapes differ by a third.
        sizes = [size for _ in (task.episodes if reader else ()) for size in sheet_size(640, 480, FRAMES)]
        total.add(discover_prompt(task.instruction, []), sizes)
    return total


def _ask(asker: Asker, reader: EpisodeReader | None, cameras: tuple[str, ...], task: Unknown) -> list[Constraint] | str:
    """The constraints, or why there are none."""
    try:
        sheets = [s for episode in task.episodes for s in _sheets(reader, episode, cameras)] if reader else []
        return asker.ask(discover_prompt(task.instruction, sheets), read_constraints).value
    except (ModelFailed, SourceError) as error:
        return str(error)
    except (OSError, ValueError) as error:  # of a picture that no one thought of
        return f"{type(error).__name__}: {error}"


def _sheets(reader: EpisodeReader, episode_id: str, cameras: tuple[str, ...]) -> Iterator[Picture]:
    """Of one camera: what a task asks for is seen from any."""
    episode = reader.open(episode_id)
    camera = cameras_of(episode, cameras)[0]
    yield from contact_sheets(episode, camera, overview_frames(episode.clock, find_events(episode), FRAMES))


def _file(path: Path, model: str) -> tuple[str, set[str]]:
    """What the file says so far, and the tasks in it."""
    if not path.exists():
        return _HEADER.format(model=_on_one_line(model)), set()
    known = {defined.task.task_id for defined in read_tasks(path)}
    try:
        return path.read_text(encoding="utf-8").rstrip("\n") + "\n", known
    except OSError as error:
        raise CatalogueError(f"{path} cannot be read: {error.strerror}") from error


def _task(task: Unknown, constraints: Iterable[Constraint], model: str) -> str:
    """As TOML, whose texts in double quotes are written as JSON's are."""
    lines = ["", "[[task]]", f"id = {_text(task.task_id)}", f"instruction = {_text(task.instruction)}"]
    lines.append(f"source = {_text(f'proposed by {_on_one_line(model)}')}")
    if task.bddl:
        lines.append(f"bddl = {_text(task.bddl)}")
    for one in constraints:
        lines += [
            "",
            f"[[task.itc]] # confidence {one.confidence:.2f}",
            f"id = {_text(one.name)}",
            f"criterion = {_text(one.criterion.value)}",
            f"statement = {_text(one.statement)}",
            f"check = {_text(one.check)}",
        ]
    return "\n".join(lines) + "\n"


def _text(value: str) -> str:
    return json.dumps(_on_one_line(value)[: 2 * LONGEST_DATA], ensure_ascii=False)


def _on_one_line(value: str) -> str:
    return " ".join(re.sub(r"[\x00-\x1f\x7f]", " ", value.encode("utf-8", "ignore").decode()).split())


def _slug(instruction: str) -> str:
    """An id: the words, and a digest that is the same in every run where letters were cut or left out."""
    plain = " ".join(re.split(r"[\W_]+", instruction.lower())).strip()
    slug = re.sub(r"[^a-z0-9]+", "-", plain).strip("-")
    if slug.replace("-", " ") == plain and len(slug) <= LONGEST_SLUG:
        return slug
    digest = hashlib.sha256(plain.encode("utf-8", "replace")).hexdigest()[:8]
    return f"{slug[:LONGEST_SLUG].strip('-') or 'task'}-{digest}"


def _spread(episodes: Sequence[str]) -> list[str]:
    """Up to `VIDEOS` of them, evenly."""
    if len(episodes) <= VIDEOS:
        return list(episodes)
    return [episodes[round(k * (len(episodes) - 1) / (VIDEOS - 1))] for k in range(VIDEOS)]
