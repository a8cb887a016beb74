"""`jiti curate --report`: one page about a curated dataset. `facts` reads it, `page` tells it, `svg` draws."""

from pathlib import Path

from jiti.curate.report.facts import gather
from jiti.curate.report.page import page
from jiti.durable import write_atomic
from jiti.errors import UsageError

REPORT_FILE = Path("meta") / "jiti" / "report.html"
"""In the dataset."""


def report_on(dataset: Path) -> Path:
    """Write the page of a dataset into it and say where. Raises UsageError for a folder that is none, SaveFailed."""
    if not dataset.is_dir():
        raise UsageError(f"--report {dataset}: there is no such folder. Pass a dataset of jiti curate.")
    html = page(gather(dataset))
    write_atomic(dataset / REPORT_FILE, html.encode())
    return dataset / REPORT_FILE
