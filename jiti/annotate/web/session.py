"""What one server holds: the source, the labels, the tasks, who annotates, and the episodes that are open."""

import threading
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from jiti.annotate.names import check_annotator, default_annotator
from jiti.annotate.partition import Partition
from jiti.annotate.segment_file import Recording
from jiti.annotate.store import LabelStore
from jiti.annotate.web.proxy import Proxy
from jiti.annotate.web.recording import needs_transcoding
from jiti.episodes.episode import Episode, EpisodeReader, EpisodeRef
from jiti.episodes.reader import open_reader
from jiti.errors import SourceError, UsageError
from jiti.tasks.catalogue import Catalogue, load_catalogue
from jiti.tasks.task import Task

OPEN_EPISODES = 4
"""Tables of contents that are kept: the episode shown, the one before and two ahead."""
VIEWER_BYTES = 1 << 30
"""Pictures that the viewer is given as they are. Our choice: half of the 2 GB that its 32-bit memory surely has."""
LIGHT_HEIGHT = 360
"""Picture height of a copy of a recording that is too large. Our choice: one of two views on a 1280x720 screen."""
TASKS_FILE = "tasks.toml"
"""A user's tasks beside the recordings, read when no `--tasks` is given."""
PLAYABLE_HEIGHT = 1080
"""Picture height of a copy that is made only because browsers do not play the codec."""


@dataclass
class Session:
    """Shared by all requests; safe to use from several threads."""

    reader: EpisodeReader
    store: LabelStore
    catalogue: Catalogue
    annotator: str
    source: str = ""
    """What `reader` was opened from, for processes that open it themselves."""
    task_files: tuple[Path, ...] = ()
    """A user's, in `catalogue`."""
    viewer_bytes: int = VIEWER_BYTES
    lock: threading.RLock = field(default_factory=threading.RLock)
    _episodes: OrderedDict[str, Episode] = field(default_factory=OrderedDict)
    _proxies: dict[str, Proxy] = field(default_factory=dict)

    def refs(self) -> list[EpisodeRef]:
        return list(self.reader.episodes())

    def ref(self, episode_id: str) -> EpisodeRef:
        """Raises SourceError when the source has no such episode."""
        for ref in self.reader.episodes():
            if ref.episode_id == episode_id:
                return ref
        raise SourceError(f"{self.reader.title} has no episode {episode_id!r}.")

    def episode(self, episode_id: str, *, anew: bool = False) -> Episode:
        """Open an episode, or take it from those that are open, unless it shall be read anew. Raises SourceError."""
        with self.lock:
            if episode_id in self._episodes and not anew:
                self._episodes.move_to_end(episode_id)
                return self._episodes[episode_id]
        episode = self.reader.open(episode_id)
        with self.lock:
            if anew and (failed := self._proxies.get(episode.fingerprint)) and failed.error:
                del self._proxies[episode.fingerprint]  # opening it again tries again
            self._episodes[episode_id] = episode
            while len(self._episodes) > OPEN_EPISODES:
                self._episodes.popitem(last=False)
        return episode

    def task(self, episode: Episode) -> Task:
        """The catalogue's task of the episode, or a generic one with an ITC for each criterion."""
        return self.catalogue.for_episode(episode)

    def partition(self, episode_id: str, annotator: str | None = None) -> Partition:
        """The rows of an annotator (default: this server's) on an episode."""
        clock = (episode := self.episode(episode_id)).clock
        recording = Recording(clock.frame_count, clock.rate_hz, episode.fingerprint)
        return self.store.partition(annotator or self.annotator, episode_id, recording)

    def recording_id(self, episode: Episode) -> str:
        return f"{episode.episode_id}-{episode.fingerprint[:12]}"

    def proxy(self, episode: Episode) -> Proxy | None:
        """The lighter copy through which an episode must be shown, or None when it can be shown as it is."""
        if needs_transcoding(episode, self.viewer_bytes) is None:
            return None
        too_large = episode.image_bytes > self.viewer_bytes
        with self.lock:
            key = episode.fingerprint
            if key not in self._proxies:
                height = LIGHT_HEIGHT if too_large else PLAYABLE_HEIGHT
                self._proxies[key] = Proxy(episode, self.recording_id(episode), max_height=height)
            return self._proxies[key]


def open_session(
    source: str | None, *, annotator: str | None, labels: Path | None, tasks: Sequence[Path] | None
) -> Session:
    """What `jiti annotate` and `jiti validate-rewards` work on. Raises JitiError when any part is wrong."""
    reader = open_reader(source)
    if labels is not None and labels.exists() and not labels.is_dir():
        raise UsageError(f"--labels {labels} is a file; it must be a folder, which need not exist yet.")
    beside = Path(reader.labels_dir).parent / TASKS_FILE
    files = list(tasks or ()) or ([beside] if beside.is_file() else [])
    session = Session(
        reader=reader,
        store=LabelStore(labels or Path(reader.labels_dir)),
        catalogue=load_catalogue(*files),
        annotator=check_annotator(annotator) if annotator else default_annotator(),
        source=_absolute(source),
        task_files=tuple(files),
    )
    refs = session.refs()
    readable = [ref for ref in refs if ref.problem is None]
    if not readable and refs:
        raise SourceError(str(refs[0].problem))
    if len(refs) == 1:
        session.episode(refs[0].episode_id)  # a file alone is refused at once, and not in the page
    return session


def _absolute(source: str | None) -> str:
    """A path from the root, as other processes may have another folder; a Hub id stays as it is."""
    path = Path.cwd() if source is None else Path(source).expanduser()
    return str(path.absolute()) if source is None or path.exists() else source
