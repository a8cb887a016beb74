"""Proposals from a recording's own numbers: where each constraint is probably decided.

Where recorded poses decide a constraint (`jiti.annotate.measured`), it is there, and with `fuse` the verdict is theirs.
Elsewhere the place follows from the Elegance Criterion and from when the gripper closed and opened; whether the
constraint was met then needs eyes, so the verdict is left to the reviewer.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from jiti.annotate.events import Event, EventKind, Events, find_events
from jiti.annotate.measured import MEASURED_CONFIDENCE, Measured
from jiti.annotate.segments import DEFAULT_WINDOW_FRAMES, Segment
from jiti.annotate.window import proposed_window
from jiti.episodes.episode import Episode
from jiti.tasks.task import Criterion, Task

ANNOTATOR = "signal"
"""Name of the partition that these proposals are written to."""

AFTER_FRAMES = 5
"""Frames of a window that lie after the transition which decides a sequence. Our choice: an object that was let go
of too high or too early has visibly moved by then, a quarter of a second at 20 Hz."""

GUESS = 0.5
"""Factor on the confidence of a place for which there was no gripper transition of the expected kind. Our choice."""


@dataclass(frozen=True, slots=True)
class _Hold:
    """One time that a gripper held something: from a close to the open after it, either of which may be missing."""

    close: Event | None
    open: Event | None

    @property
    def decisive(self) -> Event | None:
        return self.open or self.close


def propose_segments(
    episode: Episode,
    task: Task,
    events: Events | None = None,
    *,
    measured: Mapping[str, Measured | None] | None = None,
    fuse: bool = True,
) -> list[Segment]:
    """A window of `DEFAULT_WINDOW_FRAMES` for every constraint of a task and every time that something was held.

    `measured` has what recorded poses decided, by ITC; of that there is one window, with the verdict where `fuse` is
    set. Without any gripper transition, one window for each other constraint ends where the motion ends; without any
    event there is no proposal. All have status `proposed`, source `signal`, and say in a sentence why they are there.
    """
    events = find_events(episode) if events is None else events
    holds = _holds(events)
    proposals = []
    for itc in task.itcs:
        if (known := (measured or {}).get(itc.itc_id)) is not None:
            verdict = (
                {"reward": int(known.satisfied), "rationale": known.reason}
                if fuse
                else {"rationale": f"Recorded poses settle it at frame {known.frame}."}
            )
            proposals.append(
                proposed_window(episode, itc, known.frame, source="signal", confidence=MEASURED_CONFIDENCE, **verdict)
            )
            continue
        places = [_place(itc.criterion, hold, events) for hold in holds] or [_place_without_gripper(events)]
        for place in places:
            if place is not None:
                end, confidence, why = place
                proposals.append(
                    proposed_window(episode, itc, end, source="signal", confidence=round(confidence, 3), rationale=why)
                )
    return proposals


def _holds(events: Sequence[Event]) -> list[_Hold]:
    """Closes with the opens that follow on the same side; opens before any close and repeated closes count for nothing.

    When no gripper ever closed, its opens are releases of something that was held from the start.
    """
    holds: list[_Hold] = []
    sides = dict.fromkeys(e.side for e in events)
    for side in sides:
        closed: Event | None = None
        own = [e for e in events if e.side == side and e.kind in ("gripper_close", "gripper_open")]
        if not any(e.kind == "gripper_close" for e in own):
            holds += [_Hold(None, e) for e in own]
        for event in own:
            if event.kind == "gripper_close":
                closed = closed or event
            elif closed is not None:
                holds.append(_Hold(closed, event))
                closed = None
        if closed is not None:
            holds.append(_Hold(closed, None))
    return sorted(holds, key=lambda hold: hold.decisive.frame if hold.decisive else 0)


def _place(criterion: Criterion, hold: _Hold, events: Sequence[Event]) -> tuple[int, float, str] | None:
    """Last frame of the window, confidence in it, and the reason."""
    decisive = hold.decisive
    if decisive is None:
        return None
    word = "opens" if decisive.kind == "gripper_open" else "closes"
    fact = f"The gripper {word} at frame {decisive.frame} ({decisive.stream}, sharpness {decisive.sharpness:.2f})"
    match criterion:
        case Criterion.TASK_SEQUENCE_INTEGRITY:
            return decisive.frame + AFTER_FRAMES, decisive.sharpness, f"{fact}: the step ends here."
        case Criterion.TARGET_POSE_ACCURACY | Criterion.POSE_ALIGNMENT:
            return decisive.frame, decisive.sharpness, f"{fact}: the pose is decided in the frames before."
        case Criterion.COLLISION_FREE_EXECUTION:
            return _transport(hold, decisive, fact, events)


def _transport(hold: _Hold, decisive: Event, fact: str, events: Sequence[Event]) -> tuple[int, float, str]:
    """Between grasp and release: around a contact if there was one, else the last window before the final approach."""
    half = DEFAULT_WINDOW_FRAMES // 2
    if hold.close is None or hold.open is None:
        # Nothing was carried to anywhere: what can be hit is on the way to or from the one transition there is.
        return decisive.frame + half, GUESS * decisive.sharpness, f"{fact}: what is near can be touched around it."
    start, end = hold.close.frame, hold.open.frame
    touched = _first_in(events, ("contact_on",), start + half, end - half)
    if touched is not None:
        why = f"{touched.stream} shows a contact at frame {touched.frame}, between grasp ({start}) and release ({end})."
        return touched.frame + half, touched.sharpness, why
    last = max(end - DEFAULT_WINDOW_FRAMES, min(start + DEFAULT_WINDOW_FRAMES, end))
    confidence = GUESS * min(hold.close.sharpness, hold.open.sharpness)
    return last, confidence, f"Carried from frame {start} (gripper closes) to frame {end} (gripper opens)."


def _place_without_gripper(events: Sequence[Event]) -> tuple[int, float, str] | None:
    """For pushes and pulls: the last stop, where what was moved stands still."""
    stops = [e for e in events if e.kind == "velocity_zero"]
    if not stops:
        return None
    stop = stops[-1]
    why = f"No gripper moves; the motion ends at frame {stop.frame} ({stop.stream}, sharpness {stop.sharpness:.2f})."
    return stop.frame + AFTER_FRAMES, GUESS * stop.sharpness, why


def _first_in(events: Sequence[Event], kinds: tuple[EventKind, ...], start: int, end: int) -> Event | None:
    return next((e for e in events if e.kind in kinds and start < e.frame < end), None)
