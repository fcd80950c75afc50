"""The speckle filters of radar: local statistics decide how much is smoothed.

All assume multiplicative noise of a known coefficient of variation (std / mean), `noise_cv`; where
the picture varies no more than that it is smoothed, where it varies more it is left.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from .base import Gray

Floats = npt.NDArray[np.float64]

_TINY = 1e-6  # of full scale: keeps black regions from dividing by zero


def lee(image: Gray, size: int, noise_cv: float) -> Gray:
    """Lee (1980): mean + w (pixel - mean) with w = 1 - Cu^2 / Ci^2, at least 0."""
    mean, squared_cv = _statistics(image, size)
    weight = 1 - _divided(np.full_like(mean, noise_cv**2), squared_cv)
    return _between(image, mean, weight)


def kuan(image: Gray, size: int, noise_cv: float) -> Gray:
    """Kuan et al. (1985): Lee's with w divided by 1 + Cu^2, the exact linear MMSE estimate."""
    mean, squared_cv = _statistics(image, size)
    weight = (1 - _divided(np.full_like(mean, noise_cv**2), squared_cv)) / (1 + noise_cv**2)
    return _between(image, mean, weight)


def frost(image: Gray, size: int, damping: float) -> Gray:
    """Frost et al. (1982): mean of the window weighted by exp(-damping Ci^2 distance)."""
    _, squared_cv = _statistics(image, size)
    radius = size // 2
    height, width = image.shape
    around = np.pad(image.astype(np.float64), radius, mode="edge")
    total, weights = np.zeros((height, width)), np.zeros((height, width))
    for row in range(size):
        for column in range(size):
            distance = np.hypot(row - radius, column - radius)
            weight = np.exp(-damping * distance * squared_cv)
            total += weight * around[row : row + height, column : column + width]
            weights += weight
    return np.asarray(total / weights, dtype=np.float32)


def srad(image: Gray, iterations: int, initial_cv: float, step: float, decay: float) -> Gray:
    """Speckle-reducing anisotropic diffusion (Yu and Acton 2002).

    initial_cv: q0, the speckle's coefficient of variation at the start; it falls as
    exp(-decay t).  step: of time, stable up to 0.25.  `iterations` steps are made; no flux crosses
    the border.
    """
    values = np.maximum(image.astype(np.float64), 1e-3)
    for number in range(iterations):
        north, south, west, east = _differences(values)
        gradient = (north**2 + south**2 + west**2 + east**2) / values**2
        laplace = (north + south + west + east) / values
        squared_q = np.maximum(0.5 * gradient - laplace**2 / 16, 0) / (1 + laplace / 4) ** 2
        squared_q0 = (initial_cv * np.exp(-decay * number * step)) ** 2
        spread = (squared_q - squared_q0) / (squared_q0 * (1 + squared_q0))
        # Below q0 the coefficient passes 1 (and its pole): there is speckle alone, so all diffuses.
        conduct = np.where(spread <= 0, 1.0, 1 / (1 + np.maximum(spread, 0)))
        below = np.concatenate([conduct[1:], conduct[-1:]])
        right = np.concatenate([conduct[:, 1:], conduct[:, -1:]], axis=1)
        flow = below * south + conduct * north + right * east + conduct * west
        values = np.maximum(values + step / 4 * flow, 1e-3)
    # The floor that kept the divisions possible is no echo.
    return np.asarray(np.where(values <= 1e-3, 0, values), dtype=np.float32)


def _statistics(image: Gray, size: int) -> tuple[Floats, Floats]:
    """Local mean and squared coefficient of variation."""
    values = image.astype(np.float64)
    mean = ndimage.uniform_filter(values, size, mode="nearest")
    variance = np.maximum(ndimage.uniform_filter(values**2, size, mode="nearest") - mean**2, 0)
    return mean, variance / np.maximum(mean, _TINY) ** 2


def _divided(numerator: Floats, denominator: Floats) -> Floats:
    """Their quotient, and 1 (all is noise) where the denominator is nothing."""
    some = denominator > 1e-12
    return np.where(some, numerator / np.where(some, denominator, 1), 1.0)


def _between(image: Gray, mean: Floats, weight: Floats) -> Gray:
    mixed = mean + np.clip(weight, 0, 1) * (image - mean)
    return np.asarray(mixed, dtype=np.float32)


def _differences(values: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Neighbour minus pixel to the north, south, west and east, 0 across the border."""
    around = np.pad(values, 1, mode="edge")
    return (
        around[:-2, 1:-1] - values,
        around[2:, 1:-1] - values,
        around[1:-1, :-2] - values,
        around[1:-1, 2:] - values,
    )
