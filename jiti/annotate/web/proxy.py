"""A lighter copy of a recording that the viewer cannot hold or play, built once and kept in the user's cache."""

import os
import threading
import time
from collections.abc import Iterator
from pathlib import Path

from platformdirs import user_cache_path

from jiti.annotate.web.recording import stream_recording
from jiti.episodes.episode import Episode
from jiti.episodes.transcode import transcode
from jiti.errors import JitiError, SourceError

PROXY_VERSION = 1
"""Raise when the way that proxies are made changes; older ones are made anew."""


class Proxy:
    """One proxy: an .rrd that grows while it is built, and may be read while it does."""

    def __init__(self, episode: Episode, recording_id: str, *, max_height: int) -> None:
        folder = user_cache_path("jiti") / "proxies"
        folder.mkdir(parents=True, exist_ok=True)
        self._episode, self._recording_id, self._max_height = episode, recording_id, max_height
        self.path = folder / f"{episode.fingerprint}-v{PROXY_VERSION}-{max_height}.rrd"
        self._part = self.path.with_suffix(f".{os.getpid()}.part")
        self.frame_count = episode.clock.frame_count
        self.frames_done = self.frame_count if self.path.exists() else 0
        self.error: JitiError | None = None
        self._started_at = time.monotonic()
        self._thread: threading.Thread | None = None

    @property
    def done(self) -> bool:
        return self.path.exists()

    @property
    def seconds_left(self) -> float | None:
        """Estimated from the pace so far; None before the first frame."""
        if not self.frames_done:
            return None
        return (time.monotonic() - self._started_at) * (self.frame_count / self.frames_done - 1)

    def start(self) -> None:
        """Begin to build in a thread, unless it is built, being built, or has failed."""
        if self.done or self.error or (self._thread and self._thread.is_alive()):
            return
        self._started_at = time.monotonic()
        self._part.write_bytes(b"")
        self._thread = threading.Thread(target=self._build, name="proxy", daemon=True)
        self._thread.start()

    def _build(self) -> None:
        try:
            with self._part.open("wb") as file:
                pieces = stream_recording(
                    self._episode,
                    self._recording_id,
                    transcode=lambda stream: transcode(self._episode, stream, max_height=self._max_height),
                    on_progress=self._progress,
                )
                for piece in pieces:
                    file.write(piece)
                    file.flush()
            self._part.replace(self.path)
        except JitiError as error:
            self.error = error
        except OSError as error:
            self.error = SourceError(f"{self._part.parent}: no room for the lighter copy ({error}). Free some space.")
        except Exception as error:  # a bug: told to who waits for the copy, and kept with its traceback
            self.error = SourceError(f"the lighter copy of {self._episode.episode_id} failed: {error!r}")
            raise
        finally:
            if self.error:
                self._part.unlink(missing_ok=True)

    def _progress(self, frame: int) -> None:
        self.frames_done = max(self.frames_done, frame + 1)

    def read(self, piece_bytes: int = 1 << 20) -> Iterator[bytes]:
        """Yield the proxy's bytes from the start, waiting for the builder where it must. Raises what it ran into."""
        self.start()
        if self.error:
            raise self.error
        source = self.path if self.done else self._part
        with _open_either(source, self.path) as file:
            while True:
                finished = self.done or self.error is not None
                while piece := file.read(piece_bytes):
                    yield piece
                if self.error:
                    raise self.error
                if finished:
                    return
                time.sleep(0.05)


def _open_either(first: Path, second: Path):
    """The file may be renamed from one to the other between two calls."""
    try:
        return first.open("rb")
    except FileNotFoundError:
        return second.open("rb")
