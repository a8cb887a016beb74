"""A model behind an OpenAI-compatible server: vLLM, transformers serve, or a hosted one."""

import base64
import os
import threading
import time
from collections.abc import Mapping
from typing import Any
from urllib.parse import urlsplit

from jiti.annotate.vlm.backend import Answer, ModelFailed, Picture, Prompt, Token, Usage
from jiti.errors import UsageError

DEFAULT_URL = "http://127.0.0.1:8000/v1"
"""Where vLLM listens unless it is told otherwise."""
URL_VARIABLE, KEY_VARIABLE, OPENAI_KEY_VARIABLE = "JITI_VLM_URL", "JITI_VLM_API_KEY", "OPENAI_API_KEY"
OPENAI_HOST = "api.openai.com"
"""The only host that is given the key in `OPENAI_KEY_VARIABLE`."""
CONCURRENCY = 8
"""Requests at once. Our choice: vLLM batches them; one card with a 2B model is busy with about as many."""
TIMEOUT_S = 120.0
"""Of one request. Our choice: 2,000 tokens of pictures and 500 of answer take seconds on a card, minutes on a CPU."""
RETRIES = 5
"""After a cut connection, a 408, 409, 429 or 5xx; the client waits between 0.5 and 8 s, or as the server says."""
TOP_LOGPROBS = 5
LONGEST_ANSWER = 100_000
"""Characters; a server that sends more does not keep to `max_tokens`."""


class ServerBackend:
    """Speaks to one model of a server through the openai client, which does retries, back-off and timeouts.

    What a server does not know of guided decoding, probabilities and seeds, it is not asked again.
    """

    def __init__(
        self,
        url: str,
        model: str,
        *,
        concurrency: int = CONCURRENCY,
        timeout_s: float = TIMEOUT_S,
        retries: int = RETRIES,
    ) -> None:
        self.model, self.concurrency = model, concurrency
        self._key = _api_key(url)
        self._client = _client(url, self._key, timeout_s, retries)
        self._url = _without_secrets(url)
        self._refused: set[str] = set()
        self._lock = threading.Lock()

    def ask(self, prompt: Prompt) -> Answer:
        """Raises ModelFailed."""
        import openai

        wanted = self._optional(prompt)
        begin, before = time.perf_counter(), None
        while True:
            options = {k: v for name, group in wanted.items() if name not in self._refused for k, v in group.items()}
            try:
                done = self._client.chat.completions.create(
                    model=self.model,
                    messages=_messages(prompt),
                    max_tokens=prompt.max_tokens,
                    temperature=prompt.temperature,
                    **options,
                )
                return self._answer(done, time.perf_counter() - begin)
            except (openai.BadRequestError, openai.UnprocessableEntityError) as error:
                if options == before or not self._give_up(str(error), set(wanted)):
                    raise ModelFailed(self._said(error)) from None
                before = options
            except openai.OpenAIError as error:
                raise ModelFailed(self._said(error)) from None
            except (ValueError, TypeError, AttributeError, KeyError, RecursionError, OverflowError) as error:
                raise ModelFailed(f"{self._url} answered no chat completion: {self._scrubbed(error)}") from None

    @staticmethod
    def _optional(prompt: Prompt) -> dict[str, dict[str, Any]]:
        schema = {"name": prompt.schema_name, "schema": dict(prompt.schema), "strict": True}
        wanted: dict[str, dict[str, Any]] = {
            "response_format": {"response_format": {"type": "json_schema", "json_schema": schema}},
            "seed": {"seed": prompt.seed},
        }
        if prompt.chosen:
            wanted["logprobs"] = {"logprobs": True, "top_logprobs": TOP_LOGPROBS}
        return wanted

    def _give_up(self, message: str, wanted: set[str]) -> bool:
        """Leave out from now on what the message complains of; False when that is nothing optional."""
        words = {"response_format": ("response_format", "json_schema"), "logprobs": ("logprobs",), "seed": ("seed",)}
        with self._lock:
            blamed = [name for name in sorted(wanted) if any(word in message for word in words[name])]
            # Another thread may have heard the same a moment ago: then it is simply asked again.
            self._refused.update(blamed)
            return bool(blamed)

    def _answer(self, done: Any, seconds: float) -> Answer:
        if not done.choices:
            raise ValueError("it has no choices")
        choice = done.choices[0]
        text = choice.message.content or ""
        if not isinstance(text, str):
            raise ValueError("its content is no text")
        tokens = () if len(text) > LONGEST_ANSWER or choice.logprobs is None else _tokens(choice.logprobs.content or ())
        usage = done.usage
        read, written = (usage.prompt_tokens, usage.completion_tokens) if usage else (0, 0)
        spent = Usage(1, int(read or 0), int(written or 0), seconds)
        cut = choice.finish_reason == "length" or len(text) > LONGEST_ANSWER
        return Answer(text[:LONGEST_ANSWER], cut, spent, tokens)

    def _said(self, error: Exception) -> str:
        """An error for a person, in one line, without the key."""
        import openai

        said = self._scrubbed(error)
        if isinstance(error, openai.APITimeoutError):
            said = "no answer in time; --vlm-timeout gives it longer"
        elif isinstance(error, openai.APIConnectionError):
            said = "no connection; is the server running?"
        elif isinstance(error, openai.AuthenticationError):
            said = f"it wants another key; set {KEY_VARIABLE}"
        return f"{self._url}, model {self.model}: {said}"

    def _scrubbed(self, error: Exception) -> str:
        """What an error says, without the key, then cut: a key is not to be cut in two."""
        said = " ".join(str(error).split())
        return (said.replace(self._key, "***") if self._key else said)[:300]


