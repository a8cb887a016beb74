"""The ASGI app: guarded routes, our pages, and Rerun's viewer from the installed wheel."""

import importlib.util
from collections.abc import Sequence
from pathlib import Path

from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import FileResponse, Response
from starlette.routing import BaseRoute, Mount, Route
from starlette.staticfiles import StaticFiles

from jiti.annotate.web.answers import answer_error
from jiti.annotate.web.episodes_api import episode_routes
from jiti.annotate.web.keymap import keymap_routes
from jiti.annotate.web.labels_api import label_routes
from jiti.annotate.web.security import Guard
from jiti.annotate.web.session import Session
from jiti.errors import JitiError, UsageError

STATIC = Path(__file__).parent / "static"


def rerun_viewer_dir() -> Path:
    """The folder of the installed `rerun-notebook` wheel with `widget.js` and `re_viewer_bg.wasm`."""
    spec = importlib.util.find_spec("rerun_notebook")
    folder = Path(spec.origin).parent / "static" if spec and spec.origin else None
    if folder is None or not (folder / "re_viewer_bg.wasm").is_file():
        raise UsageError("Rerun's viewer is not installed: run `pip install 'rerun-notebook>=0.33,<0.34'`.")
    return folder


def create_app(session: Session, *, token: str, port: int, routes: Sequence[BaseRoute] = ()) -> Starlette:
    """The annotator's app. `routes` adds what another tool shows beside it; they see the same guard."""

    async def page(_request: Request) -> Response:
        return FileResponse(STATIC / "esa.html")

    return Starlette(
        routes=[
            Route("/", page),
            *routes,
            *episode_routes(session),
            *label_routes(session),
            *keymap_routes(),
            Mount("/static", CachedFiles(directory=STATIC)),
            Mount("/rerun", CachedFiles(directory=rerun_viewer_dir())),
        ],
        middleware=[Middleware(Guard, token=token, port=port)],
        exception_handlers={JitiError: answer_error},
    )


class CachedFiles(StaticFiles):
    """Files that the browser may keep but must ask about, so that an upgrade shows at once."""

    def lookup_path(self, path: str):
        return ("", None) if "\0" in path else super().lookup_path(path)

    def file_response(self, *args, **kwargs) -> Response:
        response = super().file_response(*args, **kwargs)
        response.headers["Cache-Control"] = "private, no-cache"
        return response
