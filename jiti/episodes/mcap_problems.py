"""What is wrong with an MCAP recording, in words."""

from collections.abc import Mapping, Sequence
from itertools import groupby

import numpy as np

from jiti.episodes.episode import Problem
from jiti.episodes.mcap_contents import Contents, Loss
from jiti.episodes.mcap_read import Fault, Faults
from jiti.episodes.mcap_streams import McapStream

NAMED_STREAMS = 4
"""Losses are listed by stream up to so many. Our choice."""
LISTED_CHUNKS = 3
"""Chunks with the same damage are listed one by one up to so many. Our choice."""
_FIX_RECORDER = "Check what records this stream"


def loss_problems(file_name: str, contents: Contents, losses: Sequence[Loss], start_ns: int) -> list[Problem]:
    """Losses as problems; times in them count from `start_ns`, a log time."""
    problems = []
    for (_, remedy, _), alike in groupby(losses, key=lambda loss: (loss.what, loss.remedy, loss.chunk is None)):
        group = list(alike)
        if group[0].chunk is not None and len(group) > LISTED_CHUNKS:
            group = [_together(group)]
        for loss in group:
            what = f"{_place(loss, contents)} {loss.what}{_lost(loss, contents, start_ns)}"
            problems.append(Problem(file_name, what, remedy, "warning" if loss.counts == {} else "error"))
    return problems


def _together(losses: Sequence[Loss]) -> Loss:
    """Many chunks with the same damage as one loss; its place says how many."""
    counts: dict[int, int] | None = {}
    for loss in losses:
        if loss.counts is None:
            counts = None
            break
        for channel, count in loss.counts.items():
            counts[channel] = counts.get(channel, 0) + count
    times = [t for loss in losses for t in (loss.first_ns, loss.last_ns) if t is not None]
    span = (min(times), max(times)) if times else (None, None)
    return Loss(f"{len(losses)} chunks, the first {losses[0].where}, each of which", losses[0].what, counts, *span)


def _place(loss: Loss, contents: Contents) -> str:
    if loss.chunk is None:
        return loss.where
    return f"chunk {loss.chunk + 1} of {len(contents.chunks)} {loss.where}"


def _lost(loss: Loss, contents: Contents, start_ns: int) -> str:
    if loss.counts is None:
        return "; what it held is lost" if loss.chunk is not None else ""
    if not loss.counts:
        return ""
    total = sum(loss.counts.values())
    span = ""
    if loss.first_ns is not None and loss.last_ns is not None:
        first_s, last_s = ((t - start_ns) / 1e9 for t in (loss.first_ns, loss.last_ns))
        span = f" between {first_s:.3f} s and {last_s:.3f} s"
    topics = [
        f"{contents.channels[c].topic if c in contents.channels else f'channel {c}'} {n}"
        for c, n in sorted(loss.counts.items())
    ]
    listed = f" ({', '.join(topics)})" if len(topics) <= NAMED_STREAMS else f" of {len(topics)} streams"
    return f": {total} message{'s' if total != 1 else ''}{span} {'are' if total != 1 else 'is'} lost{listed}"


def chunk_losses(contents: Contents, streams: Sequence[McapStream], damaged: Mapping[int, str]) -> list[Loss]:
    """Losses of chunks that a pass found corrupt, counted by the index."""
    losses = []
    for number, reason in sorted(damaged.items()):
        counts: dict[int, int] = {}
        times: list[int] = []
        for stream in streams:
            inside = stream.rows.time_ns[stream.rows.chunk == number]
            if len(inside):
                counts[stream.channels[0]] = len(inside)
                times += [int(inside.min()), int(inside.max())]
        span = (min(times), max(times)) if times else (None, None)
        place = f"at byte {contents.chunks[number].offset}"
        losses.append(Loss(place, f"is corrupt ({reason})", counts or None, *span, chunk=number))
    return losses


def read_problems(file_name: str, streams: Mapping[str, McapStream], faults: Faults, start_ns: int) -> list[Problem]:
    """What a pass found wrong with single messages; times in it count from `start_ns`, in unwrapped time."""
    problems = []
    for name, fault in faults.left_out.items():
        stream = streams[name]
        kind = "pictures" if stream.reading.role == "picture" else "messages"
        count = f"{fault.count} of {len(stream.time_ns)} {kind}"
        what = f"{count} cannot be used and are left out; of the first, {fault.reason}"
        problems.append(_at(file_name, stream, fault, start_ns, what, _FIX_RECORDER))
    for name, fault in faults.other_format.items():
        stream = streams[name]
        what = f"{fault.count} of {len(stream.time_ns)} pictures are {fault.reason}; they are read as what they are"
        problems.append(_at(file_name, stream, fault, start_ns, what, _FIX_RECORDER))
    for name, component in faults.missing.items():
        what = f"its messages do not all have the same numbers; where {component!r} is missing it is NaN"
        problems.append(Problem(f"{file_name}, {name}", what, _FIX_RECORDER))
    for name, component in faults.unknown.items():
        what = f"numbers that neither the first nor the last message has are left out, such as {component!r}"
        problems.append(Problem(f"{file_name}, {name}", what, _FIX_RECORDER))
    return problems


def _at(file_name: str, stream: McapStream, fault: Fault, start_ns: int, what: str, remedy: str) -> Problem:
    time_s = (int(stream.time_ns[fault.index]) - start_ns) / 1e9
    where = f"{file_name}, {stream.name}, message {int(stream.number[fault.index])} at {time_s:.3f} s"
    return Problem(where, what, remedy)


def stream_problems(file_name: str, streams: Sequence[McapStream], supported: str) -> list[Problem]:
    """What is wrong with whole streams."""
    problems = []
    for stream in streams:
        where = f"{file_name}, {stream.name}"
        if stream.reading.unsupported is not None and len(stream.time_ns):
            what = f"channel {stream.channels[0]} cannot be read: {stream.reading.unsupported}"
            problems.append(Problem(where, what, f"Record it, or convert it, as one of these: {supported}"))
        if stream.reading.role == "picture" and not len(stream.time_ns):
            problems.append(Problem(where, "the camera has no pictures", _FIX_RECORDER))
        problems += [Problem(where, note, _FIX_RECORDER) for note in stream.notes]
    return problems


def late_problem(where: str, late: np.ndarray, frame_count: int, tolerance_ns: int) -> Problem:
    """A stream whose latest message is missing or old at some frames."""
    span = f"{late[0]}" if len(late) == 1 else f"first {late[0]}, last {late[-1]}"
    what = (
        f"at {len(late)} of {frame_count} frames ({span}) there is no message yet, "
        f"or the latest is older than {tolerance_ns / 1e9:.2f} s"
    )
    return Problem(where, what, "These frames show the latest message before them, or nothing")
