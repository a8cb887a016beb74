"""A model server over real HTTP: slow, refusing, cut off, and saying what it should not."""

import json

import pytest

from jiti.annotate.vlm.answers import VERDICTS, Span, read_opinion
from jiti.annotate.vlm.ask import Asker
from jiti.annotate.vlm.backend import ModelFailed, Picture, Prompt
from jiti.annotate.vlm.probability import choice_probability
from jiti.annotate.vlm.prompts import decide_prompt
from jiti.annotate.vlm.server import ServerBackend, find_model
from jiti.errors import UsageError
from jiti.tasks.catalogue import load_catalogue
from tests.builders.scripted_server import SATISFIED, VIOLATED, Reply, scripted

ITC = load_catalogue().task("elegant/T0").itcs[0]
SECRET = "sk-secret-0123456789"


def prompt(seed: int = 0) -> Prompt:
    sheet = Picture(b"\xff\xd8 not looked at here", 64, 64)
    views = [("/camera/front", [sheet])]
    return decide_prompt("pick up the ketchup", ITC, Span(0, 1, ""), views, "", seed=seed, temperature=0.0)


def backend(url: str, **options) -> ServerBackend:
    return ServerBackend(url, "tiny", **{"retries": 3, "timeout_s": 10.0, **options})


def test_a_request_has_words_pictures_schema_and_asks_for_probabilities():
    with scripted() as server:
        answer = backend(server.url).ask(prompt())
    (request,) = server.requests
    assert (answer.text, answer.usage.prompt_tokens, answer.usage.completion_tokens) == (SATISFIED, 100, 10)
    parts = request["messages"][1]["content"]
    assert [part["type"] for part in parts] == ["text", "text", "image_url"]
    assert parts[2]["image_url"]["url"].startswith("data:image/jpeg;base64,")
    assert request["response_format"]["json_schema"]["schema"]["properties"]["verdict"]["enum"] == list(VERDICTS)
    assert (request["logprobs"], request["seed"], request["model"]) == (True, 0, "tiny")


def test_the_verdicts_probability_comes_from_its_first_token():
    tokens = [('{"rationale":"x","verdict":"', -0.1, []), ("sat", -0.2231, [("sat", -0.2231), ("viol", -1.6094)])]
    tokens += [('isfied"}', 0.0, [])]
    logprobs = [
        {"token": t, "logprob": p, "top_logprobs": [{"token": o, "logprob": q} for o, q in others]}
        for t, p, others in tokens
    ]
    with scripted(lambda _r, _n: Reply('{"rationale":"x","verdict":"satisfied"}', logprobs=logprobs)) as server:
        answer = backend(server.url).ask(prompt())
    sure = choice_probability(answer.tokens, "verdict", VERDICTS)
    assert sure is not None
    assert sure["satisfied"] == pytest.approx(0.8, abs=0.001)


@pytest.mark.parametrize("status", [429, 500, 502, 503])
def test_a_server_that_is_busy_or_broken_is_asked_again(status):
    def script(_request, count):
        headers = {"Retry-After": "0.05"}
        return Reply("later", status, headers=headers) if count < 2 else Reply()

    with scripted(script) as server:
        assert backend(server.url).ask(prompt()).text == SATISFIED
    assert len(server.requests) == 3


def test_a_cut_connection_is_asked_again():
    with scripted(lambda _r, count: Reply(cut=count < 1)) as server:
        assert backend(server.url).ask(prompt()).text == SATISFIED
    assert len(server.requests) == 2


def test_a_server_that_stays_broken_is_given_up_with_its_address():
    with (
        scripted(lambda _r, _n: Reply("no disk", 500, headers={"Retry-After": "0.01"})) as server,
        pytest.raises(ModelFailed, match=rf"{server.url}.*no disk"),
    ):
        backend(server.url, retries=1).ask(prompt())
    assert len(server.requests) == 2


def test_a_slow_server_is_given_up_after_its_time():
    with (
        scripted(lambda _r, _n: Reply(delay_s=0.6)) as server,
        pytest.raises(ModelFailed, match="no answer in time; --vlm-timeout"),
    ):
        backend(server.url, timeout_s=0.1, retries=0).ask(prompt())


@pytest.mark.parametrize(
    ("word", "gone"),
    [
        ("response_format", "response_format"),
        ("logprobs", "logprobs"),
        ("seed", "seed"),
        ("json_schema", "response_format"),
    ],
)
def test_what_a_server_does_not_know_is_left_out_from_then_on(word, gone):
    def script(request, _count):
        return Reply(f"unknown: {word}", 400) if gone in request else Reply()

    with scripted(script) as server:
        asked = backend(server.url)
        assert asked.ask(prompt()).text == SATISFIED
        assert asked.ask(prompt(1)).text == SATISFIED
    assert [gone in request for request in server.requests] == [True, False, False]
    assert all("messages" in request for request in server.requests)


