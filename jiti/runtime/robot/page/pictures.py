"""The pictures of one recording of an arm, in memory: half a minute of two cameras is some 40 MB."""

from pathlib import Path

from jiti.episodes.episode import ImageBatch
from jiti.episodes.reader import open_reader
from jiti.errors import SourceError


class Pictures:
    """JPEG files by camera."""

    def __init__(self, path: Path) -> None:
        """Raises SourceError."""
        self.path = path
        reader = open_reader(path)
        episode = reader.open(reader.episodes()[0].episode_id)
        topics = [name for name, stream in episode.streams.items() if stream.encoding == "jpeg"]
        self._pictures: dict[str, list[bytes]] = {topic.rpartition("/")[2]: [] for topic in topics}
        for batch in episode.read(topics) if topics else ():
            if isinstance(batch, ImageBatch):
                self._pictures[batch.stream.rpartition("/")[2]] += batch.data

    def counts(self) -> dict[str, int]:
        """How many each camera has."""
        return {camera: len(pictures) for camera, pictures in self._pictures.items()}

    def picture(self, camera: str, number: int) -> bytes:
        """Raises SourceError for one that is not there."""
        pictures = self._pictures.get(camera, [])
        if not 0 <= number < len(pictures):
            raise SourceError(f"{self.path.name} has no picture {number} of {camera}.")
        return pictures[number]
