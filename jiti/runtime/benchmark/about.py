"""What a report says of how it was made: data, training, tau, seeds, versions, machine, time."""

import hashlib
import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from jiti.runtime.benchmark.cells import Results
from jiti.runtime.benchmark.chain import Chain
from jiti.runtime.benchmark.kept import RUNNING
from jiti.runtime.benchmark.plan import BenchmarkPlan
from jiti.runtime.benchmark.remaining import duration
from jiti.runtime.benchmark.stages import KINDS, Stage, in_order
from jiti.runtime.benchmark.tables import MISSING, NOTHING, Section, TextTable
from jiti.runtime.rollout.plan_file import hardware
from jiti.runtime.sim.libero import pack_name


def plan_digest(plan: BenchmarkPlan) -> str:
    """Hex digest of all that a plan fixes, whatever it is called, and whichever of its seeds are played."""
    beside = ("name", "title", "note", "tuning", "quick")
    content = {key: value for key, value in asdict(plan).items() if key not in beside}
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]


def stage_sections(chain: Chain) -> list[Section]:
    """Data and training, as far as they are there."""
    stages = in_order(cell.stage for cell in chain.cells())
    sections = [Section("Demonstrations", (_demonstrations(chain, stages),))]
    training = [stage for stage in stages if stage.kind in ("policies", "critics")]
    sections.append(Section("Training", (_training(chain, training), _sparse_note(chain))))
    if taus := [stage for stage in stages if stage.kind == "tau"]:
        sections.append(Section("tau", (_taus(chain, taus),)))
    return sections


def _demonstrations(chain: Chain, stages: Iterable[Stage]) -> TextTable:
    rows = []
    for stage in stages:
        if stage.kind == "record":
            mark = chain.work.done(stage)
            made = mark.made if mark else {}
            numbers = tuple(str(made.get(name, MISSING)) for name in ("episodes", "success", "elegant", "steps"))
            rows.append((stage.inputs["task"], *numbers))
    return TextTable(("", "demonstrations", "successful", "elegant", "frames"), tuple(rows))


def _training(chain: Chain, stages: Sequence[Stage]) -> TextTable:
    rows = []
    for stage in stages:
        mark = chain.work.done(stage)
        data = chain.work.done(stage.needed("values" if stage.inputs.get("data") == "filtered" else "curate"))
        kind = "policy" if stage.kind == "policies" else "critic"
        auc = mark.made.get("auc") if mark else None
        rows.append(
            (
                f"{kind} {stage.name}",
                str(data.made["episodes"]) if data else MISSING,
                f"{stage.inputs['steps']}",
                str(stage.inputs["seed"]),
                f"{auc:.2f}" if auc is not None else NOTHING,
                duration(mark.wall_s) if mark else MISSING,
                stage.key,
            )
        )
    return TextTable(("", "episodes", "steps", "seed", "AUC on validation", "time", "fingerprint"), tuple(rows))


def _sparse_note(chain: Chain) -> str:
    if not any(column.rewards == "sparse" for column in chain.plan.columns):
        return "Each training has one thread."
    return (
        "Each training has one thread. The critic on the sparse label learns from r = 1 at the last frame of every "
        "episode that succeeded, and 0 elsewhere, in the place of the segments' rewards (main paper). Where all "
        "demonstrations succeed, its values say how far the end is, and nothing of how well it was done."
    )


def _taus(chain: Chain, stages: Sequence[Stage]) -> TextTable:
    rows = []
    for stage in stages:
        mark = chain.work.done(stage)
        if mark is None:
            rows.append((stage.name, *[MISSING] * 5))
            continue
        made = mark.made
        measured = f"{made['measured']:.1%}" if "measured" in made else NOTHING  # marks of an older jiti have none
        shares = (f"{made['rate']:.1%}", measured)
        rows.append((stage.name, f"{made['tau']:.4g}", *shares, str(made["decisions"]), str(made["episodes"])))
    heading = ("policy and critic", "tau", "share asked for", "share that exceeds it", "decisions", "episodes")
    return TextTable(heading, tuple(rows))


