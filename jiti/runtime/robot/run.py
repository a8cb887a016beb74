"""Episodes on an arm, one after another: engage, act, go back to rest, let go, save, and have it looked at."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from jiti.errors import RobotError
from jiti.runtime.robot.inference import Facts, Inference
from jiti.runtime.robot.loop import go_back, prompt, run_episode
from jiti.runtime.robot.recording import Recording
from jiti.runtime.robot.report import EpisodeSummary, summarize
from jiti.runtime.robot.safe_arm import SafeArm
from jiti.runtime.robot.stops import Stops
from jiti.runtime.robot.tick import Watcher, observation_of
from jiti.tasks.task import Task

OPEN_S = 5.0
"""In which an arm that was opened must have been read once. Our choice."""


@dataclass(frozen=True, slots=True)
class Recorded:
    """An episode that is over: what is to be looked at. The arm has no torque."""

    task: Task
    label: str
    """The guidance."""
    seed: int
    path: Path | None
    """The recording; None where none was made."""
    ended: str


AfterEpisode = Callable[[Recorded], None]
"""Is called after each episode that was not stopped, for a person's verdicts, say; the next one waits for it."""
MakeRecording = Callable[[int], Recording]
"""Of the episode with a seed."""


@dataclass
class Runner:
    """An open arm, and who decides for it."""

    arm: SafeArm
    inference: Inference
    stops: Stops
    task: Task
    label: str
    make_recording: MakeRecording
    after_episode: AfterEpisode = lambda _recorded: None
    watchers: Sequence[Watcher] = ()
    """Beside the recording."""

    def open(self) -> Facts:
        """Wait for policy and critic; the arm is at rest meanwhile."""
        self.arm.begin_reading()
        for _ in range(round(OPEN_S * self.arm.settings.fps)):
            if (seen := self.arm.observe()) is not None:
                return self.inference.open(observation_of(seen, self.arm.joints, tuple(self.arm.robot.cameras)))
        raise RobotError("the arm cannot be read. Check its cables.")

    def play(self, facts: Facts, seeds: Sequence[int], seconds: float) -> tuple[list[EpisodeSummary], Exception | None]:
        """Episodes, and what ended them before the last: Stopped, or an error. All that was done is saved."""
        done: list[EpisodeSummary] = []
        try:
            for seed in seeds:
                self._play_one(facts, seed, seconds, done)
        except Exception as problem:
            return done, problem
        return done, None

    def _play_one(self, facts: Facts, seed: int, seconds: float, done: list[EpisodeSummary]) -> None:
        """An episode, which is added to those that are done before what ended it is raised."""
        recording = self.make_recording(seed)
        problem = self._episode(facts, seed, recording, seconds)
        ended = str(problem) if problem else "time or Enter"
        try:
            with self.stops.guarded():
                recording.finish(ended)
        except Exception as error:
            problem = problem or error
        done.append(summarize(recording, seed, ended))
        if problem is not None:
            raise problem
        self.after_episode(Recorded(self.task, self.label, seed, recording.path, ended))

    def _episode(self, facts: Facts, seed: int, recording: Recording, seconds: float) -> Exception | None:
        """What stopped it, after which the arm is at rest in any case."""
        arm = self.arm
        try:
            self.inference.begin(seed)
            with self.stops.guarded(), prompt():
                try:
                    arm.engage()
                    rest = dict(arm.goal)
                    run_episode(arm, self.inference, facts, self.stops, (recording, *self.watchers), seconds=seconds)
                    if not arm.dry:
                        go_back(arm, self.stops, rest)
                    arm.release()
                except BaseException as error:
                    arm.stop(error)
                    raise
        except Exception as error:
            return error
        return None
