"""What a run with a model would cost, before it starts: requests, pictures, tokens. Nothing is decoded or asked."""

import json
from collections.abc import Callable
from dataclasses import dataclass

from jiti.annotate.measured import decide_by_numbers
from jiti.annotate.proposer import Proposer
from jiti.annotate.readings import Readings
from jiti.annotate.vlm.answers import Span
from jiti.annotate.vlm.backend import Prompt, Usage
from jiti.annotate.vlm.notes import ItcNotes, notes_path, read_notes
from jiti.annotate.vlm.prompts import decide_prompt, locate_prompt
from jiti.annotate.vlm.propose import cameras_of
from jiti.annotate.vlm.sampling import OVERVIEW_FRAMES, SEGMENT_FRAMES
from jiti.annotate.vlm.settings import Settings
from jiti.annotate.vlm.sheets import sheet_size
from jiti.episodes.episode import Episode, EpisodeReader
from jiti.errors import JitiError
from jiti.tasks.catalogue import Catalogue

PIXELS_A_TOKEN = 32 * 32
"""Of a Qwen3-VL: patches of 16 by 16 pixels, merged two by two."""
LETTERS_A_TOKEN = 4.0
"""Of English text, roughly, for tokenizers of 150,000 tokens."""
FACT_TOKENS = 350
"""A table of 12 rows of numbers."""
ANSWER_TOKENS = {"segments": 90, "verdict": 70}
"""Typical answers of our schemas."""


@dataclass
class Estimate:
    """Adds up over episodes. Its text is for a person."""

    episodes: int = 0
    done: int = 0
    """Episodes for which nothing is missing."""
    by_numbers: int = 0
    """Verdicts that recorded poses decide, which cost nothing."""
    requests: int = 0
    pictures: int = 0
    prompt_tokens: int = 0
    completion_tokens: int = 0
    unreadable: int = 0
    prices: tuple[float, float] | None = None
    """Of a million tokens read and written."""

    def add(self, prompt: Prompt, sizes: list[tuple[int, int]], times: int = 1, facts: int = 0) -> None:
        letters = len(prompt.system) + sum(len(part) for part in prompt.parts if isinstance(part, str))
        letters += len(json.dumps(prompt.schema))
        pixels = sum(width * height for width, height in sizes)
        self.requests += times
        self.pictures += times * len(sizes)
        self.prompt_tokens += times * round(letters / LETTERS_A_TOKEN + pixels / PIXELS_A_TOKEN + facts)
        self.completion_tokens += times * ANSWER_TOKENS[prompt.schema_name]

    @property
    def cost(self) -> float | None:
        """At the prices; None without any."""
        if self.prices is None:
            return None
        return Usage(self.requests, self.prompt_tokens, self.completion_tokens).cost(self.prices)

    def to_json(self) -> str:
        """For `--json`."""
        return json.dumps(
            {name: getattr(self, name) for name in self.__dataclass_fields__} | {"cost": self.cost}, indent=2
        )

    def __str__(self) -> str:
        lines = [
            f"{self.episodes} episodes: {self.requests:,} requests with {self.pictures:,} pictures, about "
            f"{self.prompt_tokens:,} tokens read and {self.completion_tokens:,} written, if each constraint has one "
            "segment.",
            f"{self.by_numbers:,} verdicts are decided by recorded poses and cost nothing; "
            f"{self.done:,} episodes are done already.",
        ]
        if self.unreadable:
            lines.append(f"{self.unreadable} episodes cannot be read or have no camera.")
        if self.cost is not None:
            lines.append(f"At these prices: {self.cost:.2f}.")
        return "\n".join([*lines, "Nothing was asked. Leave --dry-run out to begin."])


def estimate(
    reader: EpisodeReader,
    catalogue: Catalogue,
    proposer: Proposer,
    progress: Callable[[float, str], None] = lambda _share, _what: None,
) -> Estimate:
    """What the run would ask that it has not asked before; answers in the cache are not looked for."""
    total, refs = Estimate(), reader.episodes()
    settings = proposer.settings or Settings()
    for done, ref in enumerate(refs):
        progress(done / len(refs), ref.title)
        before = total.requests
        try:
            _episode(total, reader.open(ref.episode_id), catalogue, proposer, settings)
        except JitiError:
            total.unreadable += 1
            continue
        total.episodes += 1
        total.done += total.requests == before
    progress(1.0, "done")
    return total


def _episode(total: Estimate, episode: Episode, catalogue: Catalogue, proposer: Proposer, settings: Settings) -> None:
    cameras = cameras_of(episode, settings.cameras)
    task = catalogue.for_episode(episode)
    instruction = task.instruction or episode.task or ""
    notes = read_notes(notes_path(proposer.labels_dir, episode.episode_id), episode.fingerprint)
    readings = Readings(episode)
    count = episode.clock.frame_count
    for itc in task.itcs:
        known = notes.itcs.get(itc.itc_id, ItcNotes())
        located = settings.locate_key(instruction, itc, cameras)
        spans = len(known.spans) if known.has_spans(located) else 1
        if "segments" in proposer.stages and not known.has_spans(located):
            views = [(camera, []) for camera in cameras]
            total.add(locate_prompt(instruction, itc, views, ()), _sizes(episode, cameras, min(count, OVERVIEW_FRAMES)))
        elif known.has_decisions(settings.decide_key(located, itc)):
            continue
        if "verdicts" in proposer.stages:
            if settings.fuse and decide_by_numbers(episode, itc, readings) is not None:
                total.by_numbers += 1
                continue
            prompt = decide_prompt(
                instruction, itc, Span(0, 1, ""), [(c, []) for c in cameras], "", seed=0, temperature=0
            )
            sizes = _sizes(episode, cameras, min(count, SEGMENT_FRAMES + 2))
            total.add(prompt, sizes, times=spans * settings.samples, facts=FACT_TOKENS)


def _sizes(episode: Episode, cameras: tuple[str, ...], frames: int) -> list[tuple[int, int]]:
    sizes = []
    for camera in cameras:
        height, width = episode.streams[camera].shape[:2] or (480, 640)
        sizes += sheet_size(width, height, frames)
    return sizes
