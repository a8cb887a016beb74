"""`jiti autolabel`, whole: from what a user asked for to what is printed. Every result has a text and `to_json`."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

from jiti.annotate.agreement import lanes_of
from jiti.annotate.autolabel import Autolabelled, autolabel, best_source
from jiti.annotate.calibrate import calibrate
from jiti.annotate.engine import Engine
from jiti.annotate.estimate import estimate
from jiti.annotate.evaluate import Evaluation, evaluate, save
from jiti.annotate.folder import annotator_dirs
from jiti.annotate.labels import read_labels
from jiti.annotate.proposer import ProposalSource, Proposer
from jiti.annotate.vlm.ask import Asker
from jiti.annotate.vlm.cache import AnswerCache
from jiti.annotate.vlm.choose import Wish, choose
from jiti.annotate.vlm.cost import Estimate
from jiti.annotate.vlm.discover import PROPOSED_FILE, Discovered, Unknown, discover, estimate_tasks, tasks_in
from jiti.annotate.vlm.propose import Stage
from jiti.annotate.vlm.settings import Settings
from jiti.annotate.web.session import Session
from jiti.errors import UsageError
from jiti.progress import Progress
from jiti.tasks.catalogue_file import read_tasks

Part = Literal["itcs", "segments", "verdicts"]
"""A stage of the model, alone."""


@dataclass(frozen=True, slots=True)
class Request:
    """What a user asked for."""

    by: ProposalSource | None = None
    """None for the best without a model."""
    wish: Wish = field(default_factory=Wish)
    part: Part | None = None
    """None for segments and verdicts."""
    out: Path | None = None
    """Task file of stage one."""
    engine: Engine = "local"
    workers: int | None = None
    address: str | None = None
    prices: tuple[float, float] | None = None
    """Of a million tokens read and written."""

    def check(self) -> None:
        """Raises UsageError for what is of no use without something else."""
        of_model = {
            "--vlm-url": self.wish.url,
            "--vlm-model": self.wish.model,
            "--camera": self.wish.cameras,
            "--stage": self.part,
            "--out": self.out,
            "--prices": self.prices,
        }
        if self.by != "vlm" and (given := [flag for flag, value in of_model.items() if value]):
            raise UsageError(f"{given[0]} is of --vlm; add --vlm, or leave it out.")
        if self.out and self.part != "itcs":
            raise UsageError("--out is of --stage itcs; add that, or leave it out.")
        if self.address and self.engine != "ray":
            raise UsageError("--ray-address is of --engine ray; add that, or leave it out.")


def run_request(request: Request, session: Session, progress: Progress) -> Autolabelled | Discovered:
    """Do it. Raises UsageError for what does not fit together or is not there."""
    request.check()
    if request.by != "vlm":
        return _autolabel(request, session, None, progress)
    settings = choose(request.wish)
    if request.part == "itcs":
        labels_dir = session.store.labels_dir
        return discover(
            _asker(settings, labels_dir),
            tasks_in(session.reader),
            _task_file(request, labels_dir),
            reader=session.reader,
            cameras=settings.cameras,
            reviewed=_reviewed(session),
            progress=progress,
        )
    done = _autolabel(request, session, settings, progress)
    return replace(done, cost=done.usage.cost(request.prices)) if request.prices else done


def discover_libero(
    request: Request, instructions: Sequence[tuple[str, str]], labels_dir: Path, progress: Progress
) -> Discovered:
    """Stage one for tasks of which there is no video: `suite/name` of a BDDL file and its instruction."""
    path = _task_file(request, labels_dir)
    return discover(_asker(choose(request.wish), labels_dir), _of_libero(instructions), path, progress=progress)


def estimate_libero(request: Request, instructions: Sequence[tuple[str, str]], labels_dir: Path) -> Estimate:
    """What that would cost."""
    found = estimate_tasks(_of_libero(instructions), _task_file(request, labels_dir))
    return replace(found, prices=request.prices)


def estimate_request(request: Request, session: Session, progress: Progress) -> Estimate:
    """What it would cost. Raises UsageError where no model is asked for."""
    if request.by != "vlm":
        raise UsageError("--dry-run is of --vlm; the rest costs nothing to try.")
    request.check()
    if request.part == "itcs":
        path = _task_file(request, session.store.labels_dir)
        found = estimate_tasks(tasks_in(session.reader), path, session.reader, _reviewed(session))
    else:
        settings = choose(request.wish, asked=False)
        found = estimate(session.reader, session.catalogue, _proposer(request, session, settings), progress)
    return replace(found, prices=request.prices)


def evaluate_request(request: Request, session: Session, reference: str, *, fit: bool = False) -> Evaluation:
    """Compare what was proposed with a reference, and write figures and plot beside the labels.

    With `fit`, the model's confidence is calibrated to the reference; the next run applies it.
    """
    labels_dir = session.store.labels_dir
    by = request.by or _newest_proposer(labels_dir, reference)
    evaluation = evaluate(labels_dir, by, reference)
    if fit:
        if by != "vlm":
            raise UsageError("--calibrate is of --vlm: what numbers and simulators decide has no confidence to fit.")
        checked, _ = lanes_of(read_labels(labels_dir).segments, reference)
        found = calibrate(session.reader, session.catalogue, labels_dir, checked)
        evaluation = replace(evaluation, temperatures={model: c.temperature for model, c in found.items()})
    return save(replace(evaluation, discovered=_kept(request, session)), labels_dir / "evaluation")


def _autolabel(request: Request, session: Session, settings: Settings | None, progress: Progress) -> Autolabelled:
    workers = request.workers
    if settings and not workers:
        # A model that is here takes one question at a time; a server takes as many episodes as requests.
        workers = settings.concurrency if settings.url else 1
    proposer = _proposer(request, session, settings)
    return autolabel(
        session.reader,
        proposer,
        engine=request.engine,
        workers=workers,
        address=request.address,
        progress=progress,
    )


def _proposer(request: Request, session: Session, settings: Settings | None) -> Proposer:
    stages: tuple[Stage, ...] = ("segments", "verdicts")
    if request.part == "segments" or request.part == "verdicts":
        stages = (request.part,)
    return Proposer(
        session.source,
        session.store.labels_dir.absolute(),
        tuple(path.absolute() for path in session.task_files),
        request.by or best_source(session.reader),
        request.wish.fuse,
        stages,
        settings,
    )


def _newest_proposer(labels_dir: Path, reference: str) -> ProposalSource:
    """Of the machines that have proposed here, the one of most interest that is not the reference itself."""
    there = {name for name, _ in annotator_dirs(labels_dir)}
    machines: tuple[ProposalSource, ...] = ("vlm", "signal", "sim")
    found: list[ProposalSource] = [by for by in machines if by in there and by != reference]
    return found[0] if found else "signal"


def _of_libero(instructions: Sequence[tuple[str, str]]) -> list[Unknown]:
    return [Unknown(f"proposed/{bddl}", instruction, bddl) for bddl, instruction in instructions]


def _reviewed(session: Session) -> set[str]:
    """Ids of a user's own tasks, which have been read by a person."""
    return {one.task.task_id for path in session.task_files for one in read_tasks(path)}


def _asker(settings: Settings, labels_dir: Path) -> Asker:
    return Asker(settings.backend(), AnswerCache(labels_dir / "vlm" / "answers"))


def _task_file(request: Request, labels_dir: Path) -> Path:
    return request.out or labels_dir.absolute().parent / PROPOSED_FILE


def _kept(request: Request, session: Session) -> tuple[int, int] | None:
    """ITCs of the proposed file that are in the reviewed ones too, and all of them; None where there is none."""
    proposed = _task_file(request, session.store.labels_dir)
    if not proposed.is_file() or not session.task_files:
        return None
    before = {itc.itc_id for one in read_tasks(proposed) for itc in one.task.itcs}
    after = {itc.itc_id for path in session.task_files for one in read_tasks(path) for itc in one.task.itcs}
    return len(before & after), len(before)
