"""Every request shows our token, our host and our origin; every answer carries the content policy."""

import pytest
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.responses import PlainTextResponse
from starlette.routing import Route
from starlette.testclient import TestClient

from jiti.annotate.web.security import Guard, new_token

PORT = 4321
HOME = f"http://127.0.0.1:{PORT}"
TOKEN = new_token()


@pytest.fixture
def client() -> TestClient:
    async def hello(_request):
        return PlainTextResponse("hello")

    routes = [Route("/", hello, methods=["GET", "POST"]), Route("/deep", hello)]
    app = Starlette(routes=routes, middleware=[Middleware(Guard, token=TOKEN, port=PORT)])
    return TestClient(app, base_url=HOME, follow_redirects=False)


def bearer(token: str = TOKEN) -> dict[str, str]:
    return {"Authorization": f"Bearer {token}"}


def test_without_a_token_nothing_is_served(client: TestClient) -> None:
    answer = client.get("/")
    assert answer.status_code == 401
    assert "Open the address" in answer.text


@pytest.mark.parametrize("token", ["", "x", TOKEN[:-1], TOKEN + "a", "ü"])
def test_another_token_is_refused(client: TestClient, token: str) -> None:
    assert client.get("/", params={"token": token}).status_code == 401
    assert client.get("/", headers={"Authorization": f"Bearer {token}".encode()}).status_code == 401


def test_the_token_moves_from_the_address_into_a_cookie(client: TestClient) -> None:
    answer = client.get("/deep", params={"token": TOKEN, "episode": "a b&c"})
    assert answer.status_code == 303
    assert answer.headers["location"] == "/deep?episode=a+b%26c"
    cookie = answer.headers["set-cookie"]
    assert "HttpOnly" in cookie
    assert "SameSite=strict" in cookie
    assert client.get("/deep").text == "hello"


def test_a_path_with_two_slashes_stays_on_this_host(client: TestClient) -> None:
    answer = client.get(f"{HOME}//evil.example/deep", params={"token": TOKEN})
    assert answer.headers["location"].startswith("/evil.example")


@pytest.mark.parametrize("host", ["evil.example", f"evil.example:{PORT}", "127.0.0.1", f"127.0.0.1:{PORT + 1}", ""])
def test_another_host_name_is_refused(client: TestClient, host: str) -> None:
    """A page elsewhere may point its own name at 127.0.0.1 (DNS rebinding)."""
    assert client.get("/", headers={**bearer(), "Host": host}).status_code == 403


@pytest.mark.parametrize("origin", ["http://evil.example", f"http://127.0.0.1:{PORT + 1}", "null"])
def test_another_origin_is_refused(client: TestClient, origin: str) -> None:
    assert client.post("/", headers={**bearer(), "Origin": origin}).status_code == 403


@pytest.mark.parametrize("site", ["cross-site", "same-site"])
def test_a_request_that_another_page_made_is_refused(client: TestClient, site: str) -> None:
    assert client.get("/", headers={**bearer(), "Sec-Fetch-Site": site}).status_code == 403


def test_our_own_page_is_answered(client: TestClient) -> None:
    headers = {**bearer(), "Origin": HOME, "Sec-Fetch-Site": "same-origin"}
    answer = client.post("/", headers=headers)
    assert answer.text == "hello"
    assert "default-src 'self'" in answer.headers["content-security-policy"]
    assert answer.headers["x-content-type-options"] == "nosniff"


def test_refusals_do_not_repeat_the_token(client: TestClient) -> None:
    for answer in (client.get("/", params={"token": TOKEN}, headers={"Host": "evil.example"}), client.get("/")):
        assert TOKEN not in answer.text
