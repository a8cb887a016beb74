"""The page beside a rollout on an arm: Space stops from there too, and an episode is judged with its pictures at hand.

Served by a thread of the program that drives the arm, on loopback, with a token, as the annotator is.
"""

import secrets
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from threading import Lock, Thread
from typing import Any, Self

import uvicorn
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import FileResponse, Response
from starlette.routing import Mount, Route

from jiti.annotate.web.answers import answer_error, endpoint, take
from jiti.annotate.web.app import STATIC as SHARED
from jiti.annotate.web.app import CachedFiles
from jiti.annotate.web.security import Guard, new_token
from jiti.annotate.web.serve import HOST, bind
from jiti.errors import JitiError, SourceError
from jiti.runtime.robot.page.pictures import Pictures
from jiti.runtime.robot.panel import KEY_NAMES, Shown
from jiti.runtime.robot.stops import STOP

STATIC = Path(__file__).parent / "static"
END_S = 2.0
"""In which the server is to end. Our choice: an arm's program does not wait for a browser."""


class Page:
    """At `url` from `with` on."""

    def __init__(self, press: Callable[[str], None]) -> None:
        """`press` is told of keys, in a thread of the server."""
        self._press, self._shown, self._version = press, Shown("opening", "Opening."), 0
        self._pictures: Pictures | None = None
        self._lock, self._reading = Lock(), Lock()
        self._listener = bind(0)
        port, token = self._listener.getsockname()[1], new_token()
        self.url = f"http://{HOST}:{port}/?token={token}"
        config = uvicorn.Config(
            self._app(token, port), log_level="error", access_log=False, timeout_graceful_shutdown=1
        )
        self._server = uvicorn.Server(config)
        self._thread = Thread(target=self._server.run, kwargs={"sockets": [self._listener]}, name="page", daemon=True)
        self._run = secrets.token_hex(4)

    def show(self, shown: Shown) -> None:
        """From any thread."""
        with self._lock:
            self._shown, self._version = shown, self._version + 1

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._server.should_exit = True
        self._thread.join(END_S)
        self._listener.close()

    def _app(self, token: str, port: int) -> Starlette:
        async def page(_request: Request) -> Response:
            return FileResponse(STATIC / "arm.html")

        return Starlette(
            routes=[
                Route("/", page),
                Route("/api/shown", endpoint(self._tell)),
                Route("/api/key", endpoint(self._key), methods=["POST"]),
                Route("/api/pictures", endpoint(self._cameras)),
                Route("/api/pictures/{camera}/{number:int}", endpoint(self._picture)),
                Mount("/static", CachedFiles(directory=STATIC)),
                Mount("/shared", CachedFiles(directory=SHARED)),
            ],
            middleware=[Middleware(Guard, token=token, port=port)],
            exception_handlers={JitiError: answer_error},
        )

    def _tell(self, _request: Request, _body: dict[str, Any]) -> dict[str, Any]:
        with self._lock:
            shown, version = self._shown, self._version
        keys = [[key, KEY_NAMES.get(key, key), does] for key, does in {**shown.keys, STOP: "Stop"}.items()]
        about = asdict(shown) | {"keys": keys, "recording": shown.recording and shown.recording.name}
        return about | {"version": f"{self._run}-{version}"}

    def _key(self, _request: Request, body: dict[str, Any]) -> dict[str, Any]:
        """A key for what the page has shown: one that comes later than the next question answers nothing. Space always
        counts."""
        key, version = take(body, "key", str), take(body, "version", str, "")
        if key == STOP:
            self._press(key)
            return {"counts": True}
        with self._lock:  # no other question is shown in between
            counts = version == f"{self._run}-{self._version}" and key in self._shown.keys
            if counts:
                self._press(key)
        return {"counts": counts}

    def _cameras(self, _request: Request, _body: dict[str, Any]) -> dict[str, Any]:
        return {"cameras": self._of_shown().counts()}

    def _picture(self, request: Request, _body: dict[str, Any]) -> Response:
        data = self._of_shown().picture(request.path_params["camera"], request.path_params["number"])
        return Response(data, media_type="image/jpeg")

    def _of_shown(self) -> Pictures:
        path = self._shown.recording
        if path is None:
            raise SourceError("There is no recording to look at now.")
        with self._reading:
            if self._pictures is None or self._pictures.path != path:
                self._pictures = Pictures(path)
            return self._pictures
