"""Untrained networks, and what tests give `denoise` instead."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

from simnfnd.factory.common.array_types import Array, Float32s, Float64s
from simnfnd.factory.dataset.fan_geometry import FanGeometry
from simnfnd.models.denoise import options
from simnfnd.models.denoise.journal import JOURNAL_NAME
from simnfnd.models.denoise.reports import TABLE
from simnfnd.models.networks import build_network
from simnfnd.models.networks.weights import load_weights, save_weights

TINY = {"kind": "nafnet", "width": 4, "encoder": [1], "middle": 0, "decoder": [1]}


def half(grey: Float32s, geometry: object = None) -> Float32s:
    """A denoiser whose result is easy to foretell."""
    return grey / 2


def untrained_sonarnet(folder: Path) -> Path:
    """Weights of a network that can be told what to remove."""
    config = {
        **{"kind": "sonarnet", "widths": [4, 4], "blocks": [0, 0], "polar": False},
        **{"lines": True, "mask": True, "forget": 0.0},
    }
    torch.manual_seed(0)
    path = folder / "weights.safetensors"
    save_weights(path, build_network(config), config, {})
    return path


def through_network(weights: Path, image: Array) -> Float64s:
    network = load_weights(weights).network
    with torch.inference_mode():
        result = network(torch.from_numpy(image.astype(np.float32))[None, None])
    return np.asarray(np.clip(result[0, 0].numpy(), 0, 1), dtype=np.float64)


def main(words: Sequence[str]) -> int:
    """`simnfnd denoise`, each frame alone, so that its result is easy to predict."""
    return options.main([*words, "--frames", "1"])


def results_in(out: Path) -> list[str]:
    """Names in an output folder, but for what a run notes about them."""
    names = sorted(path.name for path in out.iterdir())
    return [name for name in names if name not in (JOURNAL_NAME, TABLE)]


class Halving:
    """A denoiser whose result is easy to foretell, and which keeps what it was told."""

    name = "halving"
    digest = "0"

    def __init__(self) -> None:
        self.geometries: list[FanGeometry | None] = []

    def __call__(self, grey: Float32s, geometry: FanGeometry | None = None) -> Float32s:
        assert grey.ndim == 2
        self.geometries.append(geometry)
        return grey / 2
