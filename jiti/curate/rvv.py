"""The Reward Validation Viewer's answers: the dataset at a glance, suspects, one episode, differences."""

import base64
import threading
from collections import OrderedDict
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from starlette.requests import Request
from starlette.responses import FileResponse, Response
from starlette.routing import BaseRoute, Mount, Route

from jiti.annotate.agreement import Agreement, compare
from jiti.annotate.folder import labels_version
from jiti.annotate.labels import Labels, read_labels
from jiti.annotate.names import ADJUDICATED, MACHINES
from jiti.annotate.segment_file import to_segments
from jiti.annotate.segments import Segment
from jiti.annotate.settling import Difference, settle
from jiti.annotate.settling import differences as differences_of
from jiti.annotate.web.answers import endpoint, take
from jiti.annotate.web.app import CachedFiles
from jiti.annotate.web.session import Session
from jiti.curate.glance import Glance, glance
from jiti.curate.returns import GAMMA, mc_returns
from jiti.curate.rewards import FrameRewards, frame_rewards
from jiti.curate.suspects import Suspect
from jiti.curate.validate import Trajectories, suspects_of
from jiti.errors import JitiError, LabelError, UsageError

STATIC = Path(__file__).parent / "static"
GLANCES = 8
"""Glances kept, one a gamma. Our choice: a slider goes back and forth."""


class Derived:
    """Rewards and returns of all episodes, derived anew when the labels change."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._lock = threading.Lock()
        self._version: str | None = None
        self._labels: Labels
        self._rewards: FrameRewards
        self._glances: OrderedDict[tuple[str, float], Glance] = OrderedDict()
        self._trajectories = Trajectories(session)
        self._compared: tuple[str, float, list[Suspect]] | None = None
        self._uncompared: tuple[str, float, list[Suspect]] | None = None
        self._comparing = threading.Lock()

    def current(self) -> tuple[str, Labels, FrameRewards]:
        """The labels' version, what they hold, and the rewards that follow."""
        with self._lock:
            version = labels_version(self._session.store.labels_dir)
            if version != self._version:
                self._labels = read_labels(self._session.store.labels_dir)
                self._rewards = frame_rewards(self._labels.segments, self._frame_counts())
                self._version = version
            return version, self._labels, self._rewards

    def glance(self, gamma: float) -> tuple[str, Labels, FrameRewards, Glance]:
        """As `current`, and how the returns of these rewards look, all of one version."""
        version, labels, rewards = self.current()
        with self._lock:
            key = (version, gamma)
            if key not in self._glances:
                self._glances[key] = glance(rewards, gamma)
                while len(self._glances) > GLANCES:
                    self._glances.popitem(last=False)
            return version, labels, rewards, self._glances[key]

    def read_ahead(self) -> None:
        """Begin `current` in a thread: reading 11,000 label files takes longer than the browser needs to ask."""

        def read() -> None:
            with suppress(JitiError):  # the first request says what is wrong
                self.current()

        threading.Thread(target=read, daemon=True).start()

    def suspects(self, gamma: float) -> tuple[list[Suspect], bool]:
        """Suspects, and whether that is all: trajectories are read and compared in a thread, which takes longer."""
        version, labels, _ = self.current()
        if self._compared is not None and self._compared[:2] == (version, gamma):
            return self._compared[2], True
        threading.Thread(target=self._compare, args=(version, labels, gamma), daemon=True).start()
        # The page asks again and again until all is compared.
        found = self._uncompared
        if found is None or found[:2] != (version, gamma):
            self._uncompared = found = (version, gamma, suspects_of(self._session, labels, gamma=gamma))
        return found[2], False

    def _compare(self, version: str, labels: Labels, gamma: float) -> None:
        if self._comparing.acquire(blocking=False):
            try:
                # Without trajectories stands until those with them are known, also when comparing fails.
                found = suspects_of(self._session, labels, gamma=gamma)
                try:
                    found = suspects_of(self._session, labels, gamma=gamma, trajectories=self._trajectories)
                finally:
                    self._compared = (version, gamma, found)
            finally:
                self._comparing.release()

    def agreement(self, a: str, b: str) -> tuple[Agreement, list[Segment]]:
        """Two annotators compared, and the rows that settle what they differ on. Raises LabelError."""
        _, labels, _ = self.current()
        settled = labels.segments.filter(pa.array(labels.segments["annotator"].to_numpy() == ADJUDICATED))
        return compare(labels.segments, self._frame_counts(), a, b), to_segments(settled)

    def _frame_counts(self) -> dict[str, int]:
        """Of every episode of the source, and of labelled ones that it no longer has; 1 where nobody knows yet."""
        known = {episode_id: recording.frame_count for episode_id, recording in self._labels.by_episode().items()}
        listed = {r.episode_id: r.frame_count or known.get(r.episode_id) or 1 for r in self._session.refs()}
        return {**listed, **{e: n for e, n in known.items() if e not in listed}}