def test_a_request_that_is_too_long_is_not_asked_with_less():
    with (
        scripted(lambda _r, _n: Reply("maximum context length is 2048 tokens", 400)) as server,
        pytest.raises(ModelFailed, match="maximum context length"),
    ):
        backend(server.url).ask(prompt())
    assert len(server.requests) == 1


@pytest.mark.parametrize(
    "body",
    [
        b"",
        b"not json",
        b"[]",
        b"null",
        b'{"choices": []}',
        b'{"choices": [{"message": {}}]}',
        b"\xff\xfe",
        b'{"a":' * 9000,
    ],
)
def test_an_answer_that_is_no_chat_completion_is_a_failure(body):
    with scripted(lambda _r, _n: Reply(body=body)) as server, pytest.raises(ModelFailed):
        Asker(backend(server.url, retries=0)).ask(prompt(), read_opinion)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "I cannot help with that.",
        '{"verdict": "satisfied"}',
        '{"rationale": "x", "verdict": "satisfied", "reward": 1}',
        '{"rationale": "x", "verdict": "SATISFIED!"}',
        '{"rationale": "x", "verdict": "satisfied", "verdict": "violated"}',
        '{"rationale": "x", "verdict": true}',
        '{"rationale": "' + "x" * 5000 + '", "verdict": "satisfied"}',
        SATISFIED + VIOLATED,
        "[" * 100_000,
    ],
)
def test_text_that_does_not_fit_is_asked_once_more_and_then_a_failure(text):
    with scripted(lambda _r, _n: Reply(text)) as server, pytest.raises(ModelFailed, match="no usable answer, twice"):
        Asker(backend(server.url)).ask(prompt(), read_opinion)
    first, second = server.requests
    assert "That cannot be used" in second["messages"][1]["content"][-1]["text"]
    assert len(second["messages"][1]["content"]) == len(first["messages"][1]["content"]) + 1


def test_a_repaired_answer_counts():
    with scripted(lambda _r, count: Reply("hm" if count == 0 else VIOLATED)) as server:
        assert not Asker(backend(server.url)).ask(prompt(), read_opinion).value.satisfied


def test_an_answer_that_was_cut_off_does_not_count():
    cut = Reply(SATISFIED, finish="length")
    with scripted(lambda _r, _n: cut) as server, pytest.raises(ModelFailed, match="longer than it may be"):
        Asker(backend(server.url)).ask(prompt(), read_opinion)


def test_a_server_that_never_stops_talking_is_cut():
    endless = '{"rationale": "' + "a" * 300_000
    with scripted(lambda _r, count: Reply(endless)) as server:
        assert len(backend(server.url).ask(prompt()).text) == 100_000


def test_the_key_is_sent_and_never_shown(monkeypatch):
    monkeypatch.setenv("JITI_VLM_API_KEY", SECRET)
    for status, text in ((401, f"bad key {SECRET}"), (400, f"you sent {SECRET}"), (404, f"no {SECRET}")):
        reply = Reply(text, status)
        with scripted(lambda _r, _n, reply=reply: reply) as server, pytest.raises(ModelFailed) as failure:
            backend(server.url, retries=0).ask(prompt())
        assert server.keys == [f"Bearer {SECRET}"]
        assert SECRET not in str(failure.value)
        assert failure.value.__cause__ is None


def test_openais_key_goes_to_no_one_else(monkeypatch):
    monkeypatch.setenv("OPENAI_API_KEY", SECRET)
    with scripted() as server:
        backend(server.url).ask(prompt())
    assert server.keys == ["Bearer none"]


def test_the_only_model_of_a_server_is_taken():
    with scripted() as server:
        assert find_model(server.url) == "tiny"
    with (
        scripted(models=("a", "b")) as server,
        pytest.raises(UsageError, match="2 models; choose one with --vlm-model"),
    ):
        find_model(server.url)


def test_no_server_says_what_to_start():
    with pytest.raises(UsageError, match="vllm serve nvidia/Cosmos-Reason2-2B"):
        find_model("http://127.0.0.1:9/v1")


@pytest.mark.parametrize("url", ["127.0.0.1:8000", "file:///etc/passwd", "http://", "ftp://host/v1"])
def test_an_address_that_is_none_is_refused(url):
    with pytest.raises(UsageError, match="is no address"):
        find_model(url)


def test_a_password_in_an_address_is_not_shown():
    with pytest.raises(UsageError) as failure:
        find_model(f"http://user:{SECRET}@127.0.0.1:9/v1?token={SECRET}")
    assert SECRET not in str(failure.value)


def test_requests_are_json_that_says_nothing_of_this_machine(tmp_path):
    with scripted() as server:
        backend(server.url).ask(prompt())
    assert str(tmp_path.parent) not in json.dumps(server.requests)
