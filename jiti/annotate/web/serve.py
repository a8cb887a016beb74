"""Start the server on loopback, say where, open the browser."""

import socket
import sys
import threading
import webbrowser
from collections.abc import Callable, Sequence

import uvicorn
from starlette.routing import BaseRoute

from jiti.annotate import segment_file
from jiti.annotate.web import recording
from jiti.annotate.web.app import create_app
from jiti.annotate.web.security import new_token
from jiti.annotate.web.session import Session
from jiti.errors import UsageError

HOST = "127.0.0.1"


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
    listener = bind(port)
    port = listener.getsockname()[1]
    token = new_token()
    app = create_app(session, token=token, port=port, routes=routes)
    url = f"http://{HOST}:{port}{path}{'&' if '?' in path else '?'}token={token}"
    say(f"Open {url}")
    say("Stop with Ctrl+C. Everything is saved as you go.")
    sys.stdout.flush()
    threading.Thread(target=_warm, name="warm", daemon=True).start()
    if browser:
        threading.Timer(0.3, webbrowser.open, (url,)).start()
    config = uvicorn.Config(app, log_level="warning", access_log=False, timeout_graceful_shutdown=1)
    uvicorn.Server(config).run(sockets=[listener])


def _warm() -> None:
    """Do once, while the browser starts, what makes a first recording and a first save slow: two seconds each."""
    recording.warm()
    segment_file.encode((), segment_file.FileInfo())
