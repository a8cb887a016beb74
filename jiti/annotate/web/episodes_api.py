"""Episodes for the page: the list with its queue, one with its clock and streams, its pictures, its events."""

from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, StreamingResponse
from starlette.routing import Route

from jiti.annotate.events import find_events
from jiti.annotate.folder import labels_version
from jiti.annotate.web.answers import endpoint
from jiti.annotate.web.labels_api import rows
from jiti.annotate.web.recording import needs_transcoding, stream_recording
from jiti.annotate.web.session import Session
from jiti.annotate.web.waiting import Progress, progress
from jiti.episodes.episode import Episode
from jiti.tasks.task import Task


def episode_routes(session: Session) -> list[Route]:
    """The routes under /api that read the source."""

    def about(_request: Request, _body: dict) -> dict[str, Any]:
        return {
            "source": session.reader.title,
            "labels": str(session.store.labels_dir),
            "annotator": session.annotator,
            "problems": [str(p) for p in session.reader.problems],
        }

    def version(request: Request, _body: dict) -> dict[str, Any]:
        episode_id = request.query_params.get("episode")
        problems = session.episode(episode_id).problems if episode_id else ()
        return {"version": labels_version(session.store.labels_dir), "problems": [str(p) for p in problems]}

    def episodes(_request: Request, _body: dict) -> dict[str, Any]:
        reached = progress(session.store.labels_dir, session.annotator)
        listing = []
        for ref in session.refs():
            listing.append(
                {
                    "episode_id": ref.episode_id,
                    "title": ref.title,
                    "task": ref.task,
                    "frame_count": ref.frame_count,
                    "problem": str(ref.problem) if ref.problem else None,
                    **asdict(reached.get(ref.episode_id, Progress())),
                }
            )
        return {"episodes": listing, "version": labels_version(session.store.labels_dir)}

    def episode(request: Request, _body: dict) -> dict[str, Any]:
        opened = session.episode(request.path_params["episode_id"], anew=True)  # it may have changed since
        task = session.task(opened)
        return {
            **describe(session, opened),
            "task": describe_task(task),
            "instruction": opened.task,
            **rows(session, opened.episode_id),
        }

    def events(request: Request, _body: dict) -> dict[str, Any]:
        return {"events": [asdict(event) for event in find_events(session.episode(request.path_params["episode_id"]))]}

    def recording(request: Request, _body: dict) -> Any:
        opened = session.episode(request.path_params["episode_id"])
        proxy = session.proxy(opened)
        if proxy is not None and proxy.done:
            return FileResponse(proxy.path, media_type="application/octet-stream")
        pieces = stream_recording(opened, session.recording_id(opened)) if proxy is None else proxy.read()
        return StreamingResponse(start(pieces), media_type="application/octet-stream")

    def proxy_state(request: Request, _body: dict) -> Any:
        opened = session.episode(request.path_params["episode_id"])
        proxy = session.proxy(opened)
        if proxy is None:
            return JSONResponse({"proxy": None})
        if not proxy.done:
            proxy.start()
        return {
            "proxy": {
                "done": proxy.done,
                "frames_done": proxy.frames_done,
                "frame_count": proxy.frame_count,
                "seconds_left": proxy.seconds_left,
                "error": str(proxy.error) if proxy.error else None,
            }
        }

    one = "/api/episodes/{episode_id}"
    return [
        Route("/api/about", endpoint(about)),
        Route("/api/version", endpoint(version)),
        Route("/api/episodes", endpoint(episodes)),
        Route(one, endpoint(episode)),
        Route(f"{one}/events", endpoint(events)),
        Route(f"{one}/recording.rrd", endpoint(recording)),
        Route(f"{one}/proxy", endpoint(proxy_state)),
    ]


def start(pieces: Iterator[bytes]) -> Iterator[bytes]:
    """Run until the first piece now, so that an error becomes an answer and not a cut connection."""
    first = next(pieces, b"")

    def rest() -> Iterator[bytes]:
        yield first
        yield from pieces

    return rest()


def describe(session: Session, episode: Episode) -> dict[str, Any]:
    """An episode's clock, streams and problems for the page. Times are nanoseconds from frame 0."""
    clock = episode.clock
    return {
        "episode_id": episode.episode_id,
        "title": session.ref(episode.episode_id).title,
        "recording_id": session.recording_id(episode),
        "frame_count": clock.frame_count,
        "rate_hz": clock.rate_hz,
        "reference": clock.reference,
        "display_ns": clock.display_ns.tolist(),
        "proxy_reason": needs_transcoding(episode, session.viewer_bytes),
        "streams": [
            {"name": s.name, "kind": s.kind, "count": s.count, "rate_hz": s.rate_hz, "encoding": s.encoding}
            for s in episode.streams.values()
        ],
        "problems": [str(p) for p in episode.problems],
    }


def describe_task(task: Task) -> dict[str, Any]:
    return {
        "task_id": task.task_id,
        "instruction": task.instruction,
        "itcs": [asdict(itc) for itc in task.itcs],
    }
