"""How rollouts look in Rerun. The rollouts' only Rerun calls.

One timeline, `step`: the environment's or the arm's, from 0, 20 or 30 a second.
"""

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jiti.durable import replacing
from jiti.runtime.rollout.chunk_path import chunk_path
from jiti.runtime.rollout.decide import Decided

if TYPE_CHECKING:
    import rerun as rr

TIMELINE = "step"
APPROXIMATE = (
    "Paths of candidates add up the displacements that their chunks command, scaled to what the arm makes of them: "
    "approximate, without rotation, contact or inertia.\n\n"
    "Blue: the default chunk. Green: the one that was executed. Grey: other candidates."
)
ARM = "Joints in degrees, the gripper in percent. Blue: where it is. Green: where it was sent."
BRANCH_COLORS = {"best": (44, 160, 44), "median": (255, 152, 0), "worst": (214, 39, 40), "random": (127, 127, 127)}
_DEFAULT, _CHOSEN, _OTHER, _THING = (70, 130, 230), (44, 160, 44), (150, 150, 150), (190, 170, 120)

os.environ.setdefault("RERUN_ANALYTICS_ENABLED", "false")  # Rerun sends usage statistics unless told not to.


@contextmanager
def live_recording(
    title: str, cameras: Sequence[str], path: Path, address: str | None = None, *, joints: Sequence[str] = ()
) -> Iterator["rr.RecordingStream"]:
    """A recording of one episode, kept in `path` in the end and shown meanwhile by the viewer at `address`: of a scene,
    or of an arm with these joints.

    Raises SaveFailed.
    """
    import rerun as rr

    recording = rr.RecordingStream("jiti rollout")
    with replacing(path) as temporary:
        sinks: list[Any] = [rr.FileSink(temporary), *([rr.GrpcSink(address)] if address else [])]
        recording.set_sinks(*sinks)
        recording.send_recording_name(title)
        recording.send_blueprint(_live_layout(cameras, joints), make_active=True)
        _curves(recording, "values/q", [("q_t", _DEFAULT), ("q_bar", _OTHER)])
        _curves(recording, "jumps/delta_q", [("delta_q", _DEFAULT), ("tau", BRANCH_COLORS["worst"])])
        points = rr.SeriesPoints(names="triggered", colors=BRANCH_COLORS["worst"])
        recording.log("values/triggered", points, static=True)
        about = ARM if joints else APPROXIMATE
        recording.log("about", rr.TextDocument(about, media_type="text/markdown"), static=True)
        for joint in joints:
            _curves(recording, f"joints/{joint}", [(joint, _DEFAULT), (f"{joint}, sent", _CHOSEN)])
        yield recording
        recording.disconnect()


def _live_layout(cameras: Sequence[str], joints: Sequence[str]) -> Any:
    """Pictures and scene, or joints, above; values, jumps and words below."""
    import rerun.blueprint as rrb

    above: list[Any] = [rrb.Spatial2DView(origin=f"camera/{camera}", name=camera) for camera in cameras]
    if joints:
        above.append(rrb.Grid(*(rrb.TimeSeriesView(origin=f"joints/{joint}", name=joint) for joint in joints)))
    else:
        above.append(rrb.Spatial3DView(origin="scene", name="candidates (approximate)"))
    below = [
        rrb.TimeSeriesView(origin="values", name="Q of the default, mean of those before, triggers"),
        rrb.TimeSeriesView(origin="jumps", name="jump of Q, tau"),
        rrb.Tabs(rrb.TextLogView(origin="said", name="decisions"), rrb.TextDocumentView(origin="about", name="about")),
    ]
    panels = [panel(state="collapsed") for panel in (rrb.SelectionPanel, rrb.BlueprintPanel, rrb.TimePanel)]
    return rrb.Blueprint(rrb.Vertical(rrb.Horizontal(*above), rrb.Horizontal(*below), row_shares=[3, 2]), *panels)


