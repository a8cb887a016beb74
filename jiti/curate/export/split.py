"""Train, validation and test by episode, with the same share of every task and verdict in each; `unseen` by task."""

import hashlib
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
    strata: Sequence[tuple[Hashable, Hashable]],
    unseen: Sequence[bool],
    shares: tuple[float, float, float],
    seed: int,
) -> list[str]:
    """A split for each episode, in order, of its task and verdict; those marked are `unseen`.

    The rest is divided within each stratum of task and verdict, which is shuffled with the seed and its own name. Its
    episodes go, one by one, to the split that lacks most of its share of the stratum; among equals to the one that
    lacks most of the task, then to one that the task's name draws: small strata do not all round the same way, and a
    task's splits do not depend on which other tasks there are.
    """
    found = [UNSEEN] * len(strata)
    tasks: dict[Hashable, dict[Hashable, list[int]]] = {}
    for place, ((task, verdict), is_unseen) in enumerate(zip(strata, unseen, strict=True)):
        if not is_unseen:
            tasks.setdefault(task, {}).setdefault(verdict, []).append(place)
    for task, groups in tasks.items():
        of_task: Counter[str] = Counter()
        drawn = dict(zip(SPLITS, _generator(seed, task).permutation(len(SPLITS)).tolist(), strict=True))
        for verdict, places in sorted(groups.items(), key=lambda item: repr(item[0])):
            own: Counter[str] = Counter()
            shuffled = _generator(seed, (task, verdict)).permutation(places)
            for count, place in enumerate(shuffled.tolist(), 1):
                lacking = {
                    name: (
                        round(share * count - own[name], 9),
                        round(share * (of_task.total() + 1) - of_task[name], 9),
                        drawn[name],
                    )
                    for name, share in zip(SPLITS, shares, strict=True)
                    if share
                }
                chosen = max(lacking, key=lambda name: lacking[name])
                found[place] = chosen
                own[chosen] += 1
                of_task[chosen] += 1
    return found


def _generator(seed: int, name: Hashable) -> np.random.Generator:
    """Python's own hashes differ from run to run."""
    digest = hashlib.sha256(repr(name).encode()).digest()
    return np.random.default_rng([seed, int.from_bytes(digest[:8])])
