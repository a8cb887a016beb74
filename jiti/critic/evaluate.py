"""`jiti train-critic --evaluate RUN`: how a critic does on episodes that it did not learn from.

Written into `RUN/evaluation`: `evaluation.json`, `calibration.png`, and `q-<episode>.rrd` for Rerun.
"""

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch  # noqa: TID253  imported late, by the command

from jiti.critic.calibration import Calibration, calibration, plot_calibration
from jiti.critic.chunks import cut_chunks
from jiti.critic.critic import Critic, load_critic
from jiti.critic.dataset import ALL, SPLITS, ElegantData, read_elegant, spread
from jiti.critic.features.cache import FeatureCache, feature_cache
from jiti.critic.q_recording import write_q_recording
from jiti.critic.ranking import (
    BATCH,
    Decided,
    Ranking,
    check_sizes,
    chunk_values,
    decided_segments,
    frames_scored,
    member_values,
    rank,
    recorded_values,
    segment_scores,
)
from jiti.critic.settings import Settings
from jiti.critic.settings_file import settings_from
from jiti.critic.team import usable_device
from jiti.durable import make_folder, write_atomic
from jiti.episodes.lerobot_index import episode_id_of
from jiti.episodes.reader import open_reader
from jiti.errors import UsageError
from jiti.nearest import nearest
from jiti.progress import Progress

LEADS = (0, 10, 20, 40)
"""Frames before the decided segment at which segments are ranked too. Our choice: a chunk, and 1 and 2 s at 20 Hz.
What is decided is mostly not to be seen there: ranks that stay high come from how an episode was done until then."""
FEW_PAIRS = 100
"""Pairs of a satisfied and a violated segment under which a task's AUC is called coarse. Our choice: hundredths."""
SHOWN = 2
"""Episodes shown in Rerun unless some are named. Our choice: one of each verdict."""
BOUND_FRAMES = 2048
"""Frames whose policy chunks are valued for the share of active bounds, at most. Our choice: seconds on two cores."""


@dataclass(frozen=True)
class Evaluation:
    """What was found, and where it was written."""

    folder: Path
    split: str
    episodes: int
    rankings: dict[int, Ranking]
    """By frames before the segment."""
    swapped: Ranking
    """With the chunks of another episode of the same task in place of what was done: what states alone tell. Without
    the tasks that have one episode only."""
    calibration: Calibration
    bound_active: dict[str, float]
    """Share of frames whose mean policy value is under V^mu, by split."""
    fps: float

    def __str__(self) -> str:
        decided = self.rankings[0]
        lines = [f"{self.episodes} episodes of split {self.split}; AUC of Q of what was done, satisfied over violated:"]
        for task, (good, bad) in decided.counts.items():
            auc = f"{decided.auc[task]:.2f}" if task in decided.auc else "   -"
            lines.append(f"  {auc}  {task} ({good} satisfied, {bad} violated)")
        lines.append(f"  {decided.average:.2f}  average of {len(decided.auc)} tasks, at the decided segment")
        pairs = [good * bad for good, bad in decided.counts.values() if good and bad]
        if pairs and min(pairs) < FEW_PAIRS:
            lines.append(f"        few episodes: one pair that swaps moves a task by {1 / min(pairs):.2f}")
        for lead in LEADS[1:]:
            lines.append(f"  {self.rankings[lead].average:.2f}  {lead} frames ({lead / self.fps:.1f} s) earlier")
        lines.append(f"  {self.swapped.average:.2f}  with the chunks of another episode: what states alone tell")
        found = self.calibration
        lines.append(
            f"Q less the Monte-Carlo return: {found.bias:+.2f} on average, {found.rmse:.2f} root mean square, "
            f"correlation {found.correlation:.2f} ({found.frames} frames)."
        )
        shares = ", ".join(f"{share:.0%} ({split})" for split, share in self.bound_active.items())
        lines.append(f"The bound by the return is active for {shares}.")
        lines.append(f"Wrote {self.folder}: evaluation.json, calibration.png, and episodes for `rerun`.")
        return "\n".join(lines)


