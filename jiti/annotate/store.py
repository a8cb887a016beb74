"""The labels of a source: who labelled which episodes, one partition for each."""

import threading
from collections import OrderedDict
from pathlib import Path

from jiti.annotate.folder import annotator_dirs
from jiti.annotate.partition import Partition
from jiti.annotate.segment_file import Recording

_KEPT_OPEN = 256
"""Partitions kept in memory. Our choice: more than a sitting visits, and a few megabytes."""


class LabelStore:
    """The folder of labels, which need not exist yet. Safe to share among threads and among processes."""

    def __init__(self, labels_dir: Path) -> None:
        self.labels_dir = labels_dir
        self._open: OrderedDict[tuple[str, str], Partition] = OrderedDict()
        self._mutex = threading.Lock()

    def annotators(self) -> list[str]:
        """Who has labels here, people and machines, by name."""
        return [name for name, _ in annotator_dirs(self.labels_dir)]

    def partition(self, annotator: str, episode_id: str, recording: Recording | None = None) -> Partition:
        """One annotator's labels of one episode, as they are on the disk now.

        `recording` describes what is labelled; the first edit needs it, later ones compare. Raises
        LabelError for a name that cannot be a file name or labels that cannot be read, NewerSchema.
        """
        key = (annotator, episode_id)
        with self._mutex:
            known = self._open.get(key)
            if known is not None:
                self._open.move_to_end(key)
        if known is not None:
            known.describe(recording)
            known.refresh()
            return known
        partition = Partition(self.labels_dir, annotator, episode_id, recording)
        with self._mutex:
            partition = self._open.setdefault(key, partition)
            if len(self._open) > _KEPT_OPEN:
                self._open.popitem(last=False)
        return partition
