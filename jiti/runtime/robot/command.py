"""`jiti rollout --robot`, whole: from what a user asked for to what is printed."""

import json
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from jiti.annotate.names import default_annotator
from jiti.durable import make_folder
from jiti.errors import JitiError, RobotError, UsageError
from jiti.runtime.robot.evaluation.evaluation import Evaluation
from jiti.runtime.robot.evaluation.judged import open_kept
from jiti.runtime.robot.evaluation.report import EvaluationReport
from jiti.runtime.robot.inference import Brain, Inference, OpenAgent, open_agent
from jiti.runtime.robot.live import LiveArm
from jiti.runtime.robot.page import Page
from jiti.runtime.robot.panel import Panel, Shown
from jiti.runtime.robot.recording import Recording
from jiti.runtime.robot.report import RobotReport
from jiti.runtime.robot.request import (
    RobotRequest,
    asked_of,
    folder_of,
    guidances_of,
    layouts_of,
    shared_of,
    taken_of,
    task_of,
    turns_of,
)
from jiti.runtime.robot.run import AfterEpisode, BeforeEpisode, MakeRecording, Runner
from jiti.runtime.robot.safe_arm import SafeArm
from jiti.runtime.robot.settings import VIRTUAL, RobotSettings
from jiti.runtime.robot.stops import NEXT, Stopped, Stops
from jiti.runtime.robot.tau import measure_tau, save_tau
from jiti.runtime.robot.told import Told
from jiti.runtime.robot.turn import Turn
from jiti.runtime.robot.virtual import VirtualArm
from jiti.runtime.rollout.live import SHOWN_SUFFIX
from jiti.runtime.rollout.plan import label_of
from jiti.runtime.rollout.result import without_nan
from jiti.runtime.rollout.viewer import Viewer
from jiti.runtime.workers import alone
from jiti.tasks.catalogue import Catalogue
from jiti.tasks.task import Task

if TYPE_CHECKING:
    from lerobot.cameras import CameraConfig

Say = Callable[[str], None]


@dataclass(frozen=True)
class Ran:
    """What is to be printed."""

    report: RobotReport
    problem: Exception | None
    """What ended it before its time: Stopped, or an error."""
    evaluation: EvaluationReport | None = None

    @property
    def _told(self) -> bool:
        """How an arm waited for decisions tells who decided."""
        return self.evaluation is None or self.evaluation.told

    def to_json(self) -> str:
        content = self.report.to_dict() if self._told else {}
        if self.evaluation is not None:
            content["evaluation"] = self.evaluation.to_dict()
        return json.dumps(without_nan(content), indent=2, allow_nan=False)

    def print(self) -> None:
        """On standard output."""
        if self._told:
            self.report.print()
        if isinstance(self.problem, Stopped):  # an error is told by who ends with it
            print(f"It was {self.problem}.")
        if self.evaluation is not None:
            self.evaluation.print()


def run_robot(
    request: RobotRequest,
    catalogue: Catalogue,
    say: Say,
    *,
    make_agent: OpenAgent = open_agent,
    after_episode: AfterEpisode = lambda _recorded: None,
    cameras: "dict[str, CameraConfig] | None" = None,
) -> Ran:
    """Play episodes on an arm, which has no torque afterwards, whatever happened; what was recorded is kept. `cameras`
    are taken instead of those of the settings.

    Raises UsageError for what does not fit together or is missing, RobotError for an arm that cannot begin.
    """
    ran: list[Ran] = []
    if request.dry_run:  # a recording would be taken for one of an arm that moved
        request = replace(request, record=False)
    try:
        _run(request, catalogue, say, make_agent, after_episode, cameras, ran.append)
    except (RobotError, Stopped) as error:  # at the end, where an arm is let go
        if not ran:
            raise
        return replace(ran[0], problem=ran[0].problem or error)
    return ran[0]


