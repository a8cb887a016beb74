"""What guidance costs: the time of a decision with none, full and just-in-time guidance, against the naive way.

    uv run python benchmarks/guidance.py --json figures.json

For SmolVLA at its real size with random weights, with a default critic on its features, and for `state_flow` with the
default critic on state vectors; N = 8. A decision is everything from an observation to the chunk that is executed:
preprocessing, sampling, features, values. `jiti` is measured in both of its kinds, quiet and triggered, and weighed by
an intervention rate (`--rate`, by default the paper's 33.9%, supplement G.6). The naive way is a batch of 8 through the
whole policy. Kinds are measured in turn, so that other work hits all alike: what counts are their ratios.

At the real size a decision takes seconds to minutes on a CPU, all of it about a quarter of an hour; `--quick` is small.
On a machine that others use, `--processor-time --threads 1` leaves out what they take.
"""

import argparse
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from bench import Bench, interleaved
from program import arguments, run
from real_smolvla import ACTION, CAMERAS, STATE, make_smolvla
from report import Line, timed

from jiti.runtime.guidance import CANDIDATES, Guidance, Guide
from jiti.tasks.scene_state import scene_state_names

RATE = 0.339
"""Share of decisions at which JITI intervenes; supplement G.6."""
FULL, JITI = 1.5, 1.15
"""Largest multiples of a decision without guidance. The paper's are 4.0 and 1.96 (G.6: 112.4, 449.3 and 220.5 ms)."""
TOLD = "put the bowl on the plate"


def measure(bench: Bench, asked: argparse.Namespace) -> Iterator[Line]:
    import torch

    torch.set_num_threads(asked.threads)
    if asked.only != "state_flow":
        yield from _smolvla(bench, asked)
    if asked.only != "smolvla":
        yield from _state_flow(bench, asked)


def _smolvla(bench: Bench, asked: argparse.Namespace) -> Iterator[Line]:
    import torch

    from jiti.runtime.candidates import Sampler
    from jiti.runtime.candidates.opened import OpenedBase
    from jiti.runtime.candidates.smolvla import open_source

    with bench.folder() as folder:
        policy, before, after = make_smolvla(folder, small=bench.quick)
        sampler = Sampler(OpenedBase(policy, before, after, folder), open_source(policy))
        width = policy.model.vlm_with_expert.config.text_config.hidden_size
        scorer = _scorer(f"smolvla:{folder}", tokens=len(CAMERAS) + 2, size=width)
        rng = np.random.default_rng(0)
        now = {"observation.state": rng.normal(size=STATE).astype(np.float32)}
        now |= {f"observation.images.{c}": rng.integers(0, 256, (256, 256, 3), np.uint8) for c in CAMERAS}
        kinds = _decisions(sampler.only(max(sampler.executed, scorer.chunk)), scorer, now)
        whole_chunks = _decisions(sampler, scorer, now)
        kinds |= {f"{kind}, whole": whole_chunks[kind] for kind in ("none", "full")}

        def whole(n: int) -> None:
            """lerobot's own way: n copies of the observation through the whole policy."""
            prepared = {
                key: value.expand(n, *value.shape[1:]) if isinstance(value, torch.Tensor) else value
                for key, value in before(sampler.observe(now, TOLD).batches[-1]).items()
            }
            with torch.inference_mode():
                after(policy.predict_action_chunk(prepared, noise=torch.randn(n, *sampler.noise_shape)))

        with _crop_by_length():
            kinds |= {"lerobot, one": partial(whole, 1), "naive": partial(whole, CANDIDATES)}
            yield from _lines(bench, "SmolVLA", kinds, asked, bench.count(asked.count, 2))


def _state_flow(bench: Bench, asked: argparse.Namespace) -> Iterator[Line]:
    import torch
    from lerobot.configs.types import FeatureType, PolicyFeature
    from lerobot.policies.factory import make_pre_post_processors

    from jiti.policies.configuration_state_flow import StateFlowConfig
    from jiti.policies.modeling_state_flow import StateFlowPolicy
    from jiti.runtime.candidates import Sampler
    from jiti.runtime.candidates.opened import OpenedBase
    from jiti.runtime.candidates.state_flow import open_source

    scene = len(scene_state_names())
    sizes = {"observation.state": STATE, "observation.environment_state": scene, "action": ACTION}
    config = StateFlowConfig(
        device="cpu",
        instructions=[TOLD, *(f"task {number}" for number in range(7))],
        input_features={
            "observation.state": PolicyFeature(FeatureType.STATE, (STATE,)),
            "observation.environment_state": PolicyFeature(FeatureType.ENV, (scene,)),
        },
        output_features={"action": PolicyFeature(FeatureType.ACTION, (ACTION,))},
    )
    policy = StateFlowPolicy(config).eval().requires_grad_(False)
    stats = {key: {"mean": torch.zeros(size), "std": torch.ones(size)} for key, size in sizes.items()}
    before, after = make_pre_post_processors(config, dataset_stats=stats)
    sampler = Sampler(OpenedBase(policy, before, after, Path("state_flow")), open_source(policy))
    scorer = _scorer("state", tokens=1, size=STATE + scene)
    rng = np.random.default_rng(0)
    now = {key: rng.normal(size=size).astype(np.float32) for key, size in sizes.items() if key != "action"}
    kinds = _decisions(sampler, scorer, now)

    def naive() -> None:
        """Each candidate with an encoding of its own, as a batch of 8 observations."""
        prepared = before(sampler.observe(now, TOLD).batches[-1])
        several = {
            key: value.expand(CANDIDATES, -1) if isinstance(value, torch.Tensor) else value
            for key, value in prepared.items()
        }
        after(policy.predict_action_chunk(several, torch.randn(CANDIDATES, *sampler.noise_shape)))

    yield from _lines(bench, "state_flow", kinds | {"naive": naive}, asked, bench.count(300, 5))


