"""Open any source of episodes. This is the only place that chooses a reader."""

from pathlib import Path

from jiti.episodes.episode import EpisodeReader
from jiti.episodes.folder_reader import FolderReader
from jiti.episodes.hub import find_dataset, is_repo_id
from jiti.episodes.lerobot_info import INFO_PATH
from jiti.episodes.lerobot_reader import LeRobotReader
from jiti.episodes.mcap_reader import SUFFIX, McapReader
from jiti.episodes.mcap_records import MAGIC
from jiti.errors import SourceError

FORMATS = (
    "an MCAP file (*.mcap)",
    "a folder of MCAP files",
    "a LeRobot v3.0 or v2.1 dataset folder (with meta/info.json)",
    "a LeRobot dataset on the Hugging Face Hub (user/name)",
)
"""What can be opened."""


def open_reader(source: str | Path | None = None) -> EpisodeReader:
    """Open a file, a folder or a Hub id; None is the current folder. A path that exists comes before a Hub id.

    The reader's `labels_dir` is where its labels go by default: `labels/` beside MCAP files, `meta/jiti/` in a LeRobot
    folder, `./<name>.labels/` for a Hub id. Raises SourceError that lists the formats it knows.
    """
    path = Path.cwd() if source is None else Path(source).expanduser()
    try:
        if path.is_dir():
            return LeRobotReader(path) if (path / INFO_PATH).is_file() else FolderReader(path)
        if path.is_file():
            return _open_file(path)
        if path.exists():
            raise SourceError(f"{path} is neither a file nor a folder. Give {_formats()}.")
    except OSError as error:
        raise SourceError(
            f"{path}: cannot be opened ({error.strerror}). Check the path and its permissions."
        ) from error
    if isinstance(source, str) and is_repo_id(source):
        name = source.rpartition("/")[2]
        return LeRobotReader(find_dataset(source), title=source, labels_dir=str(Path.cwd() / f"{name}.labels"))
    raise SourceError(f"{path}: no such file or folder. Give {_formats()}.")


def _open_file(path: Path) -> EpisodeReader:
    with path.open("rb") as file:
        head = file.read(len(MAGIC))
    if path.suffix == SUFFIX or head == MAGIC:
        return McapReader(path)
    dataset = next((folder for folder in path.absolute().parents if (folder / INFO_PATH).is_file()), None)
    if dataset is not None:
        raise SourceError(f"{path} is a part of the LeRobot dataset in {dataset}. Open that folder.")
    raise SourceError(f"{path} is not a recording that jiti can read. Give {_formats()}.")


def _formats() -> str:
    return f"{', '.join(FORMATS[:-1])} or {FORMATS[-1]}"