def draw_decision(recording: "rr.RecordingStream", decided: Decided, tau: float | None, hand_m: np.ndarray) -> None:
    """Values, whether it triggered, and the paths of the candidates from the hand's place (3,) m."""
    import rerun as rr

    draw_values(recording, decided, tau)
    paths = chunk_path(hand_m, decided.chunks)
    colors = [_OTHER] * len(paths)
    colors[0] = _DEFAULT
    colors[decided.decision.chosen] = _CHOSEN
    radii = [0.0015 if color == _OTHER else 0.003 for color in colors]
    recording.log("scene/candidates", rr.LineStrips3D(paths, colors=colors, radii=radii))


def draw_values(recording: "rr.RecordingStream", decided: Decided, tau: float | None) -> None:
    """Values, and whether it triggered, at the step that it was decided on."""
    import rerun as rr

    d = decided.decision
    recording.set_time(TIMELINE, sequence=decided.frame)
    if np.isfinite(d.q_t):
        recording.log("values/q", rr.Scalars([d.q_t, d.q_bar]))
        recording.log("jumps/delta_q", rr.Scalars([d.delta_q, float("nan") if tau is None else tau]))
    if d.triggered:
        recording.log("values/triggered", rr.Scalars(d.q_t))
    recording.log("said", rr.TextLog(said(decided), level="WARN" if d.problem else "INFO"))


def draw_arm(
    recording: "rr.RecordingStream",
    step: int,
    joints: Mapping[str, tuple[float, float]],
    pictures: Mapping[str, bytes],
) -> None:
    """Where each joint is and where it was sent, in its own unit, and JPEG pictures by camera."""
    import rerun as rr

    recording.set_time(TIMELINE, sequence=step)
    for joint, (seen, sent) in joints.items():
        recording.log(f"joints/{joint}", rr.Scalars([seen, sent]))
    _draw_pictures(recording, pictures)


def _draw_pictures(recording: "rr.RecordingStream", pictures: Mapping[str, bytes]) -> None:
    import rerun as rr

    for camera, data in pictures.items():
        recording.log(f"camera/{camera}", rr.EncodedImage(contents=data, media_type="image/jpeg"))


def said(decided: Decided) -> str:
    """A decision in words."""
    d = decided.decision
    if d.problem:
        return f"default: {d.problem}"
    if not np.isfinite(d.q_t):
        return "default: no critic was asked"
    value = f"Q {d.q_t:.3f}, mean before {d.q_bar:.3f}"
    if not d.values:
        return f"default: {value}{', nothing to choose from' if d.triggered else ''}"
    which = f"candidate {d.chosen}" if d.chosen else "default"
    return f"{which} of {len(d.values)}, Q {d.values[d.chosen]:.3f}: {value}"


def draw_state(
    recording: "rr.RecordingStream",
    step: int,
    hand_m: np.ndarray,
    path_m: Sequence[np.ndarray],
    things: Mapping[str, np.ndarray],
    pictures: Mapping[str, bytes],
) -> None:
    """The hand, where it has been, where things are (each (3,) m in the world), and JPEG pictures by camera."""
    import rerun as rr

    recording.set_time(TIMELINE, sequence=step)
    recording.log("scene/hand", rr.Points3D([hand_m], radii=0.008, colors=_CHOSEN, labels=["hand"]))
    if len(path_m) > 1:
        recording.log("scene/path", rr.LineStrips3D([np.array(path_m)], colors=_THING, radii=0.001))
    names = list(things)
    recording.log("scene/things", rr.Points3D([things[n] for n in names], radii=0.012, colors=_THING, labels=names))
    _draw_pictures(recording, pictures)


@dataclass(frozen=True)
class Branch:
    """What is drawn of one way on, by step of the episode."""

    outcome: str
    hand_m: np.ndarray
    """(steps, 3) in the world."""
    things_m: Mapping[str, np.ndarray]
    """(steps, 3) by name."""
    pictures: Sequence[bytes]
    """JPEG files, one a step; none without a camera."""
    q: Sequence[tuple[int, float, bool]]
    """Step, value of the default chunk, whether it triggered; of each decision."""


