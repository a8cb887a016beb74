"""What training tells of itself: TensorBoard for looking, Parquet for reading again."""

from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from jiti.durable import make_folder, replacing


class Metrics:
    """Rows of (step, name, value), kept until `flush` writes them as one more file of `RUN/metrics/`.

    Rows are flushed with checkpoints, so that a run which goes on from one neither loses nor repeats a step.
    TensorBoard is told to forget what comes after that step.
    """

    def __init__(self, run: Path, step: int) -> None:
        """`step` is where training begins, or goes on."""
        from torch.utils.tensorboard import SummaryWriter

        self._folder = run / "metrics"
        self._rows: list[tuple[int, str, float]] = []
        make_folder(run)
        make_folder(self._folder)
        for path in self._folder.glob("until-*.parquet"):
            if int(path.stem.rpartition("-")[2]) > step:
                path.unlink()
        self._board: Any = SummaryWriter(str(run / "tensorboard"), purge_step=step)

    def add(self, step: int, values: dict[str, float]) -> None:
        """Numbers of a step by name."""
        for name, value in values.items():
            self._rows.append((step, name, value))
            self._board.add_scalar(name, value, step)

    def flush(self, step: int) -> None:
        """Write what was added since the last time. Raises SaveFailed."""
        if not self._rows:
            return
        steps, names, values = zip(*self._rows, strict=True)
        table = pa.table(
            {
                "step": pa.array(steps, pa.int64()),
                "name": pa.array(names, pa.string()),
                "value": pa.array(values, pa.float64()),
            }
        )
        with replacing(self._folder / f"until-{step:08d}.parquet") as temporary:
            pq.write_table(table, temporary, compression="zstd")
        self._rows.clear()
        self._board.flush()

    def close(self) -> None:
        self._board.close()
