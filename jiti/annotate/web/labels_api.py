"""Labels for the page: an annotator's rows on an episode, edits, undo and redo, decisions on proposals."""

from dataclasses import replace
from typing import Any

from starlette.requests import Request
from starlette.routing import Route

from jiti.annotate.partition import Partition, View
from jiti.annotate.proposals import accept, edit, reject
from jiti.annotate.segments import Segment, new_segment_id
from jiti.annotate.web.answers import endpoint, take, take_texts
from jiti.annotate.web.session import Session
from jiti.annotate.web.waiting import waiting
from jiti.episodes.clock import Clock
from jiti.errors import LabelError
from jiti.tasks.task import Task


def label_routes(session: Session) -> list[Route]:
    """The routes under /api that write labels; each answers when the write is durable."""

    def current(request: Request, _body: dict) -> dict[str, Any]:
        return rows(session, request.path_params["episode_id"])

    def edits(request: Request, body: dict) -> dict[str, Any]:
        episode_id = request.path_params["episode_id"]
        episode = session.episode(episode_id)
        partition = session.partition(episode_id)
        mine = {s.segment_id: s for s in partition.segments}
        task = session.task(episode)
        put = [row_of(fields, mine, episode_id, episode.clock, task) for fields in take(body, "put", list, [])]
        remove, action, based_on = take_texts(body, "remove"), take(body, "action", str), take(body, "based_on", int)
        known = partition.view
        partition.apply(action, put, remove, based_on=based_on)
        return changes(session, episode_id, known, based_on)

    def undo(request: Request, body: dict) -> dict[str, Any]:
        episode_id, based_on = request.path_params["episode_id"], take(body, "based_on", int)
        partition = session.partition(episode_id)
        known = partition.view
        partition.undo(based_on=based_on)
        return changes(session, episode_id, known, based_on)

    def redo(request: Request, body: dict) -> dict[str, Any]:
        episode_id, based_on = request.path_params["episode_id"], take(body, "based_on", int)
        partition = session.partition(episode_id)
        known = partition.view
        partition.redo(based_on=based_on)
        return changes(session, episode_id, known, based_on)

    def decide(request: Request, body: dict) -> dict[str, Any]:
        episode_id, segment_id = request.path_params["episode_id"], request.path_params["segment_id"]
        partition = session.partition(episode_id)
        proposals = {p.segment_id: p for p in waiting(session.store.labels_dir, partition)}
        if segment_id not in proposals:
            raise LabelError(f"no proposal {segment_id} waits for {session.annotator} in {episode_id}.")
        decision, proposal = take(body, "decision", str), proposals[segment_id]
        if decision == "accept":
            row = accept(proposal)
        elif decision == "reject":
            row = reject(proposal)
        elif decision == "edit":
            row = edit(proposal, reward=body.get("reward", proposal.reward))
        else:
            raise LabelError(f"decision is {decision!r}; it must be accept, edit or reject.")
        row = replace(row, segment_id=take(body, "segment_id", str, None) or row.segment_id)
        known, based_on = partition.view, take(body, "based_on", int)
        partition.apply(f"{decision} proposal", [row], [], based_on=based_on)
        return {**changes(session, episode_id, known, based_on), "segment_id": row.segment_id}

    one = "/api/episodes/{episode_id}"
    return [
        Route(f"{one}/rows", endpoint(current)),
        Route(f"{one}/edits", endpoint(edits), methods=["POST"]),
        Route(f"{one}/undo", endpoint(undo), methods=["POST"]),
        Route(f"{one}/redo", endpoint(redo), methods=["POST"]),
        Route(f"{one}/proposals/{{segment_id}}", endpoint(decide), methods=["POST"]),
    ]


def rows(session: Session, episode_id: str) -> dict[str, Any]:
    """What the page shows of an episode's labels: own rows, waiting proposals, version, what can be undone."""
    partition = session.partition(episode_id)
    view = partition.view  # all of one moment, whoever saves meanwhile
    return {"segments": [s.to_row() for s in view.segments], **_beside_rows(session, partition, view)}


def changes(session: Session, episode_id: str, known: View, based_on: int) -> dict[str, Any]:
    """As `rows`, to a page that knows version `based_on`: only rows that are new or `changed`, and `removed` ids.

    An answer with all of 500 rows took longer than to make the edit durable. Where `known` is of another version, all
    rows go.
    """
    if known.version != based_on:
        return rows(session, episode_id)
    partition = session.partition(episode_id)
    view = partition.view
    before = {s.segment_id: s for s in known.segments}
    changed = [s for s in view.segments if before.pop(s.segment_id, None) is not s]
    return {
        "changed": [s.to_row() for s in changed],
        "removed": [*before],
        **_beside_rows(session, partition, view),
    }


def _beside_rows(session: Session, partition: Partition, view: View) -> dict[str, Any]:
    return {
        "version": view.version,
        "proposals": [p.to_row() for p in waiting(session.store.labels_dir, partition)],
        "can_undo": view.can_undo,
        "can_redo": view.can_redo,
        "label_problems": [str(p) for p in partition.problems],
    }


def row_of(fields: Any, mine: dict[str, Segment], episode_id: str, clock: Clock, task: Task) -> Segment:
    """The row that an edit asks for. The page names frames, ITC, verdict and note; the rest is worked out here.

    Raises LabelError for frames outside the episode or an ITC that the task does not have.
    """
    if not isinstance(fields, dict):
        raise LabelError(f"a segment is {fields!r}; it must be an object.")
    start, end = take(fields, "start_frame", int), take(fields, "end_frame", int)
    if not 0 <= start <= end < clock.frame_count:
        raise LabelError(
            f"a segment from frame {start} to {end} does not fit: {episode_id} has frames 0 to {clock.frame_count - 1}."
        )
    segment_id = take(fields, "segment_id", str, None)
    old = mine.get(segment_id or "")
    itc_id = take(fields, "itc_id", str)
    criteria = {itc.itc_id: str(itc.criterion) for itc in task.itcs}
    if old is not None and old.itc_id == itc_id:
        criteria.setdefault(itc_id, old.criterion)
    if itc_id not in criteria:
        raise LabelError(f"{task.task_id} has no ITC {itc_id!r}; it has: {', '.join(criteria)}.")
    given = {"reward": fields.get("reward"), "rationale": take(fields, "rationale", str, None)}
    return Segment(
        segment_id=segment_id or new_segment_id(),
        episode_id=episode_id,
        itc_id=itc_id,
        criterion=criteria[itc_id],
        start_frame=start,
        end_frame=end,
        start_ns=int(clock.frame_ns[start]),
        end_ns=int(clock.frame_ns[end]),
        status=old.status if old else "accepted",
        source="human",
        confidence=None,
        parent_id=old.parent_id if old else None,
        **given,
    )
