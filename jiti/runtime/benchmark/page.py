"""A report as one HTML page that needs nothing else, and as Markdown with its charts as files beside it."""

import json
import re
from html import escape
from pathlib import Path

from jiti.curate.report.page import STYLE, document, table
from jiti.durable import make_folder, write_atomic
from jiti.runtime.benchmark import charts
from jiti.runtime.benchmark.tables import Chart, Report, Section, TextTable

HTML, MARKDOWN, NUMBERS = "report.html", "report.md", "report.json"
PLOTS = "plots"
KEY = "Diamonds are the paper's figures, whiskers 95% intervals."
_ALONE = "text { font: 12px system-ui, sans-serif; fill: #5d6778 } text.head { font-weight: 600; fill: #1c2330 } "
_ALONE += ".grid { stroke: #dde2ea }"
"""Style of a chart that is a file of its own."""


def write_report(folder: Path, report: Report) -> Path:
    """Write all of it and say where the page is. Raises SaveFailed."""
    make_folder(folder / PLOTS)
    for section in report.sections:
        for part in section.parts:
            if isinstance(part, Chart):
                write_atomic(folder / PLOTS / f"{part.name}.svg", _alone(part.svg).encode())
    write_atomic(folder / MARKDOWN, to_markdown(report).encode())
    write_atomic(folder / NUMBERS, json.dumps(report.numbers, indent=1).encode())
    write_atomic(folder / HTML, to_html(report).encode())
    return folder / HTML


def to_html(report: Report) -> str:
    """The page."""
    lead = "".join(map(_paragraph, report.lead))
    sections = "\n".join(f"<section><h2>{escape(s.title)}</h2>\n{_html(s)}</section>" for s in report.sections)
    style = f"{STYLE}{charts.STYLE}"
    return document(report.title, f"<h1>{escape(report.title)}</h1>\n{lead}<p>{KEY}</p>\n{sections}", style=style)


def _html(section: Section) -> str:
    parts = []
    for part in section.parts:
        if isinstance(part, TextTable):
            parts.append(
                table(
                    part.heading,
                    part.rows,
                    numbers=range(1, len(part.heading)) if part.heading[0:2] != ("", "") else (),
                )
            )
        elif isinstance(part, Chart):
            parts.append(f"<figure>{part.svg}</figure>")
        else:
            parts.append(_paragraph(part))
    return "\n".join(parts)


def _paragraph(text: str) -> str:
    return "<p>" + re.sub("`([^`]+)`", r"<code>\1</code>", escape(text)) + "</p>"


def to_markdown(report: Report) -> str:
    """The same for a repository or a terminal."""
    lines = [f"# {report.title}", ""]
    for text in report.lead:
        lines += [text, ""]
    lines += [KEY, ""]
    for section in report.sections:
        lines += [f"## {section.title}", ""]
        for part in section.parts:
            if isinstance(part, TextTable):
                lines += _markdown_table(part)
            elif isinstance(part, Chart):
                lines += [f"![{section.title}]({PLOTS}/{part.name}.svg)", ""]
            else:
                lines += [part, ""]
    return "\n".join(lines).rstrip() + "\n"


def _markdown_table(shown: TextTable) -> list[str]:
    def row(cells: tuple[str, ...]) -> str:
        return f"| {' | '.join(cell.replace('|', '\\|') for cell in cells)} |"

    rule = "|---" + "|---:" * (len(shown.heading) - 1) + "|"
    return [row(shown.heading), rule, *(row(cells) for cells in shown.rows), ""]


def _alone(svg: str) -> str:
    inner = svg.removeprefix("<svg").partition(">")
    return f'<svg xmlns="http://www.w3.org/2000/svg"{inner[0]}><style>{_ALONE}{charts.STYLE}</style>{inner[2]}'
