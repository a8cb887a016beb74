"""What `jiti curate` has done, for a person and for a script."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True)
class Curated:
    """What was written. Its text is for a person."""

    out: Path
    episodes: int
    frames: int
    fps: int
    elegant: int
    judged: int
    splits: Mapping[str, int]
    unlabelled: int
    filtered: int
    notes: tuple[str, ...]
    splits_kept: tuple[str, ...] = ()
    """Datasets of jiti whose splits were kept."""
    splits_anew: tuple[str, ...] = ()
    """Datasets of jiti whose splits were dealt anew."""
    weights: Path | None = None
    report: Path | None = None

    def __str__(self) -> str:
        splits = ", ".join(f"{name} {count}" for name, count in self.splits.items())
        lines = [
            f"{self.episodes} episodes, {self.frames} frames at {self.fps} Hz in {self.out}.",
            f"{self.elegant} of {self.judged} judged episodes are elegant; splits: {splits}.",
        ]
        if self.splits_kept:
            kept = ", ".join(self.splits_kept)
            lines.append(f"Splits are those of {kept}; --split, --seed or --unseen deals all of them anew.")
        if self.splits_anew:
            lines.append(f"Splits were dealt anew; those of {', '.join(self.splits_anew)} were not kept.")
        if self.unlabelled:
            lines.append(f"Left out: {self.unlabelled} episodes without labels that count (--unlabelled keep).")
        if self.filtered:
            lines.append(f"Left out: {self.filtered} episodes by --filter.")
        lines += self.notes[:20]
        if len(self.notes) > 20:
            lines.append(f"{len(self.notes) - 20} more notes; --json lists all.")
        return "\n".join((*lines, *_beside(self.weights, self.report)))

    def to_json(self) -> str:
        """For `--json`."""
        told = asdict(self) | {name: str(getattr(self, name) or "") or None for name in ("out", "weights", "report")}
        return json.dumps(told, indent=2, ensure_ascii=False)


@dataclass(frozen=True, slots=True)
class Added:
    """What was written into a dataset that was there. Its text is for a person."""

    weights: Path | None = None
    report: Path | None = None

    def __str__(self) -> str:
        return "\n".join(_beside(self.weights, self.report))

    def to_json(self) -> str:
        """For `--json`."""
        return json.dumps({name: str(path) for name, path in asdict(self).items() if path}, indent=2)


def _beside(weights: Path | None, report: Path | None) -> Iterator[str]:
    if weights:
        yield (
            f"Weights for lerobot-train: {weights}. "
            "--sample_weighting.type=rabc takes them with --dataset.root; see docs/curate.md."
        )
    if report:
        yield f"Report: {report}"
