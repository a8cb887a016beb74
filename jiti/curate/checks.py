"""Looking for mistakes in the labels of a whole source."""

from collections.abc import Callable, Iterator, Mapping

import numpy as np

from jiti.annotate.labels import Labels
from jiti.annotate.segment_file import Recording
from jiti.curate.near_identical import near_identical
from jiti.curate.returns import GAMMA, mc_returns
from jiti.curate.rewards import FrameRewards, rewards_of
from jiti.curate.rows import Rows
from jiti.curate.suspects import Suspect, ranked, suspect
from jiti.curate.verdicts import Spans, replaced, spans

CHUNK_FRAMES = 10
"""Length K of an action chunk, supplement C.4: a critic's sample does not fit into a shorter segment."""

FLIP_FRAMES = 5
"""Opposite verdicts this close are suspect. Our choice: a sixth of a second at 30 Hz; nothing is done again so soon."""

SURE_COUNT = 3
"""Segments from which on "never satisfied" is an error. Our choice: one or two may well all fail."""

NEVER_NEGATIVE_COUNT = 10
"""Segments from which on "never violated" is told. Our choice: fewer may well all pass."""

OUTLIER_DEVIATIONS = 5.0
"""Robust deviations from the median from which on a return is told. Our choice: few of a normal kind lie beyond."""

OUTLIER_EPISODES = 8
"""Episodes of a task from which on outliers are looked for. Our choice: fewer have no usual return."""


def find_suspects(
    labels: Labels,
    *,
    recordings: Mapping[str, Recording] | None = None,
    trajectories: Callable[[str], np.ndarray] | None = None,
    gamma: float = GAMMA,
    chunk_frames: int = CHUNK_FRAMES,
) -> list[Suspect]:
    """Everything that looks like a mistake, the worst first.

    `recordings` describes recordings as they are now, as far as they are known: lengths and fingerprints are compared
    with what was labelled. `trajectories` gives an episode's numbers (frames, size), to find near-identical ones with
    opposite verdicts; it is called for a bounded number of episodes and may raise JitiError.
    """
    known = labels.by_episode() | dict(recordings or {})
    rows = Rows.of(labels.segments)
    frame_counts = {name: about.frame_count for name, about in known.items()}
    verdicts = spans(labels.segments, frame_counts)
    found = [
        *_unreadable(labels),
        *_other_recordings(labels, recordings or {}),
        *_bounds(rows, frame_counts, chunk_frames),
        *_undecided(rows),
        *_one_sided(rows),
        *_flips(rows),
        *_disagreements(rows, verdicts),
        *_return_outliers(rows, rewards_of(verdicts, frame_counts), gamma),
    ]
    if trajectories is not None:
        found += near_identical(verdicts, trajectories)
    return ranked(found)


def _unreadable(labels: Labels) -> Iterator[Suspect]:
    for problem in labels.problems:
        yield suspect("unreadable_labels", "error", 1, f"{problem.where}: {problem.what}", problem.remedy)


def _other_recordings(labels: Labels, recordings: Mapping[str, Recording]) -> Iterator[Suspect]:
    """Labels of a recording that is not the one here, or not the one that others labelled."""
    names = ("annotator", "episode_id", "frame_count", "fingerprint")
    columns = [labels.recordings[name].to_pylist() for name in names]
    first: dict[str, tuple[str, str]] = {}
    for annotator, episode_id, frame_count, fingerprint in zip(*columns, strict=True):
        now = recordings.get(episode_id)
        before = first.setdefault(episode_id, (annotator, fingerprint))
        if now is not None and now.fingerprint != fingerprint:
            what = (
                f"the labels were made on a recording of {frame_count} frames with fingerprint {fingerprint[:8]}; "
                f"the one here has {now.frame_count} frames and fingerprint {now.fingerprint[:8]}"
            )
        elif now is None and before[1] != fingerprint:
            what = f"{annotator} and {before[0]} labelled different recordings under this name"
        else:
            continue
        remedy = (
            "Check that the segments still fit and say so with `jiti validate-rewards --confirm`, or restore the "
            "recording that was labelled."
        )
        yield suspect("other_recording", "error", 1, what, remedy, episode_id=episode_id, annotator=annotator)


