"""What is asked of a vision-language model, what it answers, and what that cost."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from jiti.errors import JitiError


class ModelFailed(JitiError):
    """A model could not be asked: the server is gone, refuses, or was too slow. The run goes on without its answer."""


@dataclass(frozen=True, slots=True)
class Picture:
    """A contact sheet, as a JPEG."""

    jpeg: bytes
    width: int
    height: int


@dataclass(frozen=True, slots=True)
class Prompt:
    """One question, complete: the same prompt to the same model is the same request."""

    system: str
    parts: tuple[str | Picture, ...]
    """Words and pictures, in the order in which they are read."""
    schema_name: str
    schema: Mapping[str, Any]
    """JSON schema of the answer, for backends that can hold a model to it."""
    max_tokens: int
    temperature: float = 0.0
    seed: int = 0
    chosen: str = ""
    """Key of the schema whose value is a choice: the probability of its first token is wanted."""


@dataclass(frozen=True, slots=True)
class Usage:
    """What requests cost. Adds up."""

    requests: int = 0
    prompt_tokens: int = 0
    completion_tokens: int = 0
    seconds: float = 0.0
    """Waiting for models, all requests together."""
    cached: int = 0
    """Requests that were answered before and cost nothing now."""

    def cost(self, prices: tuple[float, float]) -> float:
        """From prices of a million tokens read and written."""
        return (self.prompt_tokens * prices[0] + self.completion_tokens * prices[1]) / 1e6

    def __add__(self, other: "Usage") -> "Usage":
        return Usage(*(getattr(self, name) + getattr(other, name) for name in self.__dataclass_fields__))


NOTHING = Usage()


@dataclass(frozen=True, slots=True)
class Token:
    """One token of an answer, and what else might have stood there."""

    text: str
    logprob: float
    others: Mapping[str, float] = field(default_factory=dict)
    """Log-probability by text of the likeliest tokens, this one included."""


@dataclass(frozen=True, slots=True)
class Answer:
    """What a model said."""

    text: str
    cut: bool
    """Whether it stopped because `max_tokens` was reached."""
    usage: Usage
    tokens: tuple[Token, ...] = ()
    """Empty where the backend gives no probabilities."""


class Backend(Protocol):
    """A model that can be asked. Safe to use from several threads."""

    model: str
    """The name under which answers are kept: another model's answers are others."""
    concurrency: int
    """Requests that it can take at once."""

    def ask(self, prompt: Prompt) -> Answer:
        """Raises ModelFailed when there is no answer."""
        ...
