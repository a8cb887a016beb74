"""Episodes that went nearly the same way and were judged the opposite way."""

from collections.abc import Callable, Iterator

import numpy as np

from jiti.curate.suspects import Suspect, suspect
from jiti.curate.verdicts import Spans
from jiti.errors import JitiError

POINTS = 32
"""Points that a trajectory is resampled to, evenly in time. Our choice: a pick of 10 s still shows its turns."""

NEAR = 0.1
"""Root-mean-square distance, in standard deviations, below which two count as near-identical. Our choice."""

MAX_EPISODES = 2000
"""Trajectories that are read. Our choice: reading is what takes time, some milliseconds each."""

_ROWS = 512
"""Episodes whose distances to all others are computed at once: 512 x 10,000 x 8 bytes is 40 MB."""


def near_identical(
    verdicts: Spans, trajectories: Callable[[str], np.ndarray], *, max_episodes: int = MAX_EPISODES
) -> Iterator[Suspect]:
    """For each violated episode, the nearest satisfied one of the same ITC, where it is near.

    An episode violates an ITC where any frame does. Of more than `max_episodes` that could be compared, so many are
    taken at random, the same ones each time.
    """
    itcs = max(1, len(verdicts.itc_ids))
    lanes, first = np.unique(verdicts.episode * itcs + verdicts.itc, return_index=True)
    passed = np.minimum.reduceat(verdicts.verdict, first) if len(first) else np.empty(0, np.int8)
    groups = []
    for itc in range(len(verdicts.itc_ids)):
        here = lanes % itcs == itc
        if 0 < passed[here].sum() < here.sum():
            groups.append((itc, lanes[here] // itcs, passed[here] == 1))
    wanted = np.unique(np.concatenate([np.empty(0, np.int64), *(episodes for _, episodes, _ in groups)]))
    if len(wanted) > max_episodes:
        wanted = np.sort(np.random.default_rng(0).choice(wanted, max_episodes, replace=False))
    known: dict[int, np.ndarray] = {}
    for episode in wanted:
        name = verdicts.episode_ids[episode]
        try:
            known[int(episode)] = _resampled(trajectories(name))
        except JitiError as error:
            remedy = "It is left out of the search for near-identical episodes; `jiti inspect` says more."
            yield suspect("unreadable_recording", "warning", 0, str(error), remedy, episode_id=name)
    for itc, episodes, satisfied in groups:
        yield from _of_itc(verdicts, itc, episodes, satisfied, known)


def _of_itc(
    verdicts: Spans, itc: int, episodes: np.ndarray, satisfied: np.ndarray, known: dict[int, np.ndarray]
) -> Iterator[Suspect]:
    there = np.array([episode in known for episode in episodes.tolist()])
    shapes = {known[episode].shape for episode in episodes[there].tolist()}
    for shape in sorted(shapes):  # recordings of different robots are not compared
        of_shape = there & np.array(
            [episode in known and known[episode].shape == shape for episode in episodes.tolist()]
        )
        points = np.stack([known[episode] for episode in episodes[of_shape].tolist()])
        good, bad = episodes[of_shape & satisfied], episodes[of_shape & ~satisfied]
        spread = points.std((0, 1))
        points = (points[..., spread > 0] / spread[spread > 0]).reshape(len(points), -1)
        if not (len(good) and len(bad) and points.shape[1]):
            continue
        points /= np.sqrt(points.shape[1])
        is_good = satisfied[of_shape]
        nearest, distance = _nearest(points[~is_good], points[is_good])
        for number in np.flatnonzero(distance < NEAR):
            episode, other = bad[number], good[nearest[number]]
            failed = (verdicts.episode == episode) & (verdicts.itc == itc) & (verdicts.verdict == 0)
            yield suspect(
                "near_identical",
                "warning",
                1 - distance[number] / NEAR,
                f"violated here, satisfied in {verdicts.episode_ids[other]}, which went nearly the same way",
                "Compare the two and look whether one verdict is wrong.",
                episode_id=verdicts.episode_ids[episode],
                itc_id=verdicts.itc_ids[itc],
                start_frame=int(verdicts.start[np.flatnonzero(failed)[0]]),
            )


def _resampled(trajectory: np.ndarray) -> np.ndarray:
    """(POINTS, size) from (frames, size) by linear interpolation; gaps count as 0."""
    values = np.nan_to_num(np.asarray(trajectory, np.float64), nan=0.0, posinf=0.0, neginf=0.0)
    if values.ndim != 2 or not values.size:
        return np.zeros((POINTS, 0))
    place = np.linspace(0, len(values) - 1, POINTS)
    before = np.floor(place).astype(np.int64)
    after = np.minimum(before + 1, len(values) - 1)
    share = (place - before)[:, None]
    return (1 - share) * values[before] + share * values[after]


def _nearest(of: np.ndarray, among: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """For each row the place of the nearest other, and how far it is."""
    places, distances = [], []
    squares = (among**2).sum(1)
    for first in range(0, len(of), _ROWS):
        rows = of[first : first + _ROWS]
        nearest = np.argmin(squares - 2 * rows @ among.T, axis=1)
        places.append(nearest)
        distances.append(np.sqrt(((rows - among[nearest]) ** 2).sum(1)))
    return np.concatenate(places), np.concatenate(distances)
