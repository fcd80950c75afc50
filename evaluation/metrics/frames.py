"""The noise of frames of one scene, by what differs between frames that follow each other.

A difference of two frames has the noise of both and nothing of a scene that stands still.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import ndimage

Floats = npt.NDArray[np.float64]

# Levels that are compared are so wide, and count where so many samples have them.
LEVEL_WIDTH, _FEWEST = 20, 2000
_LAGS = 12
# Structure larger than this is the scene's, and not grain: ranges, beams.
_SCENE = (15, 5)


@dataclass(frozen=True, eq=False)
class FrameNoise:
    """What frames of one scene say about their noise; grey values are those of the samples.

    std: temporal standard deviation.  std_of_level: of the samples of each level, {lowest: std}.
    range_half_width, beam_half_width: lag at which the noise's correlation is a half, samples and
        beams (straight between lags).
    range_correlation, beam_correlation: at lags 1, 2, ... .
    skewness, kurtosis: of the noise in single frames; 0 for a Gaussian.
    static_share: correlation of the grain of neighbouring frames: what of it does not change.
    """

    std: float
    std_of_level: dict[int, float]
    range_half_width: float
    beam_half_width: float
    range_correlation: tuple[float, ...]
    beam_correlation: tuple[float, ...]
    skewness: float
    kurtosis: float
    static_share: float

    @property
    def constancy(self) -> float:
        """Largest difference of a level's deviation from the whole, as a part of it."""
        return max(abs(std / self.std - 1) for std in self.std_of_level.values())


def frame_noise(frames: npt.NDArray[np.generic]) -> FrameNoise:
    """frames: (N, ranges, beams) grey values of one scene, N at least 3."""
    grey = np.asarray(frames, np.float64)
    change = np.diff(grey, axis=0) / np.sqrt(2)
    std = float(np.sqrt((change**2).mean()))
    level = np.floor_divide(grey.mean(axis=0), LEVEL_WIDTH).astype(int) * LEVEL_WIDTH
    of_level = {
        int(low): float(np.sqrt((change[:, level == low] ** 2).mean()))
        for low in np.unique(level)
        if (level == low).sum() >= _FEWEST
    }
    along, across = correlation(change, 1), correlation(change, 2)
    # One frame against the mean of the others: its own noise, and little of theirs.
    rest = (grey.sum(axis=0) - grey) / (len(grey) - 1)
    own = (grey - rest).ravel()
    own -= own.mean()
    square = (own**2).mean()
    # Of N values the mean of the rest adds (N - 1)^-2 of the third moment, with the other sign.
    others = len(grey) - 1
    skewness = (own**3).mean() / square**1.5 * (1 + 1 / others) ** 1.5 / (1 - others**-2)
    excess = (own**4).mean() / square**2 - 3
    kurtosis = excess * (1 + 1 / others) ** 2 / (1 + others**-3)
    return FrameNoise(
        std,
        of_level,
        half_width(along),
        half_width(across),
        tuple(along[1:6].tolist()),
        tuple(across[1:6].tolist()),
        float(skewness),
        float(kurtosis),
        grain_correlation(grey, 1),
    )


def grain_correlation(frames: npt.NDArray[np.generic], lag: int) -> float:
    """Correlation of the grain of frames `lag` apart, (N, ranges, beams); 1 where none changes.

    Grain is what is finer than 15 ranges and 5 beams, a scene's own fine structure included.
    """
    grey = np.asarray(frames, np.float64)
    grain = grey - ndimage.uniform_filter(grey, (0, *_SCENE))
    return float((grain[lag:] * grain[:-lag]).mean() / (grain**2).mean())


def correlation(noise: Floats, axis: int) -> Floats:
    """Correlation at lags 0 to 12 (or one less than there are samples) along an axis."""
    moved = np.moveaxis(noise, axis, -1)
    lags = range(min(_LAGS + 1, moved.shape[-1]))
    square = (moved**2).mean()
    size = moved.shape[-1]
    return np.array([(moved[..., lag:] * moved[..., : size - lag]).mean() / square for lag in lags])


def half_width(alike: Floats) -> float:
    """Lag at which a correlation that begins at 1 is a half; straight between lags."""
    below = int(np.argmax(alike < 0.5))
    if alike[below] >= 0.5:
        return float(len(alike) - 1)
    high, low = alike[below - 1 : below + 1]
    return float(below - 1 + (high - 0.5) / (high - low))


def ks_distance(one: npt.NDArray[np.generic], other: npt.NDArray[np.generic]) -> float:
    """Kolmogorov-Smirnov distance of the grey values (uint8) of two sets of pictures."""
    shares = [np.bincount(np.ravel(x), minlength=256).cumsum() / x.size for x in (one, other)]
    return float(np.abs(shares[0] - shares[1]).max())