def made_rows(chain: Chain, results: Results) -> list[tuple[str, str]]:
    """How it was made, as names and values."""
    plan = chain.plan
    machine = hardware()
    runs = chain.work.runs()
    alike = [run for run in runs if _kind(run) == (plan.name, plan.tuning, plan.quick)]
    own = [run for run in alike if run.get("digest") == plan_digest(plan)]
    revisions, packages = _code(chain, runs)
    data, tau = plan.data, plan.tau
    rows = [
        ("plan", f"{plan.name}, digest {plan_digest(plan)}"),
        (
            "recordings",
            f"seeds {_seeds(data.seed, data.episodes)} of each task, quality {data.quality:g}, "
            + (f"pushed by up to {data.disturbance:g} of an action, " if data.disturbance else "")
            + data.start,
        ),
        ("asset pack", pack_name(chain.pack)),
        ("tau", f"{tau.rate:.1%} of decisions, seeds {_seeds(tau.seed, tau.episodes)} of each task"),
        (
            "evaluation",
            f"seeds {_seeds(plan.seed, plan.episodes)} of each task, N {plan.rollouts.candidates}, "
            f"k {plan.rollouts.window}, at most {plan.rollouts.most_steps} steps",
        ),
        ("tuning", f"seeds {_seeds(plan.rollouts.tuning_seed, plan.rollouts.tuning_episodes)} of each task"),
        ("machine", f"{machine['processor']}, {machine['cores']} cores, {machine['system']}"),
        ("versions that made it", packages),
        ("revisions that made it", revisions),
        ("wall time", _wall(own)),
        ("time of a core", _core_time(chain, results)),
    ]
    others = {json.dumps(run["machine"], sort_keys=True) for run in own if run.get("machine") not in (None, machine)}
    if others:
        rows.append(("other machines that worked on it", "; ".join(sorted(others))))
    changed = {run["digest"] for run in alike if "digest" in run} - {plan_digest(plan)}
    if changed:
        rows.append(("other digests of this plan that ran here", ", ".join(sorted(changed))))
    return rows


def _kind(run: Mapping[str, Any]) -> tuple[Any, ...]:
    return run.get("plan"), run.get("tuning", False), run.get("quick", False)


def _code(chain: Chain, runs: Iterable[Mapping[str, Any]]) -> tuple[str, str]:
    """Every revision, and every version of each package, that made what the report is of: as stages say that are
    finished, and of rollouts the runs that played them, whatever plan they were of."""
    stages = in_order(cell.stage for cell in chain.cells())
    marks = [mark for stage in stages if stage.kind != "rollouts" and (mark := chain.work.done(stage))]
    keys = {stage.key for stage in stages if stage.kind == "rollouts"}
    played = [run for run in runs if keys & set(run.get("played", ()))]
    told = [(mark.revision, mark.versions) for mark in marks]
    told += [(run.get("revision"), run.get("versions", {})) for run in played]
    revisions = dict.fromkeys(revision or "none: not a checkout" for revision, packages in told if packages)
    versions: dict[str, dict[str, None]] = {}
    for _, packages in told:
        for name, version in packages.items():
            versions.setdefault(name, {})[version] = None
    shown = ", ".join(f"{name} {' and '.join(found)}" for name, found in versions.items())
    return ", ".join(revisions) or MISSING, shown or MISSING


def _seeds(first: int, count: int) -> str:
    return f"{first} to {first + count - 1}"


def _wall(runs: Sequence[dict[str, Any]]) -> str:
    if not runs:
        return NOTHING
    told = Counter("running or killed" if run.get("ended") == RUNNING else run.get("ended", "") for run in runs)
    how = ", ".join(f"{count} {word}" for word, count in told.items())
    total = sum(run.get("wall_s", 0.0) for run in runs)
    return f"{duration(total)} in {len(runs)} run{'s' if len(runs) > 1 else ''} ({how})"


def _core_time(chain: Chain, results: Results) -> str:
    spent = dict.fromkeys(KINDS, 0.0)
    for stage in in_order(cell.stage for cell in chain.cells()):
        if stage.kind != "rollouts" and (mark := chain.work.done(stage)):
            spent[stage.kind] += mark.wall_s
    spent["rollouts"] = sum(one.wall_s for cell in results.cells.values() for one in cell)
    return ", ".join(f"{kind} {duration(seconds)}" for kind, seconds in spent.items() if seconds)
