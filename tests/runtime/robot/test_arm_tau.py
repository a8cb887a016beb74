"""tau of an arm: a quantile of what its decisions jumped by, taken only for what it was measured on."""

from dataclasses import replace
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from jiti.errors import SourceError, UsageError
from jiti.runtime.robot.recording import DECISIONS
from jiti.runtime.robot.tau import Asked, measure_tau, save_tau, stored_tau

ASKED = Asked("so100/T5", "so100", "p", "c", 2)


def recordings(folder: Path, *delta_q: list[float | None] | None) -> list[Path]:
    """Names of recordings, with tables of their decisions; None for one that ended before any."""
    paths = [folder / f"{number}.mcap" for number in range(len(delta_q))]
    for path, values in zip(paths, delta_q, strict=True):
        if values is not None:
            pq.write_table(pa.table({"delta_q": values}), path.with_suffix(DECISIONS))
    return paths


def test_a_share_of_all_decisions_exceeds_it(tmp_path):
    paths = recordings(tmp_path, [None, *range(49)], None, [None, *range(49, 98)])
    found = measure_tau(paths, 0.25, ASKED)
    assert (found.episodes, found.decisions, found.measured) == (3, 100, 0.25)
    save_tau(tmp_path, found)
    assert stored_tau(tmp_path, ASKED) == found.tau


def test_without_a_decision_or_for_something_else_it_says_what_to_do(tmp_path):
    with pytest.raises(UsageError, match="play some episodes"):
        measure_tau(recordings(tmp_path, None, [None]), 0.3, ASKED)
    with pytest.raises(UsageError, match="has none: pass --calibrate-tau"):
        stored_tau(tmp_path, ASKED)
    path = save_tau(tmp_path, measure_tau(recordings(tmp_path, [None, 1.0, 2.0, 3.0]), 0.3, ASKED))
    for change, told in (({"policy": "q"}, "policy p and not q"), ({"window": 5}, "window 2 and not 5")):
        with pytest.raises(UsageError, match=f"was calibrated with {told}: pass --calibrate-tau"):
            stored_tau(tmp_path, replace(ASKED, **change))
    path.write_bytes(b"{}")
    with pytest.raises(SourceError, match="is damaged"):
        stored_tau(tmp_path, ASKED)
