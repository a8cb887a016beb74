"""LeRobot datasets by their id on the Hugging Face Hub: from a cache on this machine, else downloaded."""

import os
import re
from collections.abc import Iterator
from pathlib import Path

from jiti.episodes.lerobot_info import INFO_PATH
from jiti.errors import SourceError

_REPO_ID = re.compile(r"[A-Za-z0-9][\w.-]*/[A-Za-z0-9][\w.-]*", re.ASCII)

_REVISIONS = (None, "v3.0", "v2.1", "v2.0")
"""`main`, and the tags under which lerobot downloads datasets."""


def is_repo_id(source: str) -> bool:
    """Whether the text can be `user/name` on the Hub: no file suffix of ours, and no folder `user` is here."""
    user = source.partition("/")[0]
    return (
        bool(_REPO_ID.fullmatch(source))
        and ".." not in source
        and "--" not in source
        and not source.endswith((".mcap", ".parquet", ".json", ".git"))
        and not Path(user).exists()
    )


def find_dataset(repo_id: str) -> Path:
    """The folder of a dataset: where lerobot keeps it, in the Hub's caches, or downloaded into the Hub's cache.

    A copy without data files is not taken: lerobot may have downloaded `meta/` alone. The download shows its progress
    on standard error. Raises SourceError that says where it looked and why the download failed.
    """
    looked, incomplete = [], None
    for place, folder in _local_places(repo_id):
        looked.append(place)
        if folder is None or not (folder / INFO_PATH).is_file():
            continue
        if _is_complete(folder):
            return folder
        incomplete = folder
    where = "; ".join(dict.fromkeys(looked))
    note = f" The copy in {incomplete} has no data files." if incomplete else ""
    if _is_offline():
        raise SourceError(
            f"{repo_id}: no such file or folder, and no such dataset on this machine. Looked in: {where}.{note} "
            "HF_HUB_OFFLINE is set: unset it to download the dataset, or give the path of a folder."
        )
    return _download(repo_id, where, note)


def lerobot_home() -> Path:
    """Where lerobot keeps datasets (lerobot/utils/constants.py, HF_LEROBOT_HOME)."""
    return Path(os.environ.get("HF_LEROBOT_HOME") or _hf_home() / "lerobot").expanduser()


def hub_cache() -> Path:
    """Where huggingface_hub keeps snapshots (huggingface_hub/constants.py, HF_HUB_CACHE)."""
    named = os.environ.get("HF_HUB_CACHE") or os.environ.get("HUGGINGFACE_HUB_CACHE")
    return Path(named or _hf_home() / "hub").expanduser()


def _hf_home() -> Path:
    cache = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    return Path(os.environ.get("HF_HOME") or Path(cache) / "huggingface").expanduser()


def _is_offline() -> bool:
    return os.environ.get("HF_HUB_OFFLINE", "").upper() in {"1", "ON", "YES", "TRUE"}


def _local_places(repo_id: str) -> Iterator[tuple[str, Path | None]]:
    """Places in the order of preference: what to call each, and the dataset's folder there, if any."""
    folder = lerobot_home() / repo_id
    yield str(folder), folder
    for cache in (lerobot_home() / "hub", hub_cache()):
        for revision in _REVISIONS:
            yield str(cache), _snapshot(repo_id, cache, revision)


def _snapshot(repo_id: str, cache: Path, revision: str | None) -> Path | None:
    if not cache.is_dir():
        return None
    from huggingface_hub import snapshot_download
    from huggingface_hub.errors import HFValidationError

    try:
        return Path(
            snapshot_download(repo_id, repo_type="dataset", revision=revision, cache_dir=cache, local_files_only=True)
        )
    except (OSError, ValueError, HFValidationError):  # Not in this cache, or only in part.
        return None


def _is_complete(folder: Path) -> bool:
    return next((folder / "data").rglob("*.parquet"), None) is not None


def _download(repo_id: str, where: str, note: str) -> Path:
    import httpx
    from huggingface_hub import snapshot_download
    from huggingface_hub.errors import (
        GatedRepoError,
        HfHubHTTPError,
        HFValidationError,
        LocalEntryNotFoundError,
        RepositoryNotFoundError,
    )

    looked = f"Looked in: {where}.{note}"
    try:
        folder = Path(snapshot_download(repo_id, repo_type="dataset", cache_dir=hub_cache()))
    except GatedRepoError as error:
        raise SourceError(
            f"{repo_id}: access to this dataset must be granted on the Hub. {looked} "
            "Ask for it on the dataset's page, then run `hf auth login`."
        ) from error
    except RepositoryNotFoundError as error:
        raise SourceError(
            f"{repo_id}: no such file or folder, and no such dataset on the Hub. {looked} "
            "Check the name; for a private dataset run `hf auth login`."
        ) from error
    except (LocalEntryNotFoundError, httpx.TransportError) as error:
        if isinstance(error.__cause__, HfHubHTTPError):
            raise _failed(repo_id, error.__cause__, looked) from error
        raise SourceError(
            f"{repo_id}: no such file or folder, and the Hub cannot be reached. {looked} "
            "Connect to the network, or give the path of a folder."
        ) from error
    except (HfHubHTTPError, HFValidationError, OSError) as error:
        raise _failed(repo_id, error, looked) from error
    if not (folder / INFO_PATH).is_file():
        raise SourceError(f"{repo_id}: this dataset on the Hub is not a LeRobot dataset: it has no {INFO_PATH}.")
    return folder


def _failed(repo_id: str, error: Exception, looked: str) -> SourceError:
    reason = str(error).strip().split("\n")[0][:200]
    return SourceError(f"{repo_id}: the download failed ({reason}). {looked} Try again.")
