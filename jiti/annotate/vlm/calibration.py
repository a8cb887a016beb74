"""How a model's confidence is turned into how often it is right: one temperature a model, fitted on checked verdicts.

p' = sigmoid(logit(p) / T)     Guo et al., "On Calibration of Modern Neural Networks", 2017, with two classes
"""

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from jiti.durable import make_folder, write_atomic

_TEMPERATURES = [0.1 * 1.15**k for k in range(50)]
"""0.1 to 94: from much too timid to knowing nothing."""
LEAST = 20
"""Verdicts to fit on. Our choice: with fewer, one more mistake moves the temperature by a third."""


@dataclass(frozen=True, slots=True)
class Calibration:
    """Of one model. The default changes nothing."""

    temperature: float = 1.0
    verdicts: int = 0
    """That it was fitted on."""

    def apply(self, confidence: float) -> float:
        """Confidence of a verdict, 0 to 1, as often as such verdicts are right."""
        return 1 / (1 + math.exp(-_logit(confidence) / self.temperature))


def fit(confidences: Sequence[float], correct: Sequence[bool]) -> Calibration:
    """The temperature of least log loss; the default for fewer than `LEAST` verdicts."""
    if len(confidences) < LEAST:
        return Calibration()

    def loss(temperature: float) -> float:
        signed = [_logit(c) * (1 if right else -1) for c, right in zip(confidences, correct, strict=True)]
        # log(1 + exp(-z)), which is not to overflow.
        return sum(math.log1p(math.exp(-abs(z / temperature))) + max(0.0, -z / temperature) for z in signed)

    return Calibration(min(_TEMPERATURES, key=loss), len(confidences))


def _logit(p: float) -> float:
    p = min(max(p, 1e-6), 1 - 1e-6)
    return math.log(p / (1 - p))


def read_calibration(labels_dir: Path, model: str) -> Calibration:
    """The default where none was fitted, or what is there cannot be one."""
    try:
        found = Calibration(**json.loads(_path(labels_dir).read_bytes())[model])
        known = _TEMPERATURES[0] <= found.temperature <= _TEMPERATURES[-1]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return Calibration()
    return found if known else Calibration()


def write_calibration(labels_dir: Path, model: str, calibration: Calibration) -> None:
    """Raises SaveFailed."""
    path = _path(labels_dir)
    try:
        known = json.loads(path.read_bytes())
    except (OSError, ValueError, RecursionError):
        known = None
    known = known if isinstance(known, dict) else {}
    make_folder(path.parent)
    write_atomic(path, json.dumps(known | {model: asdict(calibration)}, indent=1).encode())


def _path(labels_dir: Path) -> Path:
    return labels_dir / "vlm" / "calibration.json"
