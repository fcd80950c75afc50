"""Water without echoes, and with faint ones, under grain that correlates as a receiver's does.

Drawn devices have grain of single samples.  A receiver's bandwidth and its beams correlate it along
range and bearing, and where there is no echo, nothing else is there.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from ...factory.common.array_types import Float32s
from .pairs import TrainingImage

_SIGMAS_PX = (0.15, 1.4)  # of the grain's correlation, along rows and columns
_LEVELS = (0.015, 0.25)
_EMPTY_SHARE = 0.4  # of these images have no echo at all


def with_water(sample: TrainingImage, rng: np.random.Generator) -> TrainingImage:
    """The sample with its echoes faint or gone under correlated grain, whose mean the target has.

    An image of unknown geometry stays as it is.
    """
    if sample.geometry is None:
        return sample
    shape = sample.noisy.shape
    maps = sample.geometry.maps(0, 0, *shape)
    inside = maps["sector"] > 0
    echo_gain = np.float32(0 if rng.random() < _EMPTY_SHARE else rng.uniform(0.03, 0.5))
    level = np.exp(rng.uniform(*np.log(_LEVELS)))
    slope = maps["range_fraction"] ** np.float32(rng.uniform(0, 3))
    floor = np.float32(level) * (slope if rng.random() < 0.5 else np.float32(1))
    clean = np.clip(floor + echo_gain * sample.clean, 0, 1) * inside
    noisy = np.clip(clean * _grain(rng, shape), 0, 1)
    shadow = None if sample.shadow is None else np.zeros_like(sample.shadow)
    return replace(
        sample,
        noisy=noisy.astype(np.float32),
        clean=clean.astype(np.float32),
        shadow=shadow,
    )


def _grain(rng: np.random.Generator, shape: tuple[int, ...]) -> Float32s:
    """Magnitude of a correlated complex Gaussian to some power, as displays show it; mean 1."""
    low, high = np.log(_SIGMAS_PX)
    across, down = np.exp(rng.uniform(low, high, 2))
    parts = [
        cv2.GaussianBlur(rng.standard_normal(shape, np.float32), (0, 0), across, sigmaY=down)
        for _ in range(2)
    ]
    magnitude = np.hypot(*parts) ** np.float32(rng.uniform(0.3, 1.3))
    return np.asarray(magnitude / magnitude.mean(), np.float32)
