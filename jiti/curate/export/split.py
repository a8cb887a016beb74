"""Train, validation and test by episode, with the same share of every task and verdict in each; `unseen` by task."""

from collections import Counter
from collections.abc import Hashable, Sequence

import numpy as np

from jiti.errors import UsageError

SPLITS = ("train", "validation", "test")
UNSEEN = "unseen"
DEFAULT = (0.8, 0.1, 0.1)
"""Shares. Our choice: the usual ones; of 40 demonstrations a task, 4 each are held out."""


def parse_shares(text: str) -> tuple[float, float, float]:
    """`0.8,0.1,0.1`. Raises UsageError unless it is three shares that sum to 1."""
    try:
        shares = tuple(float(part) for part in text.split(","))
    except ValueError:
        shares = ()
    if len(shares) != 3 or min(shares) < 0 or abs(sum(shares) - 1) > 1e-6 or shares[0] == 0:
        raise UsageError(
            f"--split {text} is not three shares of train, validation and test that sum to 1, the first above 0. "
            "Pass --split 0.8,0.1,0.1."
        )
    return shares[0], shares[1], shares[2]


def split_episodes(
    strata: Sequence[Hashable], unseen: Sequence[bool], shares: tuple[float, float, float], seed: int
) -> list[str]:
    """A split for each episode, in order; those marked are `unseen`, the rest is divided within each stratum.

    Each stratum is shuffled with the seed. Its episodes go, one by one, to the split that lacks most of its share of
    the stratum, and among equals to the one that lacks most overall: small strata do not all round the same way.
    """
    found = [UNSEEN] * len(strata)
    overall: Counter[str] = Counter()
    groups: dict[Hashable, list[int]] = {}
    for place, (stratum, is_unseen) in enumerate(zip(strata, unseen, strict=True)):
        if not is_unseen:
            groups.setdefault(stratum, []).append(place)
    for number, (_, places) in enumerate(sorted(groups.items(), key=lambda item: repr(item[0]))):
        own: Counter[str] = Counter()
        shuffled = np.random.default_rng([seed, number]).permutation(places)
        for count, place in enumerate(shuffled.tolist(), 1):
            lacking = {
                name: (round(share * count - own[name], 9), share * (overall.total() + 1) - overall[name])
                for name, share in zip(SPLITS, shares, strict=True)
                if share
            }
            chosen = max(lacking, key=lambda name: lacking[name])
            found[place] = chosen
            own[chosen] += 1
            overall[chosen] += 1
    return found
