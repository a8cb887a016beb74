"""Which segments of two annotators mean the same event: the one-to-one matching with the greatest total overlap."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jiti.annotate.segments import Segment


@dataclass(frozen=True, slots=True)
class Match:
    """Two segments of one ITC that overlap."""

    a: Segment
    b: Segment
    iou: float
    """Shared frames over frames of either, in 0 to 1."""

    @property
    def start_error(self) -> int:
        """Frames by which b begins after a."""
        return self.b.start_frame - self.a.start_frame

    @property
    def end_error(self) -> int:
        """Frames by which b ends after a."""
        return self.b.end_frame - self.a.end_frame


def temporal_iou(a: Segment, b: Segment) -> float:
    """Shared frames over frames of either; both ends inclusive."""
    shared = min(a.end_frame, b.end_frame) - max(a.start_frame, b.start_frame) + 1
    return shared / (a.frame_count + b.frame_count - shared) if shared > 0 else 0.0


def match(
    a: Sequence[Segment], b: Sequence[Segment], *, least_iou: float = 0.0
) -> tuple[list[Match], list[Segment], list[Segment]]:
    """The matching of greatest total IoU between segments that overlap, then what is only in a, then only in b.

    Segments that overlap by less than `least_iou` are not matched. All are of one ITC of one episode. Segments far
    apart do not influence each other: each cluster of overlapping ones is matched by itself.
    """
    matches: list[Match] = []
    only_a: list[Segment] = []
    only_b: list[Segment] = []
    for left, right in _clusters(a, b):
        iou = np.array([[temporal_iou(x, y) for y in right] for x in left]).reshape(len(left), len(right))
        iou[iou < least_iou] = 0
        pairs = [(i, j) for i, j in assignment(iou) if iou[i, j] > 0]
        matches += [Match(left[i], right[j], float(iou[i, j])) for i, j in pairs]
        only_a += [x for i, x in enumerate(left) if i not in {i for i, _ in pairs}]
        only_b += [y for j, y in enumerate(right) if j not in {j for _, j in pairs}]
    return matches, only_a, only_b


def assignment(gain: np.ndarray) -> list[tuple[int, int]]:
    """Rows and columns, each at most once, with the greatest sum of `gain` (rows, columns), none of it negative.

    The Hungarian method with potentials (Kuhn 1955, as by Jonker and Volgenant): rows enter one after the other, each
    along a shortest augmenting path. O(rows^2 * columns).
    """
    if 0 in gain.shape:
        return []
    if gain.shape[0] > gain.shape[1]:
        return sorted((i, j) for j, i in assignment(gain.T))
    rows, columns = gain.shape
    cost = gain.max() - gain
    row_potential, column_potential = np.zeros(rows), np.zeros(columns)
    row_of = np.full(columns, -1)
    for new in range(rows):
        distance = np.full(columns, np.inf)
        before = np.full(columns, -1)
        done = np.zeros(columns, bool)
        row, column, reached = new, -1, 0.0
        while True:
            through = reached + cost[row] - row_potential[row] - column_potential
            closer = ~done & (through < distance)
            distance[closer], before[closer] = through[closer], column
            column = int(np.argmin(np.where(done, np.inf, distance)))
            reached = distance[column]
            done[column] = True
            row = row_of[column]
            if row < 0:
                break
        row_potential[new] += reached
        settled = done & (row_of >= 0)
        row_potential[row_of[settled]] += reached - distance[settled]
        column_potential[done] -= reached - distance[done]
        while column >= 0:
            row_of[column] = row_of[before[column]] if before[column] >= 0 else new
            column = before[column]
    return sorted((int(row), column) for column, row in enumerate(row_of) if row >= 0)


def _clusters(a: Sequence[Segment], b: Sequence[Segment]) -> list[tuple[list[Segment], list[Segment]]]:
    """Groups whose members reach no frame of another group, by time."""
    clusters: list[tuple[list[Segment], list[Segment]]] = []
    reach = -1
    for segment, side in sorted([(s, 0) for s in a] + [(s, 1) for s in b], key=lambda one: one[0].start_frame):
        if segment.start_frame > reach:
            clusters.append(([], []))
        clusters[-1][side].append(segment)
        reach = max(reach, segment.end_frame)
    return clusters
