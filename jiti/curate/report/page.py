"""The page: one HTML file that needs nothing else and runs nothing."""

from collections import Counter
from collections.abc import Iterator, Sequence
from html import escape
from typing import Any

import numpy as np

from jiti.annotate.agreement import ALL_ITCS
from jiti.curate.export.split import SPLITS, UNSEEN
from jiti.curate.report.facts import EpisodeFacts, Facts
from jiti.curate.report.states import state_maps
from jiti.curate.report.svg import Series, bars, histogram

SUSPECTS = 60
"""That are listed. Our choice; `jiti validate-rewards --check --json` lists all."""
LOOKED_FOR = (
    "Looked for: labels of another recording, outside their episode or shorter than an action chunk; segments without "
    "a verdict; verdicts of one annotator that contradict each other or change within a few frames, and of several "
    "annotators that differ; constraints that are never satisfied or never violated; unusual returns; episodes that "
    "went nearly the same way and were judged the opposite way."
)
"""The kinds of `jiti.curate.suspects`."""

STYLE = """
:root { --ink: #1c2330; --dim: #5d6778; --line: #dde2ea; --back: #f6f7f9; --card: #fff;
  --good: #2a8f5b; --bad: #c8503c; --plain: #3f6fb0; --open: #9aa4b5 }
@media (prefers-color-scheme: dark) { :root { --ink: #e6e9ef; --dim: #9aa4b5; --line: #333b48; --back: #14181f;
  --card: #1c222c; --good: #4cc38a; --bad: #e5735c; --plain: #6f9fe0; --open: #6b7688 } }
* { box-sizing: border-box }
body { margin: 0 auto; padding: 28px; max-width: 1040px; background: var(--back); color: var(--ink);
  font: 15px/1.5 system-ui, sans-serif }
h1 { font-size: 26px; margin: 0 }
h2 { font-size: 18px; margin: 36px 0 10px }
p { margin: 6px 0; color: var(--dim) }
.numbers { display: grid; grid-template-columns: repeat(auto-fit, minmax(140px, 1fr)); gap: 12px; margin-top: 18px }
.numbers div { background: var(--card); border: 1px solid var(--line); border-radius: 8px; padding: 10px 14px }
.numbers b { display: block; font-size: 22px }
.numbers span { color: var(--dim); font-size: 13px }
.pair { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(440px, 100%), 1fr)); gap: 14px }
figure { margin: 0; padding: 12px; background: var(--card); border: 1px solid var(--line); border-radius: 8px;
  overflow-x: auto }
figure h3, .pair h3 { font-size: 14px; margin: 0 0 6px; font-weight: 600 }
svg { max-width: 100%; height: auto; display: block }
svg text { fill: var(--dim); font-size: 12px }
svg text.head { fill: var(--ink); font-weight: 600 }
.grid { stroke: var(--line) }
.frame { fill: none; stroke: var(--line) }
.elegant, .satisfied { fill: var(--good); background: var(--good) }
.inelegant, .violated { fill: var(--bad); background: var(--bad) }
.episodes, .frames { fill: var(--plain); background: var(--plain) }
.unlabelled { fill: var(--open); background: var(--open) }
.bars { display: grid; grid-template-columns: auto 1fr auto; gap: 8px 12px; font-size: 13px; color: var(--dim) }
.bars div { display: grid; grid-template-columns: subgrid; grid-column: 1 / -1; align-items: center }
.bars span:first-child { overflow-wrap: anywhere; text-align: right }
.bars b { display: flex; height: 18px }
figcaption { margin-top: 8px }
@media (max-width: 640px) { body { padding: 16px } .chart text { font-size: 14px }
  .bars { gap: 8px 12px; grid-template-columns: 1fr auto }
  .bars b { grid-row: 2; grid-column: 1 / -1 } .bars span:first-child { text-align: left } }
.key { margin-right: 16px; font-size: 13px; color: var(--dim) }
.key i { display: inline-block; width: 11px; height: 11px; border-radius: 2px; margin-right: 6px }
.wide { overflow-x: auto; background: var(--card); border: 1px solid var(--line); border-radius: 8px }
table { border-collapse: collapse; width: 100%; font-size: 14px }
th, td { text-align: left; padding: 7px 12px; border-bottom: 1px solid var(--line); vertical-align: top }
tr:last-child td { border-bottom: 0 }
th { color: var(--dim); font-weight: 600; white-space: nowrap }
td.n, th.n { text-align: right; font-variant-numeric: tabular-nums }
.error { color: var(--bad); font-weight: 600 }
.nothing { padding: 14px }
code { font-size: 13px; overflow-wrap: anywhere }
"""


