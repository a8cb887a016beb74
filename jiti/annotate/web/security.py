"""What every request must show: our host, our origin, our token. And what every answer carries: a content policy."""

import secrets
from urllib.parse import parse_qs, parse_qsl, urlencode, urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse, RedirectResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

CONTENT_POLICY = (
    "default-src 'self'; script-src 'self' 'wasm-unsafe-eval' blob:; worker-src 'self' blob:; "
    "style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; connect-src 'self' blob: data:; "
    "frame-ancestors 'none'; base-uri 'none'; form-action 'self'"
)
"""Rerun's viewer needs WebAssembly, a worker from a blob and inline styles; nothing else is open."""


def new_token() -> str:
    """A random token of 256 bits; made at each start and kept in memory only."""
    return secrets.token_urlsafe(32)


class Guard:
    """ASGI middleware: refuses any request without the token, from another origin, or for another host name.

    The opened URL carries the token once, as `?token=`; the answer moves it into a cookie that scripts cannot
    read and redirects to the same address without it. Scripts outside a browser may send
    `Authorization: Bearer TOKEN`.
    """

    def __init__(self, app: ASGIApp, *, token: str, port: int) -> None:
        self.app = app
        self._token = token
        self._cookie = f"jiti_{port}"  # browsers share cookies between the ports of a host
        self._hosts = {f"127.0.0.1:{port}", f"localhost:{port}"}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            await self.app(scope, receive, send)
            return
        if scope["type"] != "http":
            raise RuntimeError(f"there is no {scope['type']} endpoint")

        async def send_with_policy(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                headers["Content-Security-Policy"] = CONTENT_POLICY
                headers["X-Content-Type-Options"] = "nosniff"
                headers["Referrer-Policy"] = "no-referrer"
                headers["Cross-Origin-Resource-Policy"] = "same-origin"
                headers.setdefault("Cache-Control", "no-store")
            await send(message)

        answer = self._refuse(scope) or self._log_in(scope) or self.app
        await answer(scope, receive, send_with_policy)

    def _refuse(self, scope: Scope) -> ASGIApp | None:
        headers = Headers(scope=scope)
        host = headers.get("host", "")
        if host not in self._hosts:
            return PlainTextResponse("jiti: this server answers on 127.0.0.1 only.", 403)
        origin = headers.get("origin")
        if origin is not None and urlsplit(origin).netloc not in self._hosts:
            return PlainTextResponse("jiti: requests from other pages are refused.", 403)
        site = headers.get("sec-fetch-site", "none")
        if site not in ("same-origin", "none") and not self._matches(self._query_token(scope)):
            return PlainTextResponse("jiti: requests from other pages are refused.", 403)
        if not any(self._matches(given) for given in (self._query_token(scope), *self._carried_tokens(headers))):
            return PlainTextResponse(
                "jiti: the token is missing or old. Open the address that jiti printed when it started.",
                401,
            )
        return None

    def _log_in(self, scope: Scope) -> ASGIApp | None:
        if not self._matches(self._query_token(scope)) or scope["method"] != "GET":
            return None
        query = parse_qsl(scope["query_string"].decode("latin-1"), keep_blank_values=True)
        rest = urlencode([(key, value) for key, value in query if key != "token"])
        # A path that starts with two slashes would be read as another host.
        answer = RedirectResponse("/" + scope["path"].lstrip("/") + (f"?{rest}" if rest else ""), 303)
        answer.set_cookie(self._cookie, self._token, httponly=True, samesite="strict", path="/")
        return answer

    def _query_token(self, scope: Scope) -> str | None:
        return parse_qs(scope["query_string"].decode("latin-1")).get("token", [None])[0]

    def _carried_tokens(self, headers: Headers) -> list[str | None]:
        # By hand: other programs of this machine set cookies here as well, in forms that parsers refuse whole.
        cookies = (part.partition("=") for part in headers.get("cookie", "").split(";"))
        ours = [value.strip() for name, _, value in cookies if name.strip() == self._cookie]
        scheme, _, bearer = headers.get("authorization", "").partition(" ")
        return [*ours, bearer if scheme.lower() == "bearer" else None]

    def _matches(self, given: str | None) -> bool:
        return given is not None and secrets.compare_digest(given.encode(), self._token.encode())