def _bounds(rows: Rows, frame_counts: Mapping[str, int], chunk_frames: int) -> Iterator[Suspect]:
    """Segments outside their episode or shorter than a chunk."""
    accepted = rows.status == "accepted"
    counts = np.array([frame_counts.get(name, -1) for name in rows.episode_ids], np.int64)[rows.episode]
    for row in np.flatnonzero(accepted & (counts >= 0) & (rows.end >= counts)):
        outside = int(rows.end[row] - max(counts[row], rows.start[row]) + 1)
        yield suspect(
            "outside_episode",
            "error",
            outside / rows.length[row],
            f"frames {rows.start[row]} to {rows.end[row]}, but the episode has {counts[row]} frames",
            "Move its end into the episode, or remove it.",
            **rows.place(row) | {"start_frame": int(min(rows.start[row], max(0, counts[row] - 1)))},
        )
    for row in np.flatnonzero(accepted & (rows.length < chunk_frames)):
        yield suspect(
            "too_short",
            "error",
            1 - rows.length[row] / chunk_frames,
            f"{rows.length[row]} frames long, shorter than an action chunk of {chunk_frames}",
            f"Make it at least {chunk_frames} frames long, or remove it.",
            **rows.place(row),
        )


def _undecided(rows: Rows) -> Iterator[Suspect]:
    for row in np.flatnonzero((rows.status == "accepted") & (rows.reward < 0)):
        yield suspect(
            "undecided",
            "warning",
            rows.length[row] / 100,
            f"frames {rows.start[row]} to {rows.end[row]} have no verdict and give no reward",
            "Decide it, pass or fail, or remove it.",
            **rows.place(row),
        )


def _one_sided(rows: Rows) -> Iterator[Suspect]:
    """ITCs that are never satisfied, or never violated."""
    for itc, itc_id in enumerate(rows.itc_ids):
        decided = np.flatnonzero(rows.decided & (rows.itc == itc))
        passes = int((rows.reward[decided] == 1).sum())
        episodes = len(np.unique(rows.episode[decided]))
        where = f"all {len(decided)} segments in {episodes} {'episode' if episodes == 1 else 'episodes'}"
        if len(decided) and not passes:
            yield suspect(
                "never_positive",
                "error" if len(decided) >= SURE_COUNT else "warning",
                len(decided) / 20,
                f"{itc_id} is never satisfied: {where} are violated",
                "Look whether the verdicts are the wrong way round, or whether the ITC asks for too much.",
                **rows.place(decided[0]),
            )
        elif passes == len(decided) >= NEVER_NEGATIVE_COUNT:
            yield suspect(
                "never_negative",
                "warning",
                len(decided) / 100,
                f"{itc_id} is never violated: {where} are satisfied",
                "A critic learns nothing from it; look whether violations were left out.",
                **rows.place(decided[0]),
            )


def _flips(rows: Rows) -> Iterator[Suspect]:
    """Opposite verdicts of one annotator on one ITC, on the same frames or a few frames apart."""
    # To the last tie, so that the order of the rows changes nothing.
    order = np.lexsort((rows.reward, rows.end, rows.start, rows.lane))
    order = order[rows.decided[order]]
    lane, end, reward = rows.lane[order], rows.end[order], rows.reward[order]
    far = int(rows.end.max(initial=0)) + 1
    for verdict in (0, 1):
        # The latest end so far of an opposite verdict in the same lane, and whose it is.
        reach = np.where(reward != verdict, lane * far + end, -1)
        latest = np.maximum.accumulate(reach) if len(reach) else reach
        whose = np.maximum.accumulate(np.where(reach == latest, np.arange(len(order)), 0)) if len(order) else order
        gap = rows.start[order] - (latest - lane * far) - 1
        for here in np.flatnonzero((reward == verdict) & (latest >= lane * far) & (gap <= FLIP_FRAMES)):
            row, other = order[here], order[whose[here]]
            now, then = ("satisfied", "violated") if verdict else ("violated", "satisfied")
            if gap[here] < 0:
                frames = f"{rows.start[row]} to {min(rows.end[row], rows.end[other])}"
                yield suspect(
                    "contradiction",
                    "error",
                    -gap[here] / 25,
                    f"frames {frames} are both {then} and {now}",
                    "Move an edge so that the segments do not overlap, or remove one.",
                    **rows.place(row),
                )
            else:
                yield suspect(
                    "flip",
                    "warning",
                    1 - gap[here] / (FLIP_FRAMES + 1),
                    f"{then} until frame {rows.end[other]}, {now} from frame {rows.start[row]}",
                    "Look whether one of the two verdicts is a slip of a key.",
                    **rows.place(row),
                )