def _run(
    request: RobotRequest,
    catalogue: Catalogue,
    say: Say,
    make_agent: OpenAgent,
    after_episode: AfterEpisode,
    cameras: "dict[str, CameraConfig] | None",
    ended: Callable[[Ran], None],
) -> None:
    """`ended` is told what is to be printed, before all is closed."""
    task = task_of(request, catalogue)
    folder = folder_of(request, task)
    guidances = guidances_of(request, task, folder)
    if request.policy is None:
        raise UsageError("an arm needs a policy of its own: pass --policy, a checkpoint or run of lerobot-train.")
    request.settings.check_port()
    brain = Brain(request.policy, request.critic, guidances, task.instruction, request.device, request.settings.execute)
    turns = [] if request.judge else turns_of(request, folder, task, guidances[0])
    with ExitStack() as stack:
        stops = stack.enter_context(Stops())
        make_folder(folder)
        stack.enter_context(alone(folder, "jiti rollout"))
        page = stack.enter_context(Page(stops.press))
        say(f"Open {page.url}")
        panel = Panel(stops, say, page.show)
        evaluation, keep_episode = None, lambda _recorded: None
        if request.judge:
            kept = open_kept(folder, shared_of(request, task, guidances), len(guidances) * layouts_of(request))
            by_label = {label_of(guidance): guidance for guidance in guidances}
            evaluation = Evaluation(kept, task, by_label, default_annotator(), panel, blind=request.blind)
            evaluation.judge_waiting()
            turns, keep_episode, after_episode = evaluation.turns(), evaluation.keep, evaluation.after

        def told(report: RobotReport, problem: Exception | None) -> Ran:
            judged = EvaluationReport(evaluation.kept, request.blind) if evaluation else None
            return Ran(report, problem, judged)

        report = RobotReport(task.task_id, request.settings.kind, taken_of(request, guidances), [], 0, {}, folder)
        if not turns:
            ended(told(report, None))
            return
        inference = stack.enter_context(Inference(brain, make_agent))
        virtual, settings = _virtual(request, task, stack)
        arm = SafeArm(
            settings, dry=request.dry_run, say=panel.remark, cameras=cameras or (virtual and virtual.cameras())
        )
        stack.enter_context(arm)
        viewer = Viewer(say) if request.live else None
        if viewer is not None:
            stack.callback(viewer.close)
        runner = Runner(
            arm,
            inference,
            stops,
            _recordings(request, task, arm, viewer),
            _before(turns, stops, panel, virtual, evaluation),
            keep_episode,
            after_episode,
        )
        if request.dry_run:
            runner.watchers = (Told(say, arm.joints),)
        panel.tell(Shown("opening", "Loading policy and critic; the arm has no torque."))
        facts = runner.open()
        if request.dry_run:
            say("Dry run: nothing is sent.")
        done, problem = runner.play(facts, turns, request.seconds)
        try:
            if evaluation is not None and problem is None:
                evaluation.finish()
        except Stopped as stopped:
            problem = stopped
        told_end = f"It ended: {problem}." if problem else "It is over."
        page.show(Shown("over", told_end + ("" if arm.engaged else " The arm has no torque.")))
        report = replace(
            report,
            taken=report.taken | {"execute": facts.execute},
            episodes=done,
            misread=arm.misread,
            overloads=arm.overloads,
        )
        if request.calibrate_tau is not None and problem is None:
            try:
                found = measure_tau([turn.path for turn in turns], request.calibrate_tau, asked_of(request, task))
                say(f"{found}. Kept in {save_tau(folder, found)}, for this policy and critic on this task.")
                report = replace(report, taken=report.taken | {"tau": found.tau})
            except JitiError as error:
                problem = error
        ended(told(report, problem))
        if viewer is not None and problem is None:
            with suppress(Stopped):
                viewer.wait()


def _recordings(request: RobotRequest, task: Task, arm: SafeArm, viewer: Viewer | None) -> MakeRecording:
    """What makes the recording of a turn. Where a person is not to know the guidance, it does not tell."""
    blind = request.judge and request.blind
    cameras = tuple(arm.robot.cameras)

    def make(turn: Turn) -> Recording:
        about = {"task": task.task_id, "robot": request.settings.kind, "seed": str(turn.seed)}
        about |= {"policy": request.policy or "", "critic": request.critic or ""}
        about |= {} if blind else {"guidance": turn.label}
        shown = None
        if viewer is not None:
            make_folder(turn.path.parent)
            path = turn.path.with_suffix(SHOWN_SUFFIX)
            shown = LiveArm(path, viewer.address, arm.joints, cameras, turn.guidance.tau, blind=blind)
        path = turn.path if request.record else None
        return Recording(path, arm.joints, cameras, instruction=task.instruction, about=about, shown=shown)

    return make


def _before(
    turns: Sequence[Turn], stops: Stops, panel: Panel, virtual: VirtualArm | None, evaluation: Evaluation | None
) -> BeforeEpisode:
    """What is done before a turn: the things are laid out, by a person or on a virtual table. Without a terminal no one
    is waited for, unless someone is to judge."""

    def before(turn: Turn) -> None:
        if virtual is not None:
            virtual.reset(turn.seed)
        title = evaluation.title(turn.number) if evaluation else f"Episode {turns.index(turn) + 1} of {len(turns)}"
        if evaluation is not None:
            evaluation.before(turn)
        elif stops.keys:
            panel.ask(Shown("ready", "Lay the things out.", "Keep clear of the arm.", title, {NEXT: "begin"}))
        panel.tell(Shown("running", _keys(stops), title=title, keys={NEXT: "end the episode"}))

    return before


def _keys(stops: Stops) -> str:
    if stops.keys:
        return "Space stops the arm at once, Enter ends an episode."
    return "Ctrl-C, SIGTERM, or Space on the page stops the arm."


def _virtual(request: RobotRequest, task: Task, stack: ExitStack) -> tuple[VirtualArm | None, RobotSettings]:
    """The virtual arm that was asked for, and how the arm is reached."""
    settings = request.settings
    if settings.port != VIRTUAL:
        return None, settings
    virtual = stack.enter_context(VirtualArm(task.task_id, seed=request.seed or 0))
    return virtual, replace(settings, port=virtual.port, id=virtual.id, calibration_dir=str(virtual.calibration_dir))
