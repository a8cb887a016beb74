"""Fit a model's calibration to verdicts that people, or a simulator, have checked."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from jiti.annotate.evaluate import FOUND_IOU, verdict_pairs
from jiti.annotate.matching import match
from jiti.annotate.segments import Segment
from jiti.annotate.vlm.calibration import LEAST, Calibration, fit, write_calibration
from jiti.annotate.vlm.notes import notes_path, read_notes
from jiti.annotate.vlm.propose import segments_of
from jiti.episodes.episode import EpisodeReader
from jiti.errors import LabelError, SourceError
from jiti.tasks.catalogue import Catalogue


def calibrate(
    reader: EpisodeReader,
    catalogue: Catalogue,
    labels_dir: Path,
    reference: Mapping[tuple[str, str], Sequence[Segment]],
) -> dict[str, Calibration]:
    """The temperature of each model that gave verdicts, written beside its notes; the next run applies it.

    `reference` has checked segments by episode and ITC. Verdicts that numbers decided do not count. Raises LabelError
    when no model has `LEAST` verdicts on segments of the reference.
    """
    sure: dict[str, list[tuple[float, bool]]] = {}
    for ref in reader.episodes():
        if not notes_path(labels_dir, ref.episode_id).exists():
            continue
        try:
            episode = reader.open(ref.episode_id)
        except SourceError:
            continue
        notes = read_notes(notes_path(labels_dir, ref.episode_id), episode.fingerprint)
        by_itc: dict[str, list[Segment]] = {}
        models = {
            name: itc.decisions[0].model for name, itc in notes.itcs.items() if itc.decisions and not itc.measured
        }
        for segment in segments_of(notes, episode, catalogue.for_episode(episode), lambda _model: Calibration()):
            if segment.itc_id in models:
                by_itc.setdefault(segment.itc_id, []).append(segment)
        for itc_id, segments in by_itc.items():
            matches, _, _ = match(reference.get((ref.episode_id, itc_id), ()), segments, least_iou=FOUND_IOU)
            for pair in verdict_pairs(matches):
                if pair.b.confidence is not None:
                    sure.setdefault(models[itc_id], []).append((pair.b.confidence, pair.a.reward == pair.b.reward))
    fitted = {model: fit(*zip(*pairs, strict=True)) for model, pairs in sure.items() if len(pairs) >= LEAST}
    if not fitted:
        counts = ", ".join(f"{model} {len(pairs)}" for model, pairs in sure.items()) or "none"
        raise LabelError(
            f"a calibration needs {LEAST} verdicts of one model on checked segments; there are: {counts}. Check more."
        )
    for model, calibration in fitted.items():
        write_calibration(labels_dir, model, calibration)
    return fitted