def evaluate(
    run: Path,
    dataset: Path | None = None,
    *,
    split: str = "test",
    episodes: Sequence[int] = (),
    features_dir: Path | None = None,
    workers: int = 1,
    progress: Progress = lambda _share, _what: None,
) -> Evaluation:
    """Evaluate the critic of a run on a split of its dataset, or of another; `episodes` are shown in Rerun.

    Labels are those of the dataset, also for a run that learned from labels dealt anew; the discount is the run's. The
    run's device is used. Raises SourceError, and UsageError where a split that should be held out was learned from.
    """
    if split not in (*SPLITS, ALL):
        raise UsageError(f"there is no --split {split}; {nearest(split, (*SPLITS, ALL))}.")
    critic = load_critic(run)
    settings = settings_from(critic.config["settings"])
    device = _device(critic, settings)
    data = _data(critic, dataset)
    held_out = data.of_split(split)
    _check_held_out(critic, data, split)
    segments = decided_segments(data, held_out)
    if not segments:
        have = ", ".join(f"{name} ({len(data.of_split(name))})" for name in SPLITS)
        raise UsageError(f"--split {split} has no labelled episode in {data.root}. There are: {have}, and {ALL}.")
    cache = feature_cache(
        data, settings.data.features, folder=features_dir, device=device, workers=workers, progress=progress
    )
    check_sizes(critic, data, cache, "Evaluate it on a dataset of the same robot and features.")

    progress(0.1, "ranking")
    rankings = {k: rank(segment_scores(critic, data, cache, segments, earlier=k), segments) for k in LEADS}
    swapped = swapped_ranking(critic, data, cache, segments, settings.run.seed)
    progress(0.4, "calibration")
    frames = data.frames_of(held_out)
    q = recorded_values(critic, data, cache, frames)
    found = calibration(q, data.mc_return[frames])
    active = {
        name: bound_active(critic, data, cache, data.frames_of(data.of_split(name)), settings)
        for name in dict.fromkeys(("train", split))
        if len(data.of_split(name))
    }
    folder = run / "evaluation"
    make_folder(folder)
    done = Evaluation(folder, split, len(held_out), rankings, swapped, found, active, data.fps)
    plot_calibration(
        found, q, data.mc_return[frames], f"{run.name}: {len(held_out)} episodes of {split}", folder / "calibration.png"
    )
    shown = list(episodes) or _one_of_each(segments)
    for number, episode in enumerate(shown):
        progress(0.6 + 0.4 * number / len(shown), f"episode {episode} for Rerun")
        show_episode(critic, data, cache, episode, folder)
    write_atomic(folder / "evaluation.json", json.dumps(to_json(done), indent=2).encode())
    return done


def swapped_ranking(
    critic: Critic, data: ElegantData, cache: FeatureCache, segments: Sequence[Decided], seed: int
) -> Ranking:
    """The ranking of segments whose chunks are taken from a segment of another episode, at the same place in it."""
    pairs = swapped_pairs(segments, seed)
    scores = np.zeros(len(pairs))
    for number, (here, other) in enumerate(pairs):
        states, acts = (frames_scored(data, segment, critic.chunk) for segment in (here, other))
        acts = acts[np.minimum(np.arange(len(states)), len(acts) - 1)]
        chunks = cut_chunks(data, acts, chunk=critic.chunk, offset=1, gamma=data.gamma, limits=critic.limits)
        scores[number] = chunk_values(critic, cache, states, chunks.action, chunks.mask).min(0).mean()
    return rank(scores, [here for here, _ in pairs])


def swapped_pairs(segments: Sequence[Decided], seed: int) -> list[tuple[Decided, Decided]]:
    """Each segment with one of another episode of its task; none of tasks that have one episode only."""
    generator = np.random.default_rng(seed)
    pairs = []
    for task in sorted({segment.task for segment in segments}):
        by_episode: dict[int, list[Decided]] = {}
        for segment in segments:
            if segment.task == task:
                by_episode.setdefault(segment.episode, []).append(segment)
        order = generator.permutation(list(by_episode)).tolist()
        if len(order) == 1:
            continue
        for here, other in zip(order, [order[-1], *order[:-1]], strict=True):  # one cycle: no episode keeps its own
            theirs = by_episode[other]
            pairs += [(segment, theirs[n % len(theirs)]) for n, segment in enumerate(by_episode[here])]
    return pairs


