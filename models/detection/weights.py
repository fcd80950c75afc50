"""Detectors on disk: safetensors with a description in the header; nothing in it is executed."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from safetensors import SafetensorError, safe_open

from ...factory.common.errors import FactoryError
from ...factory.common.files import write_atomically

if TYPE_CHECKING:
    from .network import DetectorNetwork

FORMAT = "simnfnd-detector/1"
_KEY = "simnfnd"


@dataclass(frozen=True, eq=False)
class TrainedDetector:
    """A network in evaluation mode, the names of its classes, and the facts of its training."""

    network: DetectorNetwork
    classes: tuple[str, ...]
    training: Mapping[str, Any]

    @property
    def margin(self) -> float:
        """How far boxes grow on every side, as a share of the longer side of the image.

        Negative where the detector learned wider boxes than people draw.
        """
        return float(self.training.get("margin", 0.0))


def save_detector(path: Path, detector: TrainedDetector) -> None:
    """Write a detector in 16 bits, whole or not at all; same weights, same bytes."""
    from safetensors.torch import save

    tensors = {
        name: (tensor.half() if tensor.is_floating_point() else tensor).detach().contiguous()
        for name, tensor in sorted(detector.network.state_dict().items())
    }
    header = {
        "format": FORMAT,
        "classes": list(detector.classes),
        "training": dict(detector.training),
    }
    write_atomically(path, save(tensors, {_KEY: json.dumps(header, sort_keys=True)}), key="out")


def load_detector(path: Path) -> TrainedDetector:
    """Read a detector on the CPU, in 32 bits.  Raises FactoryError for any other file."""
    import torch

    from .network import DetectorNetwork

    problem = f"detector={path}: no detector of this program, or a damaged one"
    try:
        header = read_header(path)
        network = DetectorNetwork(len(header["classes"]))
        with safe_open(path, framework="pt") as file:
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        network.load_state_dict(
            {name: tensor.float() if tensor.is_floating_point() else tensor
             for name, tensor in tensors.items()}
        )  # fmt: skip
        finite = all(torch.isfinite(tensor).all() for tensor in network.state_dict().values())
    except (SafetensorError, OSError, RuntimeError, KeyError, TypeError, AttributeError) as error:
        raise FactoryError(f"{problem}; give one that `evaluate transfer` wrote") from error
    if not finite:
        raise FactoryError(f"{problem}: it holds NaN or infinity; train again")
    network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    return TrainedDetector(network.eval(), tuple(header["classes"]), header["training"])


def read_header(path: Path) -> dict[str, Any]:
    """`classes` and `training` of a detector.  Raises FactoryError for any other file."""
    try:
        with safe_open(path, framework="np") as file:
            header = json.loads((file.metadata() or {}).get(_KEY, "{}"))
    except (SafetensorError, OSError, ValueError, RecursionError) as error:
        raise FactoryError(f"detector={path}: not a safetensors file, or a damaged one") from error
    classes = header.get("classes") if isinstance(header, dict) else None
    is_ours = isinstance(classes, list) and all(isinstance(name, str) for name in classes)
    if not is_ours or header.get("format") != FORMAT or not classes:
        raise FactoryError(f"detector={path}: not a detector ({FORMAT}) of this program")
    training = header.setdefault("training", {})
    margin = training.get("margin", 0.0) if isinstance(training, dict) else None
    if not isinstance(margin, int | float) or not -0.2 <= margin <= 0.2:
        raise FactoryError(f"detector={path}: `training` in the header is damaged")
    return dict(header)
