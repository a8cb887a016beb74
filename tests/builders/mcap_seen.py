"""What tests of damaged recordings look at."""

from pathlib import Path

from jiti.episodes.episode import NumericBatch
from jiti.episodes.mcap_episode import McapEpisode


def opened(path: Path) -> McapEpisode:
    return McapEpisode(path, "a")


def whats(episode: McapEpisode) -> list[str]:
    return [problem.what for problem in episode.problems]


def counts(episode: McapEpisode) -> dict[str, int]:
    found = dict.fromkeys((s.name for s in episode.streams.values() if s.kind != "other"), 0)
    for batch in episode.read():
        found[batch.stream] += len(batch.time_ns)
    return found


def values_in(path: Path) -> list[float]:
    return [v for b in opened(path).read() if isinstance(b, NumericBatch) for v in b.values[:, 0].tolist()]
