"""Saying that labels fit recordings which were changed after they were labelled: a dataset edited by hand, a file
written anew."""

from jiti.annotate.labels import read_labels
from jiti.annotate.names import MACHINES
from jiti.annotate.proposals import write_proposals
from jiti.annotate.segment_file import Recording, to_segments
from jiti.annotate.web.session import Session
from jiti.errors import LabelError
from jiti.progress import Progress


def confirm_recordings(session: Session, progress: Progress = lambda _share, _what: None) -> list[str]:
    """Let all labels be of the recordings that are here now; gives the episodes of which they were not.

    Raises LabelError for a segment that ends after its recording, SourceError; then nothing is written.
    """
    labels_dir = session.store.labels_dir
    refs = session.refs()
    labels = read_labels(labels_dir, episodes=[ref.episode_id for ref in refs]).whole()
    columns = (labels.recordings[name].to_pylist() for name in ("annotator", "episode_id", "fingerprint"))
    known: dict[str, list[tuple[str, str]]] = {}
    for annotator, episode_id, fingerprint in zip(*columns, strict=True):
        known.setdefault(episode_id, []).append((annotator, fingerprint))
    last: dict[str, int] = {}
    for episode_id, frame in zip(*(labels.segments[c].to_pylist() for c in ("episode_id", "end_frame")), strict=True):
        last[episode_id] = max(frame, last.get(episode_id, 0))
    changed: list[tuple[str, str, Recording]] = []
    for number, (episode_id, labelled) in enumerate(known.items()):
        progress(number / len(known), episode_id)
        episode = session.reader.open(episode_id)
        now = Recording(episode.clock.frame_count, episode.clock.rate_hz, episode.fingerprint)
        other = [annotator for annotator, fingerprint in labelled if fingerprint != now.fingerprint]
        if other and last.get(episode_id, 0) >= now.frame_count:
            raise LabelError(
                f"{episode_id} has {now.frame_count} frames, and a segment that ends at frame {last[episode_id]}. "
                "Mend or remove it with `jiti annotate`; nothing was confirmed."
            )
        changed += [(annotator, episode_id, now) for annotator in other]
    for annotator, episode_id, now in changed:
        if annotator in MACHINES:
            proposals = to_segments(read_labels(labels_dir, annotators=[annotator], episodes=[episode_id]).segments)
            write_proposals(labels_dir, annotator, episode_id, proposals, now)
        else:
            partition = session.store.partition(annotator, episode_id, now)
            partition.confirm(now, based_on=partition.version)
    return list(dict.fromkeys(episode_id for _, episode_id, _ in changed))
