"""The rows of a segments table as arrays, for checks that look at all of them at once."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa


@dataclass(frozen=True, slots=True)
class Rows:
    """Columns of a table of `read_segments`; arrays of one length, texts as places in lists."""

    table: pa.Table
    episode_ids: list[str]
    itc_ids: list[str]
    annotators: list[str]
    episode: np.ndarray
    itc: np.ndarray
    annotator: np.ndarray
    start: np.ndarray
    end: np.ndarray
    """Inclusive."""
    reward: np.ndarray
    """-1 where undecided."""
    status: np.ndarray

    @classmethod
    def of(cls, table: pa.Table) -> "Rows":
        table = table.combine_chunks()
        episode_ids, episode = codes(table["episode_id"])
        itc_ids, itc = codes(table["itc_id"])
        annotators, annotator = codes(table["annotator"])
        return cls(
            table,
            episode_ids,
            itc_ids,
            annotators,
            episode,
            itc,
            annotator,
            table["start_frame"].to_numpy(),
            table["end_frame"].to_numpy(),
            table["reward"].fill_null(-1).to_numpy(),
            table["status"].to_numpy(),
        )

    @property
    def length(self) -> np.ndarray:
        return self.end - self.start + 1

    @property
    def decided(self) -> np.ndarray:
        """Accepted with a verdict."""
        return (self.status == "accepted") & (self.reward >= 0)

    @property
    def lane(self) -> np.ndarray:
        """One number for each annotator, episode and ITC."""
        return (self.annotator * len(self.episode_ids) + self.episode) * len(self.itc_ids) + self.itc

    def place(self, row: int) -> dict[str, Any]:
        """Where a row is, as fields of a suspect."""
        return {
            "episode_id": self.episode_ids[self.episode[row]],
            "annotator": self.annotators[self.annotator[row]],
            "itc_id": self.itc_ids[self.itc[row]],
            "segment_id": self.table["segment_id"][int(row)].as_py(),
            "start_frame": int(self.start[row]),
        }

    def pairs(self) -> Iterator[tuple[str, str]]:
        """Each episode and ITC that occurs, once."""
        for key in np.unique(self.episode * max(1, len(self.itc_ids)) + self.itc):
            yield self.episode_ids[key // len(self.itc_ids)], self.itc_ids[key % len(self.itc_ids)]


def codes(column: pa.ChunkedArray) -> tuple[list[str], np.ndarray]:
    """Distinct texts and the place of each row's among them."""
    encoded = column.combine_chunks().dictionary_encode()
    return encoded.dictionary.to_pylist(), encoded.indices.to_numpy().astype(np.int64)
