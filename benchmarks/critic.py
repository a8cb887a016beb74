"""What training a critic costs: updates a second, and features from the cache against LeRobotDataset.

    uv run python benchmarks/critic.py --json figures.json

Updates are of the default network at the paper's batch of 32 (supplement C.4), on random numbers of the sizes of
simulated recordings: 8 numbers of the robot and those of the scene, actions of 7. One update is Q, actor, temperature
and target network. A read of the cache is a batch of 32 random frames; its peer reads the same frames by
LeRobotDataset, of a dataset without pictures.
"""

import time
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from statistics import median

import numpy as np
from bench import Bench
from program import arguments, run
from report import Line, timed

from jiti.tasks.scene_state import scene_state_names

STATE = 8 + len(scene_state_names())
"""Numbers that are observed: LIBERO's proprioception and the scene."""
ACTION, BATCH = 7, 32
FASTER = 20.0
"""How much faster than LeRobotDataset the cache is to be."""


def measure(bench: Bench, dataset: Path | None) -> Iterator[Line]:
    yield from _updates(bench)
    yield from _reads(bench, dataset)


def _updates(bench: Bench) -> Iterator[Line]:
    import torch

    from jiti.critic.chunks import ActionRange
    from jiti.critic.critic import Sizes, make_critic
    from jiti.critic.settings import Settings
    from jiti.critic.step import Batch, draw_noise, init_state, train_step
    from jiti.critic.team import Team

    torch.set_num_threads(2)
    defaults = Settings()
    kinds = {
        "default": defaults,
        "alpha 0": replace(defaults, loss=replace(defaults.loss, alpha=0.0)),
        "public variant": replace(defaults, loss=replace(defaults.loss, variant="public")),
    }
    for name, settings in kinds.items():
        team, limits = Team("cpu"), ActionRange(-np.ones(ACTION), np.ones(ACTION))
        critic = make_critic(settings.network, Sizes(STATE, 1, ACTION), limits, {})
        state, k = init_state(critic, settings, team.device), settings.network.chunk
        all_there = torch.ones(BATCH, k, dtype=torch.bool)
        batch = Batch(
            torch.randn(BATCH, 1, STATE),
            torch.randn(BATCH, 1, STATE),
            torch.rand(BATCH, k, ACTION) * 2 - 1,
            all_there,
            all_there,
            torch.rand(BATCH),
            torch.full((BATCH,), 0.8),
            torch.rand(BATCH),
        )
        rates = []
        for attempt in range(bench.count(6, 3)):
            steps = bench.count(30, 5)
            begin = time.perf_counter()
            for step in range(steps):
                train_step(state, batch, draw_noise(settings, ACTION, step, team), settings, team)
            if attempt:  # the first warms up
                rates.append(steps / (time.perf_counter() - begin))
        yield _rates("updates", f"{name}: updates at batch {BATCH}", rates)


def _reads(bench: Bench, dataset: Path | None) -> Iterator[Line]:
    from lerobot.datasets.lerobot_dataset import LeRobotDataset
    from torch.utils.data import default_collate

    from jiti.critic.dataset import read_elegant
    from jiti.critic.features.cache import feature_cache

    if dataset is None:
        return
    data = read_elegant(dataset)
    peer = LeRobotDataset(dataset.name, root=dataset)
    with bench.folder() as folder:
        cache = feature_cache(data, "state", folder=folder)
        generator = np.random.default_rng(0)
        ours, theirs = [], []
        for _ in range(bench.count(20, 2)):
            frames = generator.integers(0, data.frames, BATCH)
            begin = time.perf_counter()
            default_collate([peer[int(frame)] for frame in frames])
            theirs.append(time.perf_counter() - begin)
            begin = time.perf_counter()
            cache.read(frames)
            ours.append(time.perf_counter() - begin)
    peer_s = median(theirs)
    yield timed("cache", f"peer: {BATCH} random frames of {data.frames} by LeRobotDataset, no pictures", theirs)
    yield timed("cache", f"{BATCH} random frames of the cache", ours, limit=1 / FASTER, peer=peer_s)


def _rates(bench: str, what: str, rates: list[float]) -> Line:
    return Line(bench, what, median(rates), "/s", len(rates), least=min(rates), most=max(rates))


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--dataset", type=Path, help="a dataset of `jiti curate`, whose features are read")
    asked = parser.parse_args()
    if asked.dataset:
        from jiti.critic.dataset import read_elegant

        if cameras := [name for name in read_elegant(asked.dataset).shapes if ".images." in name]:
            parser.error(f"--dataset {asked.dataset} has pictures, which the peer would decode: {', '.join(cameras)}.")
    run(asked, partial(measure, dataset=asked.dataset))


if __name__ == "__main__":
    main()
