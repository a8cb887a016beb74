"""How sure a model was of a choice, from the probabilities of the token with which the choice begins."""

import math
import re
from collections.abc import Sequence

from jiti.annotate.vlm.backend import Token


def choice_probability(tokens: Sequence[Token], key: str, choices: Sequence[str]) -> dict[str, float] | None:
    """Probability of each choice for the text value of a JSON key, normalised over the choices; None if not given.

    The choices must differ in their first letter. A tokenizer may begin a value with the quotation mark or without it,
    and with any number of its letters; what is likeliest instead at that place counts for the choice that it begins.
    """
    text = "".join(token.text for token in tokens)
    found = list(re.finditer(rf'"{re.escape(key)}"\s*:\s*"', text))
    if not found:
        return None
    quote = found[-1].end() - 1
    start = 0
    for token in tokens:
        # The first token with a letter of the value in it.
        if start <= quote + 1 < start + len(token.text):
            return _of_token(token, text[start : quote + 1], choices)
        start += len(token.text)
    return None


def _of_token(token: Token, before: str, choices: Sequence[str]) -> dict[str, float] | None:
    """`before` is what the token has of the text in front of the value: a quotation mark, a space, or nothing."""
    total = dict.fromkeys(choices, 0.0)
    for text, logprob in {**token.others, token.text: token.logprob}.items():
        value = text[len(before) :] if text.startswith(before) else text.lstrip(' "')
        for choice in choices:
            if value and (choice.startswith(value) or value.startswith(choice)):
                total[choice] += math.exp(min(logprob, 0.0))
    mass = sum(total.values())
    return {choice: p / mass for choice, p in total.items()} if mass > 0 else None
