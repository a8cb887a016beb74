"""What a run with a model would cost, before it starts: requests, pictures, tokens. Nothing is decoded or asked."""

import json
from dataclasses import dataclass

from jiti.annotate.vlm.backend import Prompt, Usage

PIXELS_A_TOKEN = 32 * 32
"""Of a Qwen3-VL: patches of 16 by 16 pixels, merged two by two."""
LETTERS_A_TOKEN = 4.0
"""Of English text, roughly, for tokenizers of 150,000 tokens."""
ANSWER_TOKENS = {"constraints": 350, "segments": 90, "verdict": 70}
"""Typical answers of our schemas."""


@dataclass
class Estimate:
    """Adds up over episodes, or tasks in stage one. Its text is for a person."""

    what: str = "episodes"
    episodes: int = 0
    """That can be read, whatever is missing of them."""
    done: int = 0
    """For which nothing is missing."""
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
            f"{self.episodes:,} {self.what}, of which {self.done:,} need nothing: {self.requests:,} requests with "
            f"{self.pictures:,} pictures, about {self.prompt_tokens:,} tokens read, {self.completion_tokens:,} written."
        ]
        if self.what == "episodes":
            lines.append(f"{self.by_numbers:,} verdicts by recorded poses cost nothing. Counted is one segment an ITC.")
        if self.unreadable:
            lines.append(f"{self.unreadable} episodes cannot be read or have no camera.")
        if self.cost is not None:
            lines.append(f"At these prices: {self.cost:.2g}.")
        lines.append("Answers that are kept from earlier runs are not taken off.")
        return "\n".join([*lines, "Nothing was asked. Leave --dry-run out to begin."])
