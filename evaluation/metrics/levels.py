"""One global gain and offset: the part of a method's gain that is brightness alone."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Gray = npt.NDArray[np.float32]
Floats = npt.NDArray[np.floating]


@dataclass(frozen=True)
class Levels:
    """out = gain * image + offset, clipped to 0..1."""

    gain: float
    offset: float

    def __call__(self, image: Floats) -> Gray:
        """The corrected picture, same shape, float32 in 0..1."""
        return np.clip(self.gain * image + self.offset, 0, 1).astype(np.float32)


def fit_levels(pairs: Iterable[tuple[Floats, Floats]]) -> Levels:
    """The least-squares gain and offset from (image, clean) pairs, over all pixels of all pairs.

    A constant image leaves only the offset, the mean of the clean ones.
    """
    sums = np.zeros(5)
    for image, clean in pairs:
        x, y = image.astype(np.float64).ravel(), clean.astype(np.float64).ravel()
        sums += _moments(x, y)
    count, sum_x, sum_y, sum_xx, sum_xy = sums
    if count == 0:
        raise ValueError("no pairs to fit the levels on")
    mean_x, mean_y = sum_x / count, sum_y / count
    variance = sum_xx / count - mean_x**2
    if variance < 1e-12:
        return Levels(0.0, float(mean_y))
    gain = (sum_xy / count - mean_x * mean_y) / variance
    return Levels(float(gain), float(mean_y - gain * mean_x))


def _moments(x: npt.NDArray[np.float64], y: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    return np.array([x.size, x.sum(), y.sum(), x @ x, x @ y])
