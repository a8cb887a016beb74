"""The keys that a person has remapped, kept in the user's settings so that they hold for every recording."""

import json
from pathlib import Path
from typing import Any

from platformdirs import user_config_path
from starlette.requests import Request
from starlette.routing import Route

from jiti.annotate.web.answers import endpoint, take
from jiti.durable import make_folder, write_atomic
from jiti.errors import LabelError


def keymap_path() -> Path:
    return user_config_path("jiti") / "keys.json"


def read_keymap() -> dict[str, str]:
    """Action to key, for those that differ from the default. A damaged file counts as empty."""
    try:
        stored = json.loads(keymap_path().read_text())
    except (OSError, ValueError):
        return {}
    return {str(k): str(v) for k, v in stored.items()} if isinstance(stored, dict) else {}


def keymap_routes() -> list[Route]:
    def get(_request: Request, _body: dict) -> dict[str, Any]:
        return {"keys": read_keymap()}

    def put(_request: Request, body: dict) -> dict[str, Any]:
        keys = take(body, "keys", dict)
        if not all(isinstance(v, str) and len(v) < 40 and len(k) < 40 for k, v in keys.items()) or len(keys) > 200:
            raise LabelError("keys must map names of actions to names of keys.")
        make_folder(keymap_path().parent)
        write_atomic(keymap_path(), json.dumps(keys, indent=1).encode())
        return {"keys": keys}

    return [Route("/api/keys", endpoint(get)), Route("/api/keys", endpoint(put), methods=["PUT"])]
