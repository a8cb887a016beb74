"""What is kept of a rollout: a row, its decisions, and a file of both that says that the episode is whole."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from jiti.durable import replacing, write_atomic
from jiti.errors import SourceError
from jiti.runtime.guidance import Guidance
from jiti.runtime.rollout.decide import Decided
from jiti.runtime.rollout.plan import label_of
from jiti.runtime.rollout.play import Played
from jiti.tasks.judge import Verdict

RESULT_SUFFIX, RECORDING_SUFFIX = ".json", ".mcap"
ROLLOUTS, DECISIONS = "rollouts.parquet", "decisions.parquet"


@dataclass(frozen=True, slots=True)
class Choice:
    """A decision as it is kept: the chunks themselves follow from policy, seed and number."""

    decision: int
    frame: int
    """Step whose state was observed; also the recording's frame, without cameras or with them."""
    q_t: float
    q_bar: float
    delta_q: float
    triggered: bool
    values: tuple[float, ...]
    chosen: int
    observe_s: float
    sample_s: float
    score_s: float
    problem: str

    @property
    def step_s(self) -> float:
        """Seconds that policy and critic took."""
        return self.observe_s + self.sample_s + self.score_s


@dataclass(frozen=True, slots=True)
class Rollout:
    """One episode of one way of guiding."""

    task: str
    label: str
    """Folder and name in tables: `none`, `jiti`, `full`, `jiti-random`."""
    method: str
    pick: str
    seed: int
    success: bool
    elegant: bool
    cut_off: bool
    """Whether it ran out of steps."""
    steps: int
    """States, the first and the last included: one more than actions."""
    itcs: tuple[tuple[str, Verdict], ...]
    choices: tuple[Choice, ...]
    sim_s: float
    wall_s: float
    """Seconds in the simulator, and of everything, recording included."""

    @property
    def interventions(self) -> int:
        """Decisions at which candidates were looked at."""
        return sum(choice.triggered for choice in self.choices)

    @property
    def problems(self) -> int:
        """Decisions at which the critic gave no number, and the default was executed."""
        return sum(bool(choice.problem) for choice in self.choices)


def outcome_text(rollout: Rollout) -> str:
    """`elegant`, or what was wrong."""
    if rollout.elegant:
        return "elegant"
    return "successful but not elegant" if rollout.success else "not successful"


def rollout_of(task: str, guidance: Guidance, seed: int, played: Played, wall_s: float) -> Rollout:
    """What is kept of an episode."""
    outcome = played.outcome
    return Rollout(
        task,
        label_of(guidance),
        guidance.method,
        guidance.pick,
        seed,
        outcome.success,
        outcome.elegant,
        played.cut_off,
        outcome.steps,
        tuple(outcome.verdicts.items()),
        tuple(choice_of(decided) for decided in played.decided),
        played.sim_s,
        wall_s,
    )


def choice_of(decided: Decided) -> Choice:
    """What is kept of a decision."""
    d = decided.decision
    return Choice(
        d.decision,
        decided.frame,
        d.q_t,
        d.q_bar,
        d.delta_q,
        d.triggered,
        d.values,
        d.chosen,
        decided.observe_s,
        d.sample_s,
        d.score_s,
        d.problem,
    )


def save_result(path: Path, rollout: Rollout) -> None:
    """Write a rollout's file, in whole or not at all. Raises SaveFailed."""
    write_atomic(path, json.dumps(without_nan(asdict(rollout)), indent=1, allow_nan=False).encode())


def load_result(path: Path) -> Rollout:
    """Raises SourceError for a file that `save_result` did not write."""
    try:
        content = json.loads(path.read_bytes())
        content["itcs"] = tuple((itc, Verdict(**verdict)) for itc, verdict in content["itcs"])
        content["choices"] = tuple(_read_choice(choice) for choice in content["choices"])
        return Rollout(**content)
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise SourceError(f"{path} is no rollout: {error!r}. Delete it, and it is played again.") from error


def _read_choice(content: dict[str, Any]) -> Choice:
    values = tuple(_number(value) for value in content["values"])
    numbers: dict[str, Any] = {name: _number(content[name]) for name in ("q_t", "q_bar", "delta_q")}
    return Choice(**{**content, **numbers, "values": values})


def _number(value: float | None) -> float:
    return float("nan") if value is None else value


def without_nan(value: Any) -> Any:
    """JSON has no numbers that are none: they are null."""
    if isinstance(value, dict):
        return {key: without_nan(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [without_nan(inner) for inner in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


_VERDICT = pa.struct([("itc", pa.string()), ("satisfied", pa.bool_()), ("step", pa.int64()), ("reason", pa.string())])
_KEY = [(name, pa.string()) for name in ("task", "label", "method", "pick")] + [("seed", pa.int64())]
FINGERPRINTS = ("policy", "critic")
ROLLOUT_SCHEMA = pa.schema(
    [
        *_KEY,
        *((name, pa.string()) for name in FINGERPRINTS),
        *((name, pa.bool_()) for name in ("success", "elegant", "cut_off")),
        ("itcs", pa.list_(_VERDICT)),
        *((name, pa.int64()) for name in ("steps", "decisions", "interventions", "problems")),
        *((name, pa.float64()) for name in ("observe_s", "sample_s", "score_s", "sim_s", "wall_s")),
    ]
)
"""`rollouts.parquet`: a row an episode. Times in seconds, summed over the episode; `steps` counts states; `policy` and
`critic` are fingerprints, as in `plan.json`, null for a critic that was not asked."""
DECISION_SCHEMA = pa.schema(
    [
        *_KEY,
        *((name, pa.int64()) for name in ("decision", "frame")),
        *((name, pa.float64()) for name in ("q_t", "q_bar", "delta_q")),
        ("triggered", pa.bool_()),
        ("values", pa.list_(pa.float64())),
        ("chosen", pa.int64()),
        *((name, pa.float64()) for name in ("observe_s", "sample_s", "score_s")),
        ("problem", pa.string()),
    ]
)
"""`decisions.parquet`: a row a decision; null where the critic was not asked or gave no number."""


def write_tables(
    folder: Path, rollouts: Sequence[Rollout], played_by: Mapping[str, Mapping[str, str | None]] | None = None
) -> None:
    """Write both tables, in the order given. `played_by` are fingerprints of policy and critic by label. Raises
    SaveFailed."""
    rows = [_row(rollout) | dict((played_by or {}).get(rollout.label, {})) for rollout in rollouts]
    decisions = [_key(r) | without_nan(asdict(choice)) for r in rollouts for choice in r.choices]
    for name, content, schema in ((ROLLOUTS, rows, ROLLOUT_SCHEMA), (DECISIONS, decisions, DECISION_SCHEMA)):
        with replacing(folder / name) as temporary:
            pq.write_table(pa.Table.from_pylist(content, schema=schema), temporary)


def _key(rollout: Rollout) -> dict[str, Any]:
    return {name: getattr(rollout, name) for name, _ in _KEY}


def _row(rollout: Rollout) -> dict[str, Any]:
    own = ("success", "elegant", "cut_off", "steps", "interventions", "problems", "sim_s", "wall_s")
    times = {t: sum(getattr(choice, t) for choice in rollout.choices) for t in ("observe_s", "sample_s", "score_s")}
    itcs = [{"itc": itc, **asdict(verdict)} for itc, verdict in rollout.itcs]
    return (
        _key(rollout)
        | {name: getattr(rollout, name) for name in own}
        | times
        | {"decisions": len(rollout.choices), "itcs": itcs}
    )
