"""Ask a model for an answer that can be used: the cache, else the model, else the model again with what was wrong."""

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace

from jiti.annotate.vlm.answers import BadAnswer
from jiti.annotate.vlm.backend import Answer, Backend, ModelFailed, Prompt, Usage
from jiti.annotate.vlm.cache import AnswerCache, prompt_key

SHOWN = 600
"""Characters of a bad answer that the model is shown again."""


@dataclass(frozen=True, slots=True)
class Asked[T]:
    """What an answer said, and the answer."""

    value: T
    answer: Answer


class Asker:
    """One model with its cache; counts what it costs. Safe to use from several threads."""

    def __init__(self, backend: Backend, cache: AnswerCache | None = None) -> None:
        self.backend, self._cache = backend, cache
        self._usage, self._lock = Usage(), threading.Lock()

    @property
    def model(self) -> str:
        return self.backend.model

    def take_usage(self) -> Usage:
        """What was spent since this was last called."""
        with self._lock:
            usage, self._usage = self._usage, Usage()
        return usage

    def ask[T](self, prompt: Prompt, read: Callable[[str], T]) -> Asked[T]:
        """`read` turns an answer's text into a value or raises BadAnswer.

        Raises ModelFailed when there is no answer, or two that cannot be used; the message quotes neither at length.
        """
        key = prompt_key(self.model, prompt)
        if self._cache is not None and (kept := self._cache.get(key)) is not None:
            try:
                value = read(kept.text)
            except BadAnswer:
                pass  # the rules have become stricter since
            else:
                self._add(Usage(cached=1))
                return Asked(value, kept)
        answer = self._once(prompt)
        try:
            value = _read(answer, read)
        except BadAnswer as first:
            answer = self._once(_repair(prompt, answer, str(first)))
            try:
                value = _read(answer, read)
            except BadAnswer as second:
                raise ModelFailed(f"{self.model} gave no usable answer, twice: {first}; then: {second}") from second
        if self._cache is not None:
            self._cache.put(key, answer)
        return Asked(value, answer)

    def _once(self, prompt: Prompt) -> Answer:
        answer = self.backend.ask(prompt)
        self._add(answer.usage)
        return answer

    def _add(self, usage: Usage) -> None:
        with self._lock:
            self._usage += usage


def _read[T](answer: Answer, read: Callable[[str], T]) -> T:
    if answer.cut:
        raise BadAnswer("it was longer than it may be, and was cut off")
    return read(answer.text)


def _repair(prompt: Prompt, answer: Answer, why: str) -> Prompt:
    said = answer.text if len(answer.text) <= SHOWN else f"{answer.text[:SHOWN]} ..."
    again = (
        f"You answered:\n{said}\n\nThat cannot be used: {why}.\nAnswer again, with one JSON object and nothing else."
    )
    return replace(prompt, parts=(*prompt.parts, again))
