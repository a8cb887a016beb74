"""Candidate chunks of a frozen policy, and what a critic thinks of them.

    sampler, scorer = open_sampler("RUN"), open_scorer("CRITIC")
    check_pair(sampler, scorer)
    guide = Guide(guidance, seed, sampler.noise_shape)
    seen = sampler.observe(observation, instruction)
    chunk, decision = guide.decide(seen.sample, scorer.at(observation, instruction, seen))

A chunk follows from its noise alone. What a policy makes of an observation before any noise is made once a decision,
for all candidates, and where the critic's features come from there, for them too. torch and lerobot are imported when
something is opened.
"""

from jiti.runtime.candidates.sampler import Sampler, Seen, open_sampler
from jiti.runtime.candidates.scorer import Scorer, check_pair, open_scorer

__all__ = ["Sampler", "Scorer", "Seen", "check_pair", "open_sampler", "open_scorer"]
