"""Just-in-Time Intervention: when to look at other action chunks of a frozen policy, and which one to take.

Algorithm 1 of the paper. At decision t the policy's default chunk A_0 has the value q_t = Q(s_t, A_0). With q_bar the
mean of the last k values and delta_q = |q_t - q_bar|, A_0 is executed where delta_q <= tau; else N candidates are
drawn, A_0 among them, and the one with the highest value is executed.

What the paper leaves open, and what is done here: q_bar is over the k decisions before this one, so the first decision
of an episode never triggers; what enters q_bar is always the default's value, so that an intervention does not hide
the next; the default is one of the N, so that the best is never worse than the default to the critic.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from time import perf_counter
from typing import Literal

import numpy as np

from jiti.errors import UsageError

Method = Literal["none", "jiti", "full"]
"""Never look, look where the value jumps, look at every decision (the paper's full guidance)."""
Pick = Literal["best", "median", "worst", "random"]
"""By the critic's value, as in the case study of supplement F.1; `random` is the control that asks no critic."""

CANDIDATES = 8
"""N, main paper and supplement G.6."""
WINDOW = 2
"""k is not published. Our choice, in decisions: with a mean over 5, what was decided long before still triggers, and in
LIBERO-Elegant, on tuning seeds, JITI gained less (docs/rollouts.md)."""

Sample = Callable[[np.ndarray], np.ndarray]
"""Noise (n, K, A) to action chunks (n, K, A), for one observation."""
Score = Callable[[np.ndarray], np.ndarray]
"""Action chunks (n, K, A) to values (n,), for the same observation."""


@dataclass(frozen=True, slots=True)
class Guidance:
    """What is done at each decision."""

    method: Method = "jiti"
    pick: Pick = "best"
    candidates: int = CANDIDATES
    window: int = WINDOW
    tau: float | None = None
    """Threshold on delta_q, in the unit of Q; `jiti` alone needs it."""

    def __post_init__(self) -> None:
        if self.candidates < 1:
            raise UsageError(f"{self.candidates} candidates; there must be at least 1. Pass --candidates {CANDIDATES}.")
        if self.window < 1:
            raise UsageError(f"a window of {self.window} decisions; it must be at least 1. Pass --window {WINDOW}.")
        if self.method == "jiti" and (self.tau is None or not self.tau >= 0):
            raise UsageError(
                f"tau is {self.tau}; JITI needs a threshold of 0 or more. "
                "Calibrate the critic on episodes of its own, or pass --tau."
            )


@dataclass(frozen=True, slots=True)
class Decision:
    """What was decided once, and why."""

    decision: int
    """From 0 in each episode."""
    q_t: float
    """Value of the default chunk; NaN where the critic was not asked, or gave none."""
    q_bar: float
    """Mean of the values before; NaN at the first decision."""
    triggered: bool
    values: tuple[float, ...]
    """Of the candidates, the default first; empty where none were drawn."""
    chosen: int
    """0 is the default."""
    sample_s: float
    score_s: float
    problem: str = ""
    """Why the default was executed though others were wanted."""

    @property
    def delta_q(self) -> float:
        return abs(self.q_t - self.q_bar)


_NOISE, _PICK = 1, 2
"""What a stream of random numbers is for: the last of its seeds, and not 0, because numpy takes seeds that end in zeros
for those without them, so that streams of fewer seeds (a scene's) would be the same."""


def noise(seed: int, decision: int, candidate: int, shape: tuple[int, ...]) -> np.ndarray:
    """Standard normal float32 that depends on nothing else, so that methods share it and none draws what it does not
    use. Candidate 0 is the default."""
    return np.random.default_rng([seed, decision, candidate, _NOISE]).standard_normal(shape, dtype=np.float32)


@dataclass(slots=True)
class Guide:
    """One episode's decisions; a new episode takes a new guide."""

    guidance: Guidance
    seed: int
    shape: tuple[int, int]
    """(K, A) of the noise that makes a chunk."""
    _before: deque[float] = field(init=False)
    _decisions: int = field(init=False, default=0)

    def __post_init__(self) -> None:
        self._before = deque(maxlen=self.guidance.window)

    def decide(self, sample: Sample, score: Score) -> tuple[np.ndarray, Decision]:
        """The chunk (K, A) to execute. `none` samples once and asks no critic; `jiti` samples once and asks once,
        unless it triggers. A value that is not finite leaves the default, and the decision says so."""
        g, number = self.guidance, self._decisions
        self._decisions += 1
        # Full guidance looks at all in any case, and draws and values them as one batch.
        looked = g.candidates if g.method == "full" else 1
        chunks, sample_s = _timed(sample, self._noise(number, 0, looked))
        q_t = q_bar = float("nan")
        if g.method == "none":
            return chunks[0], Decision(number, q_t, q_bar, False, (), 0, sample_s, 0.0)
        values, score_s = _timed(score, chunks)
        q_t = float(values[0])
        q_bar = float(np.mean(self._before)) if self._before else q_bar
        if np.isfinite(q_t):
            self._before.append(q_t)
        wanted = g.method == "full" or (g.tau is not None and abs(q_t - q_bar) > g.tau)
        if not np.isfinite(q_t):
            why = "the critic gave no number for the default"
            return chunks[0], Decision(number, q_t, q_bar, False, (), 0, sample_s, score_s, why)
        if not wanted or g.candidates == 1:
            return chunks[0], Decision(number, q_t, q_bar, wanted, (), 0, sample_s, score_s)
        if looked < g.candidates:
            others, others_sample_s = _timed(sample, self._noise(number, looked, g.candidates))
            others_values, others_score_s = _timed(score, others)
            chunks, values = np.concatenate([chunks, others]), np.append(values, others_values)
            sample_s, score_s = sample_s + others_sample_s, score_s + others_score_s
        why = "" if np.isfinite(values).all() else "the critic gave no number for a candidate"
        chosen = 0 if why else self._choose(values, number)
        told = tuple(float(value) for value in values)
        return chunks[chosen], Decision(number, q_t, q_bar, True, told, chosen, sample_s, score_s, why)

    def _noise(self, decision: int, first: int, stop: int) -> np.ndarray:
        return np.stack([noise(self.seed, decision, k, self.shape) for k in range(first, stop)])

    def _choose(self, values: np.ndarray, decision: int) -> int:
        # Stable, so that of equal values the earlier candidate counts as the better one.
        ranked = np.argsort(-values, kind="stable")
        if self.guidance.pick == "random":
            return int(np.random.default_rng([self.seed, decision, 0, _PICK]).integers(len(values)))
        place = {"best": 0, "median": (len(values) - 1) // 2, "worst": -1}[self.guidance.pick]
        return int(ranked[place])


def _timed(ask: Callable[[np.ndarray], np.ndarray], given: np.ndarray) -> tuple[np.ndarray, float]:
    """What it answers, and the seconds that it took."""
    began = perf_counter()
    return ask(given), perf_counter() - began


def calibrated_tau(delta_q: np.ndarray, rate: float) -> float:
    """The threshold that the share `rate` of these exceeds: a quantile of delta_q over the decisions of separate
    episodes, played without guidance, in which the first decision of each has none (NaN, not counted as exceeding).

    Raises UsageError for a rate outside 0 to 1, or without any number.
    """
    known = np.asarray(delta_q, float)
    finite = known[np.isfinite(known)]
    if not 0 < rate < 1:
        raise UsageError(f"an intervention rate of {rate}; it must be between 0 and 1. The paper's is 0.339 (G.6).")
    if not len(finite):
        raise UsageError("no decision has a delta_q to calibrate tau on; play some episodes first.")
    # Of all decisions, first ones included, `rate` are to trigger.
    share = min(1.0, rate * len(known) / len(finite))
    return float(np.quantile(finite, 1 - share))