def write_branches(path: Path, branches: Mapping[str, Branch], *, cameras: bool) -> None:
    """Write an .rrd of several ways on from one decision, side by side, with the values of their default chunks.

    Raises SaveFailed.
    """
    import rerun as rr
    import rerun.blueprint as rrb

    recording = rr.RecordingStream("jiti branches")
    with replacing(path) as temporary:
        recording.save(temporary)
        views: list[Any] = []
        for pick, branch in branches.items():
            color = BRANCH_COLORS.get(pick, _OTHER)
            _draw_branch(recording, pick, branch, color)
            name = f"{pick}: {branch.outcome}"
            views.append(
                rrb.Spatial2DView(origin=f"{pick}/camera", name=name)
                if cameras
                else rrb.Spatial3DView(contents=[f"scene/{pick}/**"], name=name)
            )
        below = [
            rrb.Spatial3DView(origin="scene", name="all hands"),
            rrb.TimeSeriesView(origin="values", name="Q of the default, triggers"),
        ]
        panels = [panel(state="collapsed") for panel in (rrb.SelectionPanel, rrb.BlueprintPanel, rrb.TimePanel)]
        rows = rrb.Vertical(rrb.Horizontal(*views), rrb.Horizontal(*below), row_shares=[3, 2])
        recording.send_blueprint(rrb.Blueprint(rows, *panels), make_active=True)
        recording.disconnect()


def _draw_branch(recording: "rr.RecordingStream", pick: str, branch: Branch, color: tuple[int, int, int]) -> None:
    import rerun as rr

    steps = len(branch.hand_m)
    index = rr.TimeColumn(TIMELINE, sequence=np.arange(steps))
    recording.log(f"scene/{pick}/path", rr.LineStrips3D([branch.hand_m], colors=color, radii=0.0015), static=True)
    hand = f"scene/{pick}/hand"
    recording.log(hand, rr.Points3D.from_fields(colors=color, radii=0.008, labels=pick), static=True)
    recording.send_columns(hand, [index], rr.Points3D.columns(positions=branch.hand_m))
    names = list(branch.things_m)
    if names:
        things = f"scene/{pick}/things"
        # Without names in the picture, which would lie there once for each way.
        shape = rr.Points3D.from_fields(colors=_THING, radii=0.012, labels=names, show_labels=False)
        recording.log(things, shape, static=True)
        places = np.stack([branch.things_m[name] for name in names], axis=1).reshape(-1, 3)
        columns = rr.Points3D.columns(positions=places).partition(np.full(steps, len(names)))
        recording.send_columns(things, [index], columns)
    if branch.pictures:
        shown = rr.EncodedImage.columns(blob=list(branch.pictures), media_type=["image/jpeg"] * len(branch.pictures))
        at = rr.TimeColumn(TIMELINE, sequence=np.arange(len(branch.pictures)))
        recording.send_columns(f"{pick}/camera", [at], shown)
    _curves(recording, f"values/{pick}", [(f"Q, {pick}", color)])
    recording.log(f"values/{pick}_triggered", rr.SeriesPoints(names=f"triggered, {pick}", colors=color), static=True)
    for step, q, triggered in branch.q:
        recording.set_time(TIMELINE, sequence=step)
        recording.log(f"values/{pick}", rr.Scalars(q))
        if triggered:
            recording.log(f"values/{pick}_triggered", rr.Scalars(q))


def _curves(recording: "rr.RecordingStream", entity: str, curves: Sequence[tuple[str, tuple[int, int, int]]]) -> None:
    import rerun as rr

    names, colors = zip(*curves, strict=True)
    recording.log(entity, rr.SeriesLines(names=names, colors=colors), static=True)