def find_model(url: str, wanted: str = "", timeout_s: float = 5.0) -> str:
    """The model of that name, or the only one that a server has.

    Raises UsageError when the server cannot be asked, or has several to choose from. Of one that does not list its
    models, a name that was given is believed.
    """
    _check_address(url)
    client = _client(url, _api_key(url), timeout_s, 0)
    import openai

    shown = _without_secrets(url)
    try:
        names = [model.id for model in client.models.list().data]
    except (openai.AuthenticationError, openai.PermissionDeniedError):
        raise UsageError(f"{shown} wants another key; set {KEY_VARIABLE} in the environment.") from None
    except openai.APIStatusError as error:
        if wanted:
            return wanted
        raise UsageError(
            f"{shown} does not list its models ({error.status_code}); name one with --vlm-model."
        ) from None
    except (openai.OpenAIError, ValueError, TypeError, AttributeError) as error:
        raise UsageError(
            f"no model server answers at {shown} ({type(error).__name__}). Start one, for example:\n"
            "    vllm serve nvidia/Cosmos-Reason2-2B\n"
            "and run this again; or name another with --vlm-url URL; or run a model in this process with "
            "--vlm-model nvidia/Cosmos-Reason2-2B."
        ) from None
    if wanted:
        return wanted
    if len(names) != 1:
        raise UsageError(
            f"{shown} has {len(names)} models; choose one with --vlm-model. It has: {', '.join(names[:20]) or 'none'}"
        )
    return names[0]


def _check_address(url: str) -> None:
    try:
        parts = urlsplit(url)
        good = parts.scheme in ("http", "https") and bool(parts.hostname) and (parts.port is None or parts.port > 0)
    except ValueError:
        good = False
    if not good:
        raise UsageError(
            f"--vlm-url {url.rpartition('@')[2].partition('?')[0]} is no address; it looks like {DEFAULT_URL}"
        )


def _client(url: str, key: str, timeout_s: float, retries: int) -> Any:
    try:
        import openai
    except ImportError as error:
        raise UsageError("asking a model server needs the openai client. Run: pip install 'jiti[vlm]'") from error

    return openai.OpenAI(base_url=url, api_key=key or "none", timeout=timeout_s, max_retries=retries)


def _api_key(url: str) -> str:
    """From the environment; OpenAI's own key goes to OpenAI only."""
    own = os.environ.get(KEY_VARIABLE, "")
    return own or (os.environ.get(OPENAI_KEY_VARIABLE, "") if urlsplit(url).hostname == OPENAI_HOST else "")


def _without_secrets(url: str) -> str:
    """An address without user, password and query, for messages."""
    parts = urlsplit(url)
    port = f":{parts.port}" if parts.port else ""
    return f"{parts.scheme}://{parts.hostname}{port}{parts.path}"


def _messages(prompt: Prompt) -> list[Mapping[str, Any]]:
    content: list[Mapping[str, Any]] = []
    for part in prompt.parts:
        if isinstance(part, Picture):
            data = base64.b64encode(part.jpeg).decode()
            content.append({"type": "image_url", "image_url": {"url": f"data:image/jpeg;base64,{data}"}})
        else:
            content.append({"type": "text", "text": part})
    return [{"role": "system", "content": prompt.system}, {"role": "user", "content": content}]


def _tokens(content: Any) -> tuple[Token, ...]:
    """Numbers that are none make the answer one that cannot be read."""
    return tuple(
        Token(str(t.token), float(t.logprob), {str(o.token): float(o.logprob) for o in t.top_logprobs or ()})
        for t in content
    )
