"""Start the server on loopback, say where, open the browser."""

import socket
import sys
import threading
import webbrowser
from collections.abc import Callable, Sequence
from importlib.abc import MetaPathFinder

import pyarrow as pa
import uvicorn
from starlette.routing import BaseRoute

from jiti.annotate import segment_file
from jiti.annotate.web import recording
from jiti.annotate.web.app import create_app
from jiti.annotate.web.security import new_token
from jiti.annotate.web.session import Session
from jiti.errors import UsageError

HOST = "127.0.0.1"
WARM_LATER_S = 5.0
"""Before Rerun is loaded for a page that shows no recording at first. Our choice: its first answers need the cores."""


def bind(port: int) -> socket.socket:
    """A listening socket on loopback; port 0 takes any free one. Raises UsageError when the port is taken."""
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((HOST, port))
    except OSError as error:
        listener.close()
        raise UsageError(f"port {port} cannot be opened: {error.strerror}. Pass another --port, or none.") from error
    listener.listen(128)
    return listener


def serve(
    session: Session,
    *,
    path: str = "/",
    port: int = 0,
    browser: bool = True,
    routes: Sequence[BaseRoute] = (),
    say: Callable[[str], None] = print,
) -> None:
    """Serve until interrupted. Prints the address, which carries the token, and opens it unless told not to."""
    _spare_pandas()
    listener = bind(port)
    port = listener.getsockname()[1]
    token = new_token()
    app = create_app(session, token=token, port=port, routes=routes)
    url = f"http://{HOST}:{port}{path}{'&' if '?' in path else '?'}token={token}"
    say(f"Open {url}")
    say("Stop with Ctrl+C. Everything is saved as you go.")
    sys.stdout.flush()
    warming = threading.Timer(0.0 if path == "/" else WARM_LATER_S, _warm)
    warming.daemon = True
    warming.start()
    if browser:
        threading.Timer(0.3, webbrowser.open, (url,)).start()
    config = uvicorn.Config(app, log_level="warning", access_log=False, timeout_graceful_shutdown=1)
    uvicorn.Server(config).run(sockets=[listener])


class _NoPandas(MetaPathFinder):
    """Makes the import of pandas fail as if it were not installed."""

    def find_spec(self, fullname: str, path: object, target: object = None) -> None:
        if fullname == "pandas":
            raise ModuleNotFoundError(fullname)


def _spare_pandas() -> None:
    """Keep Arrow from importing pandas, where it is installed, at its first conversion of a list: that takes a second.

    Arrow tries once, and again when someone asks for a data frame, which no one does here.
    """
    sys.meta_path.insert(0, finder := _NoPandas())
    try:
        pa.array([0])
    finally:
        sys.meta_path.remove(finder)


def _warm() -> None:
    """Do once, while the browser starts, what makes a first recording and a first save slow: two seconds each."""
    recording.warm()
    segment_file.encode((), segment_file.FileInfo())