def _decisions(sampler: Any, scorer: Any, now: Any) -> dict[str, Callable[[], None]]:
    """A decision of each kind, of an episode that goes on: only the first of one cannot trigger."""

    def decide(guide: Guide) -> None:
        seen = sampler.observe(now, TOLD)
        guide.decide(seen.sample, scorer.at(now, TOLD, seen))

    methods = {
        "none": Guidance("none"),
        "quiet": Guidance("jiti", tau=float("inf")),
        "triggered": Guidance("jiti", tau=0.0),
        "full": Guidance("full"),
    }
    return {name: partial(decide, Guide(guidance, 0, sampler.noise_shape)) for name, guidance in methods.items()}


def _lines(
    bench: Bench, name: str, kinds: dict[str, Callable[[], None]], asked: argparse.Namespace, count: int
) -> Iterator[Line]:
    clock = time.process_time if asked.processor_time else time.perf_counter

    def seconds(decide: Callable[[], None]) -> float:
        begin = clock()
        decide()
        return clock() - begin

    for decide in kinds.values():  # warms up, and is the first decision of each
        decide()
    actions = {kind: partial(seconds, decide) for kind, decide in kinds.items()}
    with bench.progress(name) as say:
        found: dict[str, list[float]] = {kind: [] for kind in kinds}
        for turn in range(count):
            for kind, times_s in interleaved(1, **actions).items():
                found[kind] += times_s
            say((turn + 1) / count, f"{turn + 1} of {count}")
    pairs = zip(found["quiet"], found["triggered"], strict=True)
    jiti = [(1 - asked.rate) * quiet + asked.rate * triggered for quiet, triggered in pairs]
    none_s = float(np.median(found["none"]))
    yield timed(name, "none", found["none"])
    about_full = "the paper's is 4.0x none"
    yield timed(name, f"full, N = {CANDIDATES}", found["full"], limit=FULL, peer=none_s, note=about_full)
    yield timed(
        name,
        f"jiti at {asked.rate:.1%} interventions",
        jiti,
        limit=JITI,
        peer=none_s,
        note="the paper's is 1.96x none; weighed from quiet and triggered decisions",
    )
    yield timed(name, "jiti, quiet: one sample, one value", found["quiet"], peer=none_s)
    yield timed(name, "jiti, triggered: one, then the others", found["triggered"], peer=none_s)
    if "none, whole" in found:
        whole_s = float(np.median(found["none, whole"]))
        yield timed(name, "none, all 50 actions of a chunk made", found["none, whole"], peer=none_s)
        yield timed(name, "full, all 50 actions, against that", found["full, whole"], peer=whole_s)
    if "lerobot, one" in found:
        yield timed(name, "peer: one chunk, all 50 actions, by lerobot", found["lerobot, one"], peer=none_s)
    yield timed(name, f"peer: batch of {CANDIDATES} through the whole policy", found["naive"], peer=none_s)


def _scorer(features: str, *, tokens: int, size: int) -> Any:
    """A critic of the default network with random weights."""
    from jiti.critic.chunks import ActionRange
    from jiti.critic.critic import Sizes, make_critic
    from jiti.critic.settings import NetworkSettings
    from jiti.runtime.candidates import Scorer

    limits = ActionRange(-np.ones(ACTION, np.float32), np.ones(ACTION, np.float32))
    return Scorer(make_critic(NetworkSettings(), Sizes(size, tokens, ACTION), limits, {}), features, "cpu")


class _crop_by_length:
    """lerobot 0.6.1 asks for transformers below 5.6, whose `crop` took the length that is left; here for the peers."""

    def __enter__(self) -> None:
        from transformers import DynamicCache

        def crop(cache: Any, length: int) -> None:
            for layer in cache.layers:
                layer.keys, layer.values = layer.keys[..., :length, :], layer.values[..., :length, :]

        self._kept = DynamicCache.crop
        DynamicCache.crop = crop

    def __exit__(self, *_: object) -> None:
        from transformers import DynamicCache

        DynamicCache.crop = self._kept


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--rate", type=float, default=RATE, help="share of decisions that trigger (default 0.339)")
    parser.add_argument("--count", type=int, default=3, help="decisions of each kind for SmolVLA (default 3)")
    parser.add_argument("--threads", type=int, default=2, help="torch's threads (default 2)")
    parser.add_argument("--processor-time", action="store_true", help="measure that, not wall time")
    parser.add_argument("--only", choices=("smolvla", "state_flow"), help="one policy alone")
    asked = parser.parse_args()
    run(asked, partial(measure, asked=asked))


if __name__ == "__main__":
    main()