def rvv_routes(session: Session) -> list[BaseRoute]:
    """The page at /rewards and what it asks for; served beside the annotator's own routes."""
    derived = Derived(session)
    derived.read_ahead()

    async def page(_request: Request) -> Response:
        return FileResponse(STATIC / "rvv.html")

    def overview(request: Request, _body: dict) -> dict[str, Any]:
        version, labels, rewards, seen = derived.glance(gamma_of(request))
        titles = {ref.episode_id: ref.title for ref in session.refs()}
        annotated = int(rewards.annotated.sum())
        return {
            "version": version,
            "bins": seen.bins,
            "return_max": seen.return_max,
            "states": base64.b64encode(seen.states.tobytes()).decode(),
            "returns": base64.b64encode(seen.returns.tobytes()).decode(),
            "episodes": [
                {"episode_id": e, "title": titles.get(e, e), "mean_return": m, "reward_share": s}
                for e, m, s in zip(
                    rewards.episode_ids, seen.mean_return.tolist(), seen.reward_share.tolist(), strict=True
                )
            ],
            "annotators": people(labels.segments),
            "problems": [str(p) for p in labels.problems],
            "totals": {
                "episodes": len(rewards.episode_ids),
                "labelled": int(np.count_nonzero(seen.annotated_share)),
                "segments": int((labels.segments["status"].to_numpy() == "accepted").sum()),
                "positive_share": float(rewards.reward.sum()) / annotated if annotated else 0.0,
            },
        }

    def suspects(request: Request, _body: dict) -> dict[str, Any]:
        found, complete = derived.suspects(gamma_of(request))
        return {"suspects": [s.to_json() for s in found], "complete": complete}

    def one(request: Request, _body: dict) -> dict[str, Any]:
        episode_id = request.path_params["episode_id"]
        _, labels, _ = derived.current()
        clock = session.episode(episode_id).clock
        rows = labels.segments.filter(pa.array(labels.segments["episode_id"].to_numpy() == episode_id))
        rewards = frame_rewards(rows, {episode_id: clock.frame_count})
        returns = mc_returns(rewards.reward, rewards.offsets, gamma_of(request))
        shown = ["annotator", "segment_id", "itc_id", "start_frame", "end_frame", "reward", "status", "source"]
        return {
            "frame_count": clock.frame_count,
            "reward": rewards.reward.tolist(),
            "annotated": rewards.annotated.tolist(),
            "mc_return": returns.tolist(),
            "segments": rows.select(shown).to_pylist(),
        }

    def differences(request: Request, _body: dict) -> dict[str, Any]:
        agreement, settled = derived.agreement(*(request.query_params.get(side, "") for side in ("a", "b")))
        open_ones = [d for d in differences_of(agreement, settled) if not d.settled]
        return {**agreement.to_json(), "differences": [d.to_json() for d in open_ones]}

    def settle_one(_request: Request, body: dict) -> dict[str, Any]:
        agreement, settled = derived.agreement(take(body, "a", str), take(body, "b", str))
        difference = find_difference(differences_of(agreement, settled), take(body, "segment_id", str))
        chosen = {"a": difference.a, "b": difference.b}
        side = take(body, "side", str)
        if side not in chosen:
            raise LabelError(f"side is {side!r}; it must be a or b.")
        episode_id = difference.segments[0].episode_id
        partition = session.partition(episode_id, ADJUDICATED)
        put, remove = settle(agreement, difference, chosen[side], partition.segments)
        partition.apply(f"settle: {body[side]}", put, remove, based_on=partition.version)
        return {"version": labels_version(session.store.labels_dir)}

    return [
        Route("/rewards", page),
        Mount("/rewards/static", CachedFiles(directory=STATIC)),
        Route("/api/rewards", endpoint(overview)),
        Route("/api/rewards/suspects", endpoint(suspects)),
        Route("/api/rewards/episodes/{episode_id}", endpoint(one)),
        Route("/api/rewards/differences", endpoint(differences)),
        Route("/api/rewards/settle", endpoint(settle_one), methods=["POST"]),
    ]


def gamma_of(request: Request) -> float:
    """The discount that a request asks for; the default without one. Raises UsageError for one outside 0 to 1."""
    given = request.query_params.get("gamma", str(GAMMA))
    try:
        gamma = float(given)
    except ValueError:
        gamma = -1.0
    if not 0 <= gamma <= 1:
        raise UsageError(f"gamma is {given!r}; it must be a number from 0 to 1.")
    return gamma


def people(segments: pa.Table) -> list[str]:
    """Annotators that can be compared: everyone but machines and what was settled."""
    return sorted(set(segments["annotator"].to_pylist()) - {*MACHINES, ADJUDICATED})


def find_difference(differences: list[Difference], segment_id: str) -> Difference:
    """The difference about a segment. Raises LabelError when there is none any more."""
    for difference in differences:
        if segment_id in {segment.segment_id for segment in difference.segments}:
            return difference
    raise LabelError(f"no difference about segment {segment_id} is left; someone has changed it.")