def page(facts: Facts) -> str:
    """The page's HTML."""
    sections = "\n".join(
        f"<section><h2>{escape(title)}</h2>\n{''.join(parts)}</section>"
        for title, parts in (
            ("Tasks", _tasks(facts)),
            ("Constraints", _constraints(facts)),
            ("Lengths", _lengths(facts)),
            ("Returns", _returns(facts)),
            ("State space", state_maps(facts)),
            ("Agreement", _agreement(facts)),
            ("Suspects", _suspects(facts)),
            ("How it was made", _made(facts)),
        )
    )
    return document(f"{facts.name}: report", f"<h1>{escape(facts.name)}</h1>\n{_numbers(facts)}\n{sections}")


def document(title: str, body: str, style: str = STYLE) -> str:
    """A page of its own."""
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{style}</style>\n</head>\n<body>\n{body}\n</body>\n</html>\n"
    )


def _numbers(facts: Facts) -> str:
    frames = sum(episode.frames for episode in facts.episodes)
    judged = [episode for episode in facts.episodes if episode.elegant is not None]
    elegant = sum(bool(episode.elegant) for episode in judged)
    annotated = sum(episode.annotated for episode in facts.episodes)
    succeeded = [episode.success for episode in facts.episodes if episode.success is not None]
    told = [
        (len(facts.episodes), "episodes"),
        (f"{frames:,}", f"frames at {facts.fps} Hz"),
        (f"{elegant / max(1, len(judged)):.0%}", f"elegant: {elegant} of {len(judged)} judged"),
        (f"{annotated / max(1, frames):.1%}", "of frames annotated"),
        (sum(map(sum, (c.values() for c in facts.verdicts.values()))), "segments"),
    ]
    if succeeded:
        told.append((f"{sum(succeeded) / len(succeeded):.0%}", f"succeeded: {sum(succeeded)} of {len(succeeded)}"))
    boxes = "".join(f"<div><b>{value}</b><span>{escape(name)}</span></div>" for value, name in told)
    return f'<div class="numbers">{boxes}</div>'


def _tasks(facts: Facts) -> Iterator[str]:
    names = [name for name in (*SPLITS, UNSEEN) if any(episode.split == name for episode in facts.episodes)]
    rows = []
    for task, instruction in sorted({(episode.task, episode.instruction) for episode in facts.episodes}):
        here = [e for e in facts.episodes if (e.task, e.instruction) == (task, instruction)]
        splits = Counter(episode.split for episode in here)
        elegant = sum(bool(episode.elegant) for episode in here)
        seconds = np.mean([episode.frames for episode in here]) / facts.fps
        rows.append((task, instruction, len(here), elegant, f"{seconds:.1f}", *(splits[name] for name in names)))
    heading = ("task", "instruction", "episodes", "elegant", "mean s", *names)
    yield table(heading, rows, numbers=range(2, len(heading)))


def _constraints(facts: Facts) -> Iterator[str]:
    yield "<p>Segments by verdict, with the share that is satisfied.</p>"
    yield bars([(itc, (("satisfied", c[1]), ("violated", c[0]))) for itc, c in facts.verdicts.items()])


def _lengths(facts: Facts) -> Iterator[str]:
    segments = [("satisfied", np.array(facts.lengths[1])), ("violated", np.array(facts.lengths[0]))]
    frames = _by_verdict(facts.episodes, lambda episode: episode.frames / facts.fps)
    yield _pair(
        ("Segments", histogram([(name, values) for name, values in segments if len(values)], unit="frames")),
        ("Episodes", histogram(frames, unit="seconds")),
    )


def _returns(facts: Facts) -> Iterator[str]:
    yield (f"<p>Monte-Carlo returns with discount {facts.about['gamma']:g}. Calibration bounds a critic by them.</p>")
    peak = _by_verdict(facts.episodes, lambda episode: episode.peak_return)
    first = _by_verdict(facts.episodes, lambda episode: episode.first_return)
    yield _pair(
        ("Highest of each episode", histogram(peak, unit="return")),
        ("At the first frame", histogram(first, unit="return")),
    )


