"""Shrinkage of Haar wavelet coefficients, averaged over all shifts of the picture."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from .base import Gray

Floats = npt.NDArray[np.float32]


def wavelet(image: Gray, strength: float, levels: int) -> Gray:
    """Translation-invariant soft thresholding (Coifman and Donoho 1995) with the Haar wavelet.

    strength: the threshold as a grey value of the picture.  A detail of level j averages 4^j
    pixels, where white noise is 2^j times weaker, and so is the threshold.
    """
    height, width = image.shape
    margin = 2**levels
    rest = _details(np.pad(image, margin, mode="symmetric"), strength, 0, levels)
    return rest[margin : margin + height, margin : margin + width]


def _details(smooth: Floats, strength: float, level: int, levels: int) -> Floats:
    """Split off one level, shrink its details, go on with the rest and put both together."""
    if level == levels:
        return smooth
    step, threshold = 2**level, np.float32(strength / 2 ** (level + 1))
    low, high = _split(smooth, step, 0)
    bands = [*_split(low, step, 1), *_split(high, step, 1)]
    rest = _details(bands[0], strength, level + 1, levels)
    low_high, high_low, high_high = (
        np.sign(band) * np.maximum(np.abs(band) - threshold, 0) for band in bands[1:]
    )
    return _joined(_joined(rest, low_high, step, 1), _joined(high_low, high_high, step, 1), step, 0)


def _split(values: Floats, step: int, axis: int) -> tuple[Floats, Floats]:
    """Half sum and half difference of each pixel and the one `step` before it, all round."""
    before = np.roll(values, step, axis)
    return (values + before) / 2, (values - before) / 2


def _joined(low: Floats, high: Floats, step: int, axis: int) -> Floats:
    """The mean of the two ways back: each pixel is in a pair as the later and as the earlier."""
    return ((low + high) + np.roll(low - high, -step, axis)) / 2
