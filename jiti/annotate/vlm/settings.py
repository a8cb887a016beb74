"""What a run with a model is told, and what of it makes earlier answers of use."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass

from jiti.annotate.vlm.answers import Span
from jiti.annotate.vlm.backend import Backend
from jiti.annotate.vlm.prompts import VERSION
from jiti.annotate.vlm.server import CONCURRENCY, RETRIES, TIMEOUT_S, ServerBackend
from jiti.errors import UsageError
from jiti.tasks.task import ITC

SAMPLES = 3
"""Verdicts that are asked for on one segment. Our choice: the fewest with a majority."""
TEMPERATURE = 0.7
"""Of the second sample and those after it; the first is the likeliest answer. Our choice: vLLM's usual for Qwen3-VL."""


@dataclass(frozen=True, slots=True)
class Settings:
    """Of one run; the same in every worker."""

    model: str = ""
    """A name on the server, or a folder or Hub id for this process."""
    url: str = ""
    """Of a server; empty for a model in this process."""
    cameras: tuple[str, ...] = ()
    """Streams to show; all colour cameras when empty."""
    samples: int = SAMPLES
    fuse: bool = True
    """Whether numbers decide where they can."""
    concurrency: int = CONCURRENCY
    timeout_s: float = TIMEOUT_S
    retries: int = RETRIES

    def __post_init__(self) -> None:
        if not 1 <= self.samples <= 50:
            raise UsageError(f"--samples {self.samples} is not in 1 to 50")

    def backend(self) -> Backend:
        """The model, loaded or connected to. Raises UsageError."""
        if self.url:
            return ServerBackend(
                self.url, self.model, concurrency=self.concurrency, timeout_s=self.timeout_s, retries=self.retries
            )
        from jiti.annotate.vlm.inprocess import InProcessBackend

        return InProcessBackend(self.model)

    def locate_key(self, instruction: str, itc: ITC, cameras: tuple[str, ...]) -> str:
        """What stage two of an ITC depends on."""
        return _key(VERSION, self.model, instruction, itc.statement, itc.check, itc.criterion, cameras)

    def decide_key(self, instruction: str, itc: ITC, cameras: tuple[str, ...], spans: Sequence[Span]) -> str:
        """What stage three depends on."""
        places = [(span.start_s, span.end_s) for span in spans]
        return _key(self.locate_key(instruction, itc, cameras), self.samples, places)


def _key(*parts: object) -> str:
    return hashlib.sha256(json.dumps(parts, default=str).encode()).hexdigest()[:16]