def _disagreements(rows: Rows, verdicts: Spans) -> Iterator[Suspect]:
    """ITCs on whose verdict annotators differ for the same frames, except on frames where it is settled."""
    disputed = np.flatnonzero((verdicts.passes > 0) & (verdicts.fails > 0) & ~verdicts.settled)
    if not len(disputed):
        return
    keys = verdicts.episode[disputed] * len(verdicts.itc_ids) + verdicts.itc[disputed]
    lanes = np.split(disputed, np.flatnonzero(np.diff(keys)) + 1)  # spans come by episode and ITC
    places = [(verdicts.episode_ids[verdicts.episode[s[0]]], verdicts.itc_ids[verdicts.itc[s[0]]]) for s in lanes]
    rows_of: dict[tuple[str, str], list[int]] = {place: [] for place in places}
    for row in np.flatnonzero(rows.decided & ~replaced(rows.table)).tolist():
        place = rows.episode_ids[rows.episode[row]], rows.itc_ids[rows.itc[row]]
        if place in rows_of:
            rows_of[place].append(row)
    for place, here in zip(places, lanes, strict=True):
        first = int(verdicts.start[here[0]])
        there = [row for row in rows_of[place] if rows.start[row] <= first <= rows.end[row]]
        against = {rows.annotators[rows.annotator[row]] for row in there if rows.reward[row] == 0}
        in_favour = sorted({rows.annotators[rows.annotator[row]] for row in there} - against)
        opposed = sorted(against)
        frames = int((verdicts.end[here] - verdicts.start[here] + 1).sum())
        yield suspect(
            "disagreement",
            "error",
            frames / 100,
            f"satisfied to {', '.join(in_favour)}, violated to {', '.join(opposed)}, over {frames} frames",
            "Settle it in the agreement view, or have one of them look again.",
            episode_id=place[0],
            annotator=" / ".join([*in_favour, *opposed]),
            itc_id=place[1],
            start_frame=first,
        )


def _return_outliers(rows: Rows, rewards: FrameRewards, gamma: float) -> Iterator[Suspect]:
    """Episodes whose highest return is far from what is usual for their task, among those with any."""
    returns = mc_returns(rewards.reward, rewards.offsets, gamma)
    filled = np.flatnonzero(np.diff(rewards.offsets))
    if not len(filled):
        return
    peak = np.zeros(len(rewards.episode_ids))
    peak[filled] = np.maximum.reduceat(returns, rewards.offsets[filled])
    place = {name: number for number, name in enumerate(rewards.episode_ids)}
    task_of: dict[int, str] = {}
    for episode_id, itc_id in rows.pairs():
        if episode_id in place:
            task_of.setdefault(place[episode_id], itc_id.rpartition("/")[0])
    tasks: dict[str, list[int]] = {}
    for episode, task_id in task_of.items():
        if peak[episode] > 0:
            tasks.setdefault(task_id, []).append(episode)
    for task_id, members in tasks.items():
        if len(members) < OUTLIER_EPISODES:
            continue
        values = peak[members]
        usual = float(np.median(values))
        # A tenth of the median at least: where all segments have one length, any other length would be an outlier.
        spread = max(1.4826 * float(np.median(np.abs(values - usual))), 0.1 * usual)
        for number in np.flatnonzero(np.abs(values - usual) > OUTLIER_DEVIATIONS * spread):
            episode_id = rewards.episode_ids[members[number]]
            away = abs(values[number] - usual) / spread
            yield suspect(
                "return_outlier",
                "warning",
                away / (4 * OUTLIER_DEVIATIONS),
                f"its highest return is {values[number]:.1f}, usual for {task_id} is {usual:.1f}",
                "Look whether a segment is too long, too short or marked twice.",
                episode_id=episode_id,
                start_frame=int(np.argmax(returns[rewards.frames(episode_id)])),
            )
