"""Answers that were given before, kept by what was asked: model, words, pixels, schema, sampling."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from jiti.annotate.vlm.backend import Answer, Picture, Prompt, Token, Usage
from jiti.durable import make_folder, write_atomic

_VERSION = 1


def prompt_key(model: str, prompt: Prompt) -> str:
    """A text that is the same only for the same question to the same model."""
    parts = [
        {"sha256": hashlib.sha256(part.jpeg).hexdigest()} if isinstance(part, Picture) else part
        for part in prompt.parts
    ]
    asked = {
        "version": _VERSION,
        "model": model,
        "system": prompt.system,
        "parts": parts,
        "schema": prompt.schema,
        "max_tokens": prompt.max_tokens,
        "temperature": prompt.temperature,
        "seed": prompt.seed,
        "chosen": prompt.chosen,
    }
    return hashlib.sha256(json.dumps(asked).encode()).hexdigest()


class AnswerCache:
    """A folder of JSON files, one an answer. Safe to use from several processes: files are replaced in whole.

    Only answers that could be used are put in, so a model that answered badly is asked again.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def get(self, key: str) -> Answer | None:
        """None for what was not asked before; a damaged file counts as that."""
        try:
            return _answer(json.loads(self._path(key).read_bytes()))
        except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
            return None

    def put(self, key: str, answer: Answer) -> None:
        """Raises SaveFailed when the disk refuses."""
        path = self._path(key)
        make_folder(path.parent)
        write_atomic(path, json.dumps(asdict(answer)).encode())

    def _path(self, key: str) -> Path:
        return self._folder / key[:2] / f"{key}.json"


def _answer(row: Mapping[str, Any]) -> Answer:
    tokens = tuple(Token(t["text"], t["logprob"], t["others"]) for t in row["tokens"])
    if not isinstance(row["text"], str):
        raise TypeError("an answer is a text")
    return Answer(row["text"], bool(row["cut"]), Usage(**row["usage"]), tokens)
