"""Whether the labels of a source are of its recordings, and what to do where they are not."""

from dataclasses import dataclass
from pathlib import Path

from jiti.annotate.folder import annotator_dirs
from jiti.annotate.labels import read_labels
from jiti.annotate.names import MACHINES
from jiti.curate.export.sources import Source
from jiti.episodes.episode import Episode, EpisodeRef
from jiti.episodes.folder_reader import LABELS_FOLDER
from jiti.episodes.lerobot_reader import LeRobotReader
from jiti.episodes.mcap_reader import mcap_episode_id
from jiti.errors import LabelError


def check_labels(source: Source) -> None:
    """Raises LabelError for labels of a recording that is not there."""
    listed = {ref.episode_id for ref in source.reader.episodes()}
    lost = sorted(source.counted.recordings.keys() - listed)
    if not lost:
        return
    whole = _whole_of(source)
    if whole and whole.labels_dir == source.labels_dir.absolute():
        raise LabelError(f"{source.labels_dir} has labels of a whole folder, of which {source.name} is a part. {whole}")
    more = f" and {len(lost) - 1} more" if len(lost) > 1 else ""
    raise LabelError(
        f"{source.labels_dir} has labels of {lost[0]!r}{more}, and {source.name} has no such episode. "
        "Restore the recording, or move its labels away: "
        f"{source.labels_dir}/segments/annotator=*/{lost[0]}.parquet."
    )


def check_recording(source: Source, ref: EpisodeRef, episode: Episode) -> None:
    """Raises LabelError where another recording was labelled."""
    about = source.counted.recordings.get(ref.episode_id)
    if about is None or about.fingerprint == episode.fingerprint:
        return
    then, now = about.frame_count, episode.clock.frame_count
    lengths = f"it had {then} frames and has {now}" if then != now else f"it has {now} frames, as then"
    raise LabelError(
        f"{source.name}, {ref.title}: the recording was changed after it was labelled ({lengths}). Restore it, or look "
        f"whether the segments still fit, with `jiti annotate {source.given}`; where they do, "
        f"`jiti validate-rewards {source.given} --confirm` says so."
    )


def nothing_counts(source: Source, rule: str) -> LabelError:
    """What to do about a source of which no label counts."""
    there = f"{source.name}: nothing in {source.labels_dir} counts by the rule {rule!r}."
    proposals = [name for name in source.counted.annotators if name in MACHINES]
    if not source.counted.annotators and (whole := _whole_of(source)):
        return LabelError(f"{there} There are labels of a whole folder, of which it is a part. {whole}")
    if proposals:
        remedy = (
            f"There are proposals of {', '.join(proposals)}: review them with `jiti annotate {source.given}`, or count "
            f"them as they are with --accept {proposals[0]}"
        )
    else:
        remedy = f"Label it with `jiti annotate {source.given}`; `jiti autolabel {source.given}` makes proposals"
    return LabelError(f"{there} {remedy}; --unlabelled keep takes episodes without labels.")


@dataclass(frozen=True, slots=True)
class _Whole:
    """A folder whose labels are of recordings of a source, which is a part of it."""

    folder: Path
    condition: str
    """Of `--filter`, for that part alone."""

    @property
    def labels_dir(self) -> Path:
        return self.folder / LABELS_FOLDER

    def __str__(self) -> str:
        here = Path.cwd()
        folder = self.folder.relative_to(here) if self.folder.is_relative_to(here) else self.folder
        return f'Curate that folder and keep this part: `jiti curate {folder} --filter "{self.condition}"`.'


def _whole_of(source: Source) -> _Whole | None:
    if isinstance(source.reader, LeRobotReader):
        return None
    root = Path(source.reader.labels_dir).parent
    for folder in root.parents:
        prefix = mcap_episode_id(root / "a.mcap", folder).removesuffix("a")
        if any(True for _, labels in annotator_dirs(folder / LABELS_FOLDER) for _ in labels.glob(f"{prefix}*.parquet")):
            return _Whole(folder, _condition(folder / LABELS_FOLDER, prefix))
    return None


def _condition(labels_dir: Path, prefix: str) -> str:
    """By task where the labels of the part are of one that no other has, else by what its episodes' ids begin with."""
    table = read_labels(labels_dir).segments
    tasks: dict[bool, set[str]] = {True: set(), False: set()}
    for episode_id, itc_id in zip(table["episode_id"].to_pylist(), table["itc_id"].to_pylist(), strict=True):
        tasks[episode_id.startswith(prefix)].add(itc_id.rpartition("/")[0])
    own = tasks[True] - tasks[False] - {"generic"}
    return f"task == '{own.pop()}'" if len(own) == 1 == len(tasks[True]) else f"'{prefix}' in episode"