@torch.no_grad()
def bound_active(
    critic: Critic, data: ElegantData, cache: FeatureCache, frames: np.ndarray, settings: Settings
) -> float:
    """The share of frames where the mean value of the actor's chunks, over members and chunks, is under V^mu."""
    frames = spread(frames, BOUND_FRAMES)
    generator = torch.Generator().manual_seed(settings.run.seed)
    device = critic.q.scale.device
    under = []
    for begin in range(0, len(frames), BATCH):
        part = frames[begin : begin + BATCH]
        chunks = cut_chunks(data, part, chunk=critic.chunk, offset=1, gamma=data.gamma, limits=critic.limits)
        features, mask = cache.read(part).to(device), torch.from_numpy(chunks.mask).to(device)
        shape = (len(part), settings.loss.policy_chunks, critic.chunk, critic.sizes.action)
        drawn, _ = critic.actor.sample(features, mask, torch.randn(shape, generator=generator).to(device))
        expected = critic.q(features, drawn, mask).mean(-1).cpu().numpy()
        under.append((expected < chunks.mc_return).mean(0))
    return float(np.concatenate(under).mean())


def show_episode(critic: Critic, data: ElegantData, cache: FeatureCache, episode: int, folder: Path) -> Path:
    """Write `q-<episode>.rrd`. Raises UsageError for an episode that is not there."""
    if not 0 <= episode < data.episodes:
        raise UsageError(f"--episode {episode}: {data.root} has episodes 0 to {data.episodes - 1}.")
    reader = open_reader(data.root)
    name = episode_id_of(episode)
    frames = data.frames_of(np.array([episode]))
    q = member_values(critic, data, cache, frames)
    path = folder / f"q-{name}.rrd"
    write_q_recording(
        path,
        reader.open(name),
        q,
        data.mc_return[frames],
        data.reward[frames],
        data.annotated[frames],
    )
    return path


def _device(critic: Critic, settings: Settings) -> str:
    """The run's device, to which the critic is moved; where that is not here, the one that there is."""
    try:
        device = usable_device(settings.run.device)
    except UsageError:
        device = usable_device("auto")
    critic.q.to(device)
    critic.actor.to(device)
    return str(device)


def _data(critic: Critic, dataset: Path | None) -> ElegantData:
    trained_on = critic.config["dataset"]
    root = dataset or Path(trained_on["path"])
    if not root.exists():
        raise UsageError(
            f"{root}, which the critic was trained on, is not there. Name it: jiti train-critic DATASET --evaluate RUN."
        )
    return read_elegant(root).with_gamma(trained_on["gamma"])


def _check_held_out(critic: Critic, data: ElegantData, split: str) -> None:
    """Raises UsageError for a split with episodes that the critic learned from, unless it is asked for as such."""
    learned = set(critic.config["dataset"].get("train", ()))
    seen = [name for name in data.recordings_of(split) if name in learned]
    if seen and split != "train":
        raise UsageError(
            f"--split {split} of {data.root} has {len(seen)} episodes that the critic learned from, the first "
            f"{seen[0].split()[0]}: it was split otherwise then. Evaluate on the dataset of that time, or train again; "
            "--split train says how a critic does on what it learned from."
        )


def _one_of_each(segments: Sequence[Decided]) -> list[int]:
    found = {segment.elegant: segment.episode for segment in reversed(segments)}
    return sorted(set(found.values()))[:SHOWN]


def to_json(found: Evaluation) -> dict[str, Any]:
    """As `evaluation.json` has it."""
    return _finite(
        {
            "split": found.split,
            "episodes": found.episodes,
            "auc": {f"{lead} frames before": _ranking_json(r) for lead, r in found.rankings.items()},
            "auc_with_chunks_swapped": _ranking_json(found.swapped),
            "calibration": asdict(found.calibration),
            "bound_active": found.bound_active,
        }
    )


def _ranking_json(ranking: Ranking) -> dict[str, Any]:
    counts = {task: {"satisfied": good, "violated": bad} for task, (good, bad) in ranking.counts.items()}
    return {"average": ranking.average, "tasks": ranking.auc, "segments": counts}


def _finite(value: Any) -> Any:
    """JSON has no NaN."""
    if isinstance(value, dict):
        return {key: _finite(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [_finite(inner) for inner in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
