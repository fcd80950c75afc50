"""Detectors on disk: safetensors with a description in the header; nothing in it is executed."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from safetensors import SafetensorError, safe_open

from ...factory.common.array_types import Array
from ...factory.common.errors import FactoryError
from ...factory.common.files import write_atomically

if TYPE_CHECKING:
    from .network import DetectorNetwork

FORMAT = "simnfnd-detector/1"
_KEY = "simnfnd"


@dataclass(frozen=True)
class Calibration:
    """Score of the network -> probability that a detection is right, a logistic function.

    slope, offset: of the logarithm of the odds.
    """

    slope: float = 1.0
    offset: float = 0.0

    def __call__(self, scores: Array) -> Array:
        """(N,) probabilities of (N,) scores in 0..1."""
        inside = np.clip(scores.astype(np.float64), 1e-6, 1 - 1e-6)
        odds = self.slope * np.log(inside / (1 - inside)) + self.offset
        return np.asarray(1 / (1 + np.exp(-odds)), np.float32)


@dataclass(frozen=True, eq=False)
class DetectorFacts:
    """What a file says of its detector.

    training: facts of its training.  calibration: None where it was not calibrated.
    """

    classes: tuple[str, ...]
    training: Mapping[str, Any] = field(default_factory=dict)
    calibration: Calibration | None = None

    @property
    def margin(self) -> float:
        """How far boxes grow on every side, as a share of the longer side of the image.

        Negative where the detector learned wider boxes than people draw.
        """
        return float(self.training.get("margin", 0.0))


@dataclass(frozen=True, eq=False)
class TrainedDetector:
    """A network in evaluation mode, what its file says of it, and that file."""

    network: DetectorNetwork
    facts: DetectorFacts
    path: Path


def save_detector(path: Path, network: DetectorNetwork, facts: DetectorFacts) -> None:
    """Write a detector in 16 bits, whole or not at all; same weights, same bytes."""
    from safetensors.torch import save

    tensors = {
        name: (tensor.half() if tensor.is_floating_point() else tensor).detach().contiguous()
        for name, tensor in sorted(network.state_dict().items())
    }
    write_atomically(path, save(tensors, _header_of(facts)), key="out")


def calibrate_file(path: Path, calibration: Calibration) -> None:
    """Write the calibration into the header of a detector; its weights stay."""
    from safetensors.numpy import save

    facts = read_facts(path)
    with safe_open(path, framework="np") as file:
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    calibrated = DetectorFacts(facts.classes, facts.training, calibration)
    write_atomically(path, save(tensors, _header_of(calibrated)), key="out")


def _header_of(facts: DetectorFacts) -> dict[str, str]:
    header: dict[str, Any] = {
        "format": FORMAT,
        "classes": list(facts.classes),
        "training": dict(facts.training),
    }
    if facts.calibration is not None:
        header["calibration"] = [facts.calibration.slope, facts.calibration.offset]
    return {_KEY: json.dumps(header, sort_keys=True)}


def load_detector(path: Path) -> TrainedDetector:
    """Read a detector into torch, on the CPU, in 32 bits.  Raises FactoryError as the next."""
    import torch

    from .network import DetectorNetwork

    facts, tensors = read_detector(path)
    network = DetectorNetwork(len(facts.classes))
    try:
        values = {name: torch.from_numpy(tensor) for name, tensor in tensors.items()}
        network.load_state_dict(values, strict=False)
    except RuntimeError as error:
        raise FactoryError(f"detector={path}: weights of another network; train again") from error
    network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    return TrainedDetector(network.eval(), facts, path)


def read_detector(path: Path) -> tuple[DetectorFacts, dict[str, Array]]:
    """The facts of a detector, and its weights in 32 bits.

    Raises FactoryError for any other file, and for weights that are not finite.
    """
    facts = read_facts(path)
    problem = f"detector={path}: no detector of this program, or a damaged one"
    try:
        with safe_open(path, framework="np") as file:
            names = [name for name in file.keys() if not name.endswith("num_batches_tracked")]  # noqa: SIM118
            tensors = {name: file.get_tensor(name).astype(np.float32) for name in names}
        head_shape = tensors["heads.weight"].shape
    except (SafetensorError, OSError, TypeError, ValueError, KeyError) as error:
        raise FactoryError(f"{problem}; give one that `simnfnd evaluate transfer` wrote") from error
    if head_shape[:1] != (5 + len(facts.classes),):
        raise FactoryError(f"{problem}; give one that `simnfnd evaluate transfer` wrote")
    if not all(np.isfinite(tensor).all() for tensor in tensors.values()):
        raise FactoryError(f"{problem}: it holds NaN or infinity; train again")
    return facts, tensors


def read_facts(path: Path) -> DetectorFacts:
    """What a detector's file says of it.  Raises FactoryError for any other file."""
    try:
        with safe_open(path, framework="np") as file:
            header = json.loads((file.metadata() or {}).get(_KEY, "{}"))
    except (SafetensorError, OSError, ValueError, RecursionError) as error:
        raise FactoryError(f"detector={path}: not a safetensors file, or a damaged one") from error
    classes = header.get("classes") if isinstance(header, dict) else None
    is_ours = isinstance(classes, list) and all(isinstance(name, str) for name in classes)
    if not is_ours or header.get("format") != FORMAT or not classes:
        raise FactoryError(f"detector={path}: not a detector ({FORMAT}) of this program")
    training = header.get("training", {})
    margin = training.get("margin", 0.0) if isinstance(training, dict) else None
    numbers = header.get("calibration", [1.0, 0.0])
    is_pair = isinstance(numbers, list) and len(numbers) == 2
    if not (is_pair and all(_is_within(number, 20) for number in numbers)):
        raise FactoryError(f"detector={path}: `calibration` in the header is damaged")
    if not _is_within(margin, 0.2):
        raise FactoryError(f"detector={path}: `training` in the header is damaged")
    calibration = Calibration(*numbers) if "calibration" in header else None
    return DetectorFacts(tuple(classes), training, calibration)


def _is_within(value: object, most: float) -> bool:
    return isinstance(value, int | float) and -most <= value <= most


def fit_calibration(scores: Array, is_right: Array) -> Calibration:
    """The calibration of detections that were judged, by logistic regression (Platt 1999).

    scores: (N,) in 0..1 as the network gives them.  is_right: (N,) whether there was an object.
    """
    from scipy.optimize import minimize

    inside = np.clip(scores.astype(np.float64), 1e-6, 1 - 1e-6)
    odds = np.log(inside / (1 - inside))
    right_count = int(is_right.sum())
    # Platt's targets, which few detections cannot drive to infinity.
    target = np.where(
        is_right, (right_count + 1) / (right_count + 2), 1 / (len(is_right) - right_count + 2)
    )

    def loss(parameters: Array) -> float:
        logits = parameters[0] * odds + parameters[1]
        return float(np.logaddexp(0, logits).sum() - (target * logits).sum())

    slope, offset = minimize(loss, np.array([1.0, 0.0]), method="Nelder-Mead").x
    return Calibration(round(float(slope), 4), round(float(offset), 4))
