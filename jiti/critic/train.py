"""Training a critic: `init_state`, `train_step`, `save`, `load`, `train`.

A step is a function of the state, the data and the step's number: which chunks it takes and which noise it draws follow
from (seed, step). So a run that was stopped goes on exactly as if it had not been, and several processes that
share a batch do what one would.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch  # noqa: TID253  this module is imported late, by the command

import jiti
from jiti.critic.checkpoint import checkpoint_folder, drop_old, load, save
from jiti.critic.chunks import BatchOrder, action_range, cut_chunks, reaching_frames
from jiti.critic.critic import Critic, Sizes, make_critic, save_critic, saved_limits
from jiti.critic.dataset import ElegantData, read_elegant, spread, with_success_rewards
from jiti.critic.features.cache import FeatureCache, feature_cache
from jiti.critic.metrics import Metrics
from jiti.critic.ranking import decided_segments, rank, segment_scores, shuffled_rewards
from jiti.critic.resume import begun_run
from jiti.critic.settings import Settings
from jiti.critic.settings_file import settings_to
from jiti.critic.step import Batch, State, bellman_error, draw_noise, fit_to_data, init_state, to_batch, train_step
from jiti.critic.stop import asked_to_stop
from jiti.critic.team import Team
from jiti.errors import SourceError
from jiti.progress import Progress
from jiti.revision import git_revision

__all__ = ["Trained", "init_state", "load", "open_data", "save", "train", "train_step"]

FIT_FRAMES = 20_000
"""Frames that normalization is fitted to, at most. Our choice: means are exact to a hundredth of a deviation."""
LOOK_FRAMES = 512
"""Validation frames whose temporal-difference error is looked at, at most. Our choice: a second on two cores."""


@dataclass(frozen=True)
class Trained:
    """What a run came to."""

    run: Path
    step: int
    best: dict[str, float]
    """Of the step that is kept as `RUN/model.safetensors`: `auc`, `bellman`, `step`; without `auc` where validation has
    no task with both verdicts, and empty without validation."""
    stopped_early: bool
    steps: int = 0
    """Of this call; 0 where the run had come to its end before."""

    def __str__(self) -> str:
        why = ", where validation had not become better for a while" if self.stopped_early else ""
        kept = "kept"
        if self.best:
            known = (
                f"AUC {self.best['auc']:.2f} on validation"
                if "auc" in self.best
                else "by its Bellman error: no task of validation has verdicts of both kinds, so there is no AUC"
            )
            kept = f"step {self.best['step']:.0f} is kept, {known}"
        if not self.steps:
            return (
                f"{self.run} had come to step {self.step}{why}: {kept}. Nothing was done; more --steps go on there"
                f"{', and a larger run.patience' if self.stopped_early else ''}."
            )
        return f"Trained to step {self.step}{why}: {kept}. Next: jiti train-critic --evaluate {self.run}"


def train(
    dataset: Path,
    run: Path,
    settings: Settings,
    *,
    features_dir: Path | None = None,
    workers: int = 1,
    progress: Progress = lambda _share, _what: None,
    data: ElegantData | None = None,
) -> Trained:
    """Train a critic, or go on where `run` stands. `data` replaces what is read from `dataset`, for other splits.

    Raises SourceError for a dataset without labels, UsageError for a run that was made with other settings, data or
    features; KeyboardInterrupt after a signal to stop, once the step is done and kept.
    """
    team = Team(settings.run.device)
    team.check_batch(settings.run.batch)
    begun = begun_run(run, settings)
    data = open_data(data or read_elegant(dataset), settings)
    teaching, checking = data.of_split("train"), data.of_split("validation")
    _check(data, teaching, settings)
    cache = _features(data, settings, features_dir, workers, team, progress)

    about = _about(data, cache, settings)
    if begun:
        begun.check(about)

    torch.manual_seed(settings.run.seed)
    sizes = Sizes(cache.size, cache.tokens, data.action.shape[1])
    limits = saved_limits(begun.config) if begun else action_range(data, teaching)
    critic = make_critic(settings.network, sizes, limits, about)
    frames = data.frames_of(teaching)
    fit_to_data(critic, cache.read(spread(frames, FIT_FRAMES)), data.mc_return[frames])
    state = init_state(critic, settings, team.device)
    if begun:
        load(state, begun.folder)

    reaching = reaching_frames(data, frames, settings.network.chunk)
    order = BatchOrder(frames, reaching, settings.run.batch, settings.data.decided_share, settings.run.seed)
    looking = _Looking(data, cache, checking, settings, team)
    metrics = Metrics(run, state.step) if team.leads else None
    began_at, stopped = state.step, _enough(state, settings)

    def keep() -> None:
        if metrics:
            metrics.flush(state.step)
            save(state, checkpoint_folder(run, state.step))
            drop_old(run)

    try:
        with asked_to_stop() as asked:
            while state.step < settings.run.steps and not stopped:
                batch = _batch(data, cache, team.share(order.step(state.step)), critic, settings, team)
                noise = draw_noise(settings, sizes.action, state.step, team)
                told = train_step(state, batch, noise, settings, team)
                step = state.step
                if metrics and step % settings.run.log_every == 0:
                    metrics.add(step, {name: float(value) for name, value in told.items()})
                progress(step / settings.run.steps, f"step {step} of {settings.run.steps}")
                if step % settings.run.check_every == 0 or step == settings.run.steps:
                    seen, kept = looking.look(state)
                    stopped = _enough(state, settings)
                    if metrics:
                        metrics.add(step, {f"validation/{name}": value for name, value in seen.items()})
                        if kept:
                            save_critic(_kept(state, settings), run, {"step": step, "validation": seen})
                    keep()
                    team.wait()
                elif asked.to_stop:
                    keep()
                if asked.to_stop:
                    raise KeyboardInterrupt(f"step {step} is kept")
    finally:
        if metrics:
            metrics.close()
    early = stopped and state.step < settings.run.steps
    return Trained(run, state.step, state.best, early, state.step - began_at)


def open_data(data: ElegantData, settings: Settings) -> ElegantData:
    """The data with discount and rewards of the settings, and with verdicts dealt anew where they say so."""
    data = data.with_gamma(settings.data.gamma)
    if settings.data.rewards == "success":
        data = with_success_rewards(data)
    if settings.data.shuffle_labels:
        return data.with_rewards(shuffled_rewards(data, settings.run.seed), data.gamma)
    return data


def _kept(state: State, settings: Settings) -> Critic:
    """The critic that a run is for; see `RunSettings.keep`."""
    return replace(state.critic, q=state.target) if settings.run.keep == "target" else state.critic


class _Looking:
    """Looks at the validation split: ranking of decided segments, L_Bellman where that is unknown.

    Of steps that rank alike the last is kept, which learned most: their L_Bellman grows with the values learned.
    """

    def __init__(
        self, data: ElegantData, cache: FeatureCache, episodes: np.ndarray, settings: Settings, team: Team
    ) -> None:
        self._data, self._cache, self._settings, self._team = data, cache, settings, team
        self._segments = decided_segments(data, episodes)
        self._frames = spread(data.frames_of(episodes), LOOK_FRAMES)

    def look(self, state: State) -> tuple[dict[str, float], bool]:
        """What was seen, and whether the critic is to be kept, which is always so without a validation split."""
        if not len(self._frames):
            return {}, True
        critic = _kept(state, self._settings)
        ranking = rank(segment_scores(critic, self._data, self._cache, self._segments), self._segments)
        batch = _batch(self._data, self._cache, self._frames, critic, self._settings, self._team)
        error = bellman_error(state, batch, self._settings.loss)
        known = {} if np.isnan(ranking.average) else {"auc": ranking.average}
        seen = {**known, "bellman": error} | {f"auc/{k}": v for k, v in ranking.auc.items()}
        score, before = (said.get("auc", -said["bellman"]) for said in (seen, state.best or seen))
        better = not state.best or score > before
        kept = better or ("auc" in known and score == before)
        if kept:
            state.best = {**known, "bellman": error, "step": float(state.step)}
        state.looks_without_better = 0 if better else state.looks_without_better + 1
        return seen, kept


def _batch(
    data: ElegantData, cache: FeatureCache, frames: np.ndarray, critic: Critic, settings: Settings, team: Team
) -> Batch:
    chunks = cut_chunks(
        data,
        frames,
        chunk=settings.network.chunk,
        offset=settings.loss.td_offset,
        gamma=data.gamma,
        limits=critic.limits,
    )
    return to_batch(chunks, cache.read(frames), cache.read(chunks.next_frame), team.device)


def _features(
    data: ElegantData, settings: Settings, folder: Path | None, workers: int, team: Team, progress: Progress
) -> FeatureCache:
    """The leading process computes what is missing; the others read it."""

    def get(count: int) -> FeatureCache:
        device = str(team.device)
        return feature_cache(
            data, settings.data.features, folder=folder, device=device, workers=count, progress=progress
        )

    if team.leads:
        made = get(workers)
        team.wait()
        return made
    team.wait()
    return get(1)


def _check(data: ElegantData, episodes: np.ndarray, settings: Settings) -> None:
    if not len(episodes):
        raise SourceError(
            f"{data.root}: no labelled episode is in split train; there are "
            f"{int(data.labelled.sum())} labelled of {data.episodes} episodes. Run `jiti curate` with other splits."
        )
    kinds = {segment.elegant for segment in decided_segments(data, episodes)}
    # Of a sparse label that is no mistake: where all succeeded, it says how far the end is.
    if len(kinds) == 1 and settings.data.rewards == "segments":
        word = "satisfied" if kinds.pop() else "violated"
        raise SourceError(
            f"{data.root}: every decided segment of split train is {word}, so there is nothing to tell apart. "
            "Add demonstrations of the other kind with `jiti curate`."
        )


def _enough(state: State, settings: Settings) -> bool:
    return 0 < settings.run.patience <= state.looks_without_better


def _about(data: ElegantData, cache: FeatureCache, settings: Settings) -> dict[str, Any]:
    return {
        "settings": settings_to(settings),
        "extractor": {"name": cache.extractor, "fingerprint": cache.fingerprint},
        "dataset": {
            "path": str(data.root.resolve()),
            "fingerprint": data.fingerprint,
            "gamma": data.gamma,
            "fps": data.fps,
            "train": data.recordings_of("train"),
            "tasks": sorted({str(task) for task in data.task[data.of_split("train")]}),
        },
        "jiti": jiti.__version__,
        "git": git_revision(),
    }
