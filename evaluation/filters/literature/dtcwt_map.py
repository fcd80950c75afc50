"""Bayesian shrinkage of complex wavelets in the logarithm: Isar, Moga and Isar (2009).

EURASIP Journal on Image and Video Processing, "A New Denoising System for SONAR Images": logarithm,
complex wavelets, a maximum a posteriori filter, exponential, correction of the mean.  The filter is
the bivariate one of Sendur and Selesnick (IEEE SPL 9(12), 2002), in which a coefficient is kept
when its parent is large, too.
"""

from __future__ import annotations

from functools import partial

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from ..base import Gray
from .dual_tree import Coefficients, Complex, forward, inverse
from .logarithm import in_logarithm

Floats = npt.NDArray[np.float32]

_MARGIN = 8
_WINDOW = 7  # for the local power, as in the paper on the bivariate filter
_RAYLEIGH_MEDIAN = float(np.sqrt(np.log(4)))
"""Median of the magnitude of complex noise over the standard deviation of one of its parts."""


def dtcwt_map(image: Gray, strength: float, levels: int) -> Gray:
    """(H, W) in 0..1 denoised.  strength: multiple of the estimated noise's standard deviation."""
    return in_logarithm(image, partial(_shrunk, strength=strength, levels=levels))


def _shrunk(values: Floats, strength: float, levels: int) -> Floats:
    """The picture with its details shrunk, by the noise that its finest level shows."""
    height, width = values.shape
    whole = 2 ** (levels + 1)
    after = [-(size + 2 * _MARGIN) % whole + _MARGIN for size in values.shape]
    padded = np.pad(values, [(_MARGIN, extra) for extra in after], mode="symmetric")
    # One level more than is shrunk: the parents of the coarsest.
    found = forward(padded, levels + 1)
    noise = strength * _noise(found.bands[0])
    bands = [
        _map(band, parent, noise)
        for band, parent in zip(found.bands[:-1], found.bands[1:], strict=True)
    ]
    result = inverse(Coefficients([*bands, found.bands[-1]], found.lows))
    return result[_MARGIN : _MARGIN + height, _MARGIN : _MARGIN + width]


def _noise(finest: Complex) -> float:
    """Robust standard deviation of a part (real or imaginary) of the finest coefficients.

    Of what is not exactly 0: outside of the fan there is no noise.
    """
    magnitude = np.abs(finest)
    some = magnitude[magnitude > 1e-5]
    return float(np.median(some)) / _RAYLEIGH_MEDIAN if some.size else 0.0


def _map(band: Complex, parent: Complex, noise: float) -> Complex:
    """Bivariate MAP: y max(R - sqrt(3) noise^2 / sigma, 0) / R, R the length of child and parent.

    noise, sigma: standard deviations of a real part; sigma, the signal's, is taken from the power
    around a coefficient.
    """
    magnitude = np.abs(band)
    above = np.abs(parent).repeat(2, axis=1).repeat(2, axis=2)
    length = np.hypot(magnitude, above)
    power = ndimage.uniform_filter(magnitude**2 / 2, (1, _WINDOW, _WINDOW), mode="wrap")
    sigma = np.sqrt(np.maximum(power - noise**2, 1e-12))
    part = np.maximum(length - np.sqrt(3) * noise**2 / sigma, 0) / np.maximum(length, 1e-12)
    return np.asarray(band * part, dtype=np.complex64)
