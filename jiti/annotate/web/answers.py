"""From Python to the page and back: JSON answers, and errors as JSON that says what to do."""

import json
from collections.abc import Awaitable, Callable
from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import JSONResponse, Response

from jiti.errors import JitiError, LabelError, SaveFailed, SourceError, StaleWrite

MAX_BODY_BYTES = 1 << 20
"""A request's body; the largest is an edit of a few hundred segments."""


def status_of(error: JitiError) -> int:
    """The HTTP status of an error: 409 stale, 507 not saved, 404 no such source, 400 the rest."""
    for kind, status in ((StaleWrite, 409), (SaveFailed, 507), (SourceError, 404), (LabelError, 400)):
        if isinstance(error, kind):
            return status
    return 400


async def answer_error(_request: Request, error: Exception) -> Response:
    """Any JitiError becomes `{"error": message}`, a stale write with the edits since."""
    assert isinstance(error, JitiError)
    body: dict[str, Any] = {"error": str(error), "kind": type(error).__name__}
    if isinstance(error, StaleWrite):
        body["changes"] = error.changes
    return JSONResponse(body, status_of(error))


def endpoint(work: Callable[[Request, dict[str, Any]], Any]) -> Callable[[Request], Awaitable[Response]]:
    """An endpoint that runs `work(request, body)` in a thread and answers with its result as JSON."""

    async def run(request: Request) -> Response:
        body: dict[str, Any] = {}
        if request.method not in ("GET", "HEAD"):
            raw = bytearray()
            async for piece in request.stream():
                raw += piece
                if len(raw) > MAX_BODY_BYTES:
                    return JSONResponse({"error": "The request is larger than 1 MiB."}, 413)
            try:
                body = json.loads(raw or b"{}")
                json.dumps(body, ensure_ascii=False).encode()  # refuses half of a surrogate pair, which no file takes
            except (ValueError, RecursionError) as error:
                return JSONResponse({"error": f"The request is not JSON: {error}."}, 400)
            if not isinstance(body, dict):
                return JSONResponse({"error": "The request is not a JSON object."}, 400)
        result = await run_in_threadpool(work, request, body)
        return result if isinstance(result, Response) else JSONResponse(result)

    return run


def take_texts(body: dict[str, Any], name: str) -> list[str]:
    """A field that is a list of texts, empty when it is missing. Raises LabelError."""
    texts = take(body, name, list, [])
    if not all(isinstance(text, str) for text in texts):
        raise LabelError(f"{name!r} is {texts!r}; it must be a list of texts.")
    return texts


def take(body: dict[str, Any], name: str, kind: type, default: Any = ...) -> Any:
    """A field of a request. Raises LabelError when it is missing or of another type."""
    value = body.get(name, default)
    if value is ...:
        raise LabelError(f"the request lacks {name!r}.")
    if value is not default and (not isinstance(value, kind) or (kind is int and isinstance(value, bool))):
        raise LabelError(f"{name!r} is {value!r}; it must be a {kind.__name__}.")
    return value