def _agreement(facts: Facts) -> Iterator[str]:
    rows = []
    for agreement in facts.agreements:
        for itc in agreement.itcs:
            name = "all" if itc.itc_id == ALL_ITCS else itc.itc_id
            verdicts = "–" if itc.verdict_agreement is None else f"{itc.verdict_agreement:.0%}"
            told = [f"{value:.2f}" if value is not None else "–" for value in (itc.mean_iou, itc.frame_kappa)]
            rows.append((f"{agreement.a}, {agreement.b}", name, itc.episodes, itc.matched, *told, verdicts))
    if not rows:
        yield "<p>No two annotators have labelled the same episode.</p>"
        return
    yield "<p>IoU over matched segments, Cohen's kappa over frames, and the share of equal verdicts.</p>"
    heading = ("annotators", "constraint", "episodes", "matched", "IoU", "kappa", "verdicts")
    yield table(heading, rows, numbers=range(2, 7))


def _suspects(facts: Facts) -> Iterator[str]:
    yield f"<p>{LOOKED_FOR}</p>"
    if not facts.suspects:
        yield "<p>Nothing of it was found.</p>"
        return
    errors = sum(one.severity == "error" for one in facts.suspects)
    yield f"<p>{errors} errors, {len(facts.suspects) - errors} warnings, the worst first.</p>"
    rows = []
    for one in facts.suspects[:SUSPECTS]:
        place = ", ".join(filter(None, (one.episode_id, f"frame {one.start_frame}" if one.episode_id else "")))
        what = f"{one.message}. {one.remedy}"
        rows.append((one.severity, one.kind.replace("_", " "), place, one.itc_id, what))
    yield table(("", "kind", "where", "constraint", "what"), rows)
    if len(facts.suspects) > SUSPECTS:
        yield f"<p>{len(facts.suspects) - SUSPECTS} more: jiti validate-rewards --check --json lists all.</p>"


def _made(facts: Facts) -> Iterator[str]:
    about = facts.about
    rows = [
        ("sources", ", ".join(about["sources"])),
        ("rule", about["rule"]),
        ("left out", ", ".join(f"{count} {why}" for why, count in about["left_out"].items() if count) or "nothing"),
        ("filter", about["options"]["filter"] or "none"),
        ("splits", _dealt(about["options"])),
        ("digest of all inputs", about["digest"][:16]),
        ("versions", ", ".join(f"{name} {version}" for name, version in about["versions"].items())),
    ]
    yield table(("", ""), rows)


def _dealt(options: dict[str, Any]) -> str:
    kept = options.get("splits_kept", [])  # not in datasets that were made before splits were kept
    told = [f"those of {', '.join(kept)}"] if kept else []
    return "; ".join([*told, f"{'else ' if kept else ''}{options['split']}, seed {options['seed']}"])


def _by_verdict(episodes: Sequence[EpisodeFacts], value: Any) -> Series:
    kinds = (("elegant", True), ("inelegant", False), ("unlabelled", None))
    series = [(name, np.array([value(e) for e in episodes if e.elegant is verdict])) for name, verdict in kinds]
    return [(name, values) for name, values in series if len(values)]


def _pair(*charts: tuple[str, str]) -> str:
    return (
        f'<div class="pair">{"".join(f"<div><h3>{escape(title)}</h3>{chart}</div>" for title, chart in charts)}</div>'
    )


def table(heading: Sequence[str], rows: Sequence[Sequence[Any]], *, numbers: Sequence[int] = ()) -> str:
    """Rows under a heading, which is left out where all of it is empty; columns of `numbers` stand at the right."""

    def cell(tag: str, column: int, value: Any) -> str:
        kinds = [*(["n"] if column in numbers else []), *(["error"] if value == "error" else [])]
        marked = f' class="{" ".join(kinds)}"' if kinds else ""
        return f"<{tag}{marked}>{escape(str(value))}</{tag}>"

    head = "".join(cell("th", k, value) for k, value in enumerate(heading)) if any(heading) else ""
    body = "".join(f"<tr>{''.join(cell('td', k, v) for k, v in enumerate(row))}</tr>" for row in rows)
    return f'<div class="wide"><table>{f"<tr>{head}</tr>" if head else ""}{body}</table></div>'
