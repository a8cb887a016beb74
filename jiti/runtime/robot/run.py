"""Episodes on an arm, one after another: engage, act, go back to rest, let go, save, and have it looked at."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from jiti.errors import RobotError
from jiti.runtime.robot.inference import Facts, Inference
from jiti.runtime.robot.loop import go_back, prompt, run_episode
from jiti.runtime.robot.recording import Recording
from jiti.runtime.robot.report import EpisodeSummary, summarize
from jiti.runtime.robot.safe_arm import SafeArm
from jiti.runtime.robot.stops import Stopped, Stops
from jiti.runtime.robot.tick import Watcher, observation_of
from jiti.runtime.robot.turn import Turn

OPEN_S = 5.0
"""In which an arm that was opened must have been read once. Our choice."""


@dataclass(frozen=True, slots=True)
class Recorded:
    """An episode that is over: what is to be looked at. The arm has no torque."""

    turn: Turn
    ended: str


BeforeEpisode = Callable[[Turn], None]
"""Is called before each episode, while the arm has no torque: the things are laid out, say."""
AfterEpisode = Callable[[Recorded], None]
"""Is called after each episode that was not stopped, for a person's verdicts, say; the next one waits for it."""
MakeRecording = Callable[[Turn], Recording]


@dataclass
class Runner:
    """An open arm, and who decides for it."""

    arm: SafeArm
    inference: Inference
    stops: Stops
    make_recording: MakeRecording
    before_episode: BeforeEpisode = lambda _turn: None
    keep_episode: AfterEpisode = lambda _recorded: None
    """Before anything else can stop it."""
    after_episode: AfterEpisode = lambda _recorded: None
    watchers: Sequence[Watcher] = ()
    """Beside the recording."""
    _ended: str = ""

    def open(self) -> Facts:
        """Wait for policy and critic; the arm is at rest meanwhile. Raises Stopped."""
        self.arm.begin_reading()
        for _ in range(round(OPEN_S * self.arm.settings.fps)):
            if (seen := self.arm.observe()) is not None:
                observation = observation_of(seen, self.arm.joints, tuple(self.arm.robot.cameras))
                return self.inference.open(observation, self.stops.look)
        raise RobotError("the arm cannot be read. Check its cables.")

    def play(
        self, facts: Facts, turns: Sequence[Turn], seconds: float
    ) -> tuple[list[EpisodeSummary], Exception | None]:
        """Episodes, and what ended them before the last: Stopped, or an error. All that was done is saved."""
        done: list[EpisodeSummary] = []
        try:
            for turn in turns:
                self.before_episode(turn)
                self._play_one(facts, turn, seconds, done)
        except Exception as problem:
            return done, problem
        return done, None

    def _play_one(self, facts: Facts, turn: Turn, seconds: float, done: list[EpisodeSummary]) -> None:
        """An episode, which is added to those that are done before what ended it is raised."""
        recording = self.make_recording(turn)
        problem = self._episode(facts, turn, recording, seconds)
        whole = problem is None
        ended = str(problem) if problem else self._ended
        try:
            with self.stops.guarded():
                recording.finish(ended)
        except Stopped as stopped:  # by a signal while it was saved
            problem = problem or stopped
        except Exception as error:
            problem, whole = problem or error, False
        done.append(summarize(recording, turn, ended))
        if whole:
            self.keep_episode(Recorded(turn, ended))
        if problem is not None:
            raise problem
        self.after_episode(Recorded(turn, ended))

    def _episode(self, facts: Facts, turn: Turn, recording: Recording, seconds: float) -> Exception | None:
        """What stopped it, after which the arm is at rest in any case."""
        arm = self.arm
        try:
            self.inference.begin(turn.seed, turn.guidance)
            with self.stops.guarded(), prompt():
                try:
                    arm.engage()
                    rest = dict(arm.goal)
                    watchers = (recording, *self.watchers)
                    self._ended = run_episode(arm, self.inference, facts, self.stops, watchers, seconds=seconds)
                    if not arm.dry:
                        go_back(arm, self.stops, rest)
                    arm.release()
                except BaseException as error:
                    arm.stop(error)
                    raise
        except Exception as error:
            return error
        return None
