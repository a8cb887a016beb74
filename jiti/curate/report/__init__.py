"""`jiti curate --report`: one page about a curated dataset."""

import json
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True)
class Reported:
    """Where the page is."""

    path: Path

    def __str__(self) -> str:
        return f"Report: {self.path}"

    def to_json(self) -> str:
        """For `--json`."""
        return json.dumps({"report": str(self.path)}, indent=2)


def report_on(dataset: Path) -> Reported:
    """Write the page of a dataset."""
    raise NotImplementedError
