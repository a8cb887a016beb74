"""An OpenAI-compatible server that does what a test tells it to, over real HTTP: answers, refuses, stalls, cuts."""

import json
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

LOCATED = json.dumps({"segments": [{"evidence": "the gripper opens", "start_s": "0.00", "end_s": "0.20"}]})
SATISFIED = json.dumps({"rationale": "it is inside when let go", "verdict": "satisfied"})
VIOLATED = json.dumps({"rationale": "it drops", "verdict": "violated"})


@dataclass
class Reply:
    """What to send."""

    text: str = SATISFIED
    status: int = 200
    body: bytes | None = None
    """In place of a chat completion."""
    delay_s: float = 0.0
    cut: bool = False
    """Close the connection in the middle of the answer."""
    finish: str = "stop"
    logprobs: list[dict[str, Any]] | None = None
    headers: dict[str, str] = field(default_factory=dict)


@dataclass
class Scripted:
    """A running server: its address, and the requests that it got."""

    url: str
    requests: list[dict[str, Any]] = field(default_factory=list)
    keys: list[str | None] = field(default_factory=list)
    most_at_once: int = 0


type Script = Callable[[dict[str, Any], int], Reply]
"""From a request and how many came before it."""


def stage(request: dict[str, Any]) -> str:
    """`constraints`, `segments` or `verdict`: what a request asks for."""
    named = request.get("response_format", {}).get("json_schema", {}).get("name")
    if named:
        return named
    words = request["messages"][1]["content"][0]["text"]
    return "segments" if "`start_s`" in words else "verdict" if "`verdict`" in words else "constraints"


def sensible(request: dict[str, Any], _count: int) -> Reply:
    """A model that finds every segment at the start and is content with it."""
    return Reply(LOCATED if stage(request) == "segments" else SATISFIED)


@contextmanager
def scripted(script: Script = sensible, *, models: tuple[str, ...] = ("tiny",)) -> Iterator[Scripted]:
    """Serve on a free port of 127.0.0.1 until the block ends."""
    lock, busy = threading.Lock(), [0]

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_GET(self) -> None:
            self._send(200, json.dumps({"object": "list", "data": [{"id": m, "object": "model"} for m in models]}))

        def do_POST(self) -> None:
            request = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
            with lock:
                count = len(state.requests)
                state.requests.append(request)
                state.keys.append(self.headers.get("Authorization"))
                busy[0] += 1
                state.most_at_once = max(state.most_at_once, busy[0])
            reply = script(request, count)
            time.sleep(reply.delay_s)
            with lock:
                busy[0] -= 1
            body = reply.body if reply.body is not None else json.dumps(_completion(reply)).encode()
            if reply.cut:
                self.send_response(reply.status)
                self.send_header("Content-Length", str(len(body)))
                self.end_headers()
                self.wfile.write(body[: len(body) // 2])
                self.wfile.flush()
                self.close_connection = True
                self.connection.shutdown(2)
                return
            self._send(reply.status, body, reply.headers)

        def _send(self, status: int, body: str | bytes, headers: dict[str, str] | None = None) -> None:
            data = body.encode() if isinstance(body, str) else body
            self.send_response(status)
            for name, value in {"Content-Type": "application/json", **(headers or {})}.items():
                self.send_header(name, value)
            self.send_header("Content-Length", str(len(data)))
            self.end_headers()
            self.wfile.write(data)

        def log_message(self, *_args: object) -> None:
            return

        def handle(self) -> None:
            try:
                super().handle()
            except (ConnectionError, OSError):
                return  # the client gave up, as it should when a test stalls it

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads = True
    state = Scripted(f"http://127.0.0.1:{server.server_port}/v1")
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)
    thread.start()
    try:
        yield state
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


def _completion(reply: Reply) -> dict[str, Any]:
    if reply.status != 200:
        return {"error": {"message": reply.text, "type": "error"}}
    choice = {
        "index": 0,
        "finish_reason": reply.finish,
        "message": {"role": "assistant", "content": reply.text},
        "logprobs": None if reply.logprobs is None else {"content": reply.logprobs},
    }
    return {
        "id": "x",
        "object": "chat.completion",
        "created": 0,
        "model": "tiny",
        "choices": [choice],
        "usage": {"prompt_tokens": 100, "completion_tokens": 10, "total_tokens": 110},
    }
