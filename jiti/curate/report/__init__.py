"""`jiti curate --report`: one page about a curated dataset. `facts` reads it, `page` tells it, `svg` draws."""

import json
from dataclasses import dataclass
from pathlib import Path

from jiti.curate.report.facts import gather
from jiti.curate.report.page import page
from jiti.durable import write_atomic
from jiti.errors import UsageError

REPORT_FILE = Path("meta") / "jiti" / "report.html"
"""In the dataset."""


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
    """Write the page of a dataset into it. Raises UsageError for a folder that is none, SaveFailed."""
    if not dataset.is_dir():
        raise UsageError(f"--report {dataset}: there is no such folder. Pass a dataset of jiti curate.")
    html = page(gather(dataset))
    write_atomic(dataset / REPORT_FILE, html.encode())
    return Reported(dataset / REPORT_FILE)
