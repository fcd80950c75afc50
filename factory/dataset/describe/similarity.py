"""SSIM, the one definition for inspection, report and tests (training has it in torch).

Wang et al. 2004: Gaussian window of standard deviation 1.5 cut at 5 pixels, population covariance,
which is scikit-image's with gaussian_weights=True, sigma=1.5, use_sample_covariance=False.
"""

from __future__ import annotations

from functools import cached_property
from typing import TypeVar

import numpy as np
import numpy.typing as npt

Values = npt.NDArray[np.float64]
Scalar = TypeVar("Scalar", bound=np.generic)

SIGMA_PX = 1.5
RADIUS_PX = 5
"""Of the Gaussian window, which scikit-image cuts at 3.5 sigma."""

_K1, _K2 = 0.01, 0.03


class SsimReference:
    """One image (H, W) float64, and the half of the work that depends on it alone.

    data_range: the difference of the largest and the smallest value that there can be.
    """

    def __init__(self, image: Values, data_range: float) -> None:
        self.image = image
        self._c1, self._c2 = (_K1 * data_range) ** 2, (_K2 * data_range) ** 2

    def terms(self, image: Values) -> tuple[Values, Values]:
        """(H, W) luminance and contrast-structure terms of SSIM; borders are mirrored."""
        mean = window(image)
        variance = window(image * image)
        squared = mean * mean
        variance -= squared
        cross = window(self.image * image)
        product = self._mean * mean
        cross -= product
        luminance = (2 * product + self._c1) / (self._mean_squared + squared + self._c1)
        structure = (2 * cross + self._c2) / (self._variance + variance + self._c2)
        return luminance, structure

    @cached_property
    def _mean(self) -> Values:
        return window(self.image)

    @cached_property
    def _mean_squared(self) -> Values:
        return np.asarray(self._mean * self._mean)

    @cached_property
    def _variance(self) -> Values:
        return np.asarray(window(self.image * self.image) - self._mean_squared)


def inner(values: npt.NDArray[Scalar]) -> npt.NDArray[Scalar]:
    """(H, W) values without the border of 5 pixels that the window does not fit into."""
    return values[RADIUS_PX:-RADIUS_PX, RADIUS_PX:-RADIUS_PX]


def window(values: Values) -> Values:
    """(H, W) means under the Gaussian window, borders mirrored."""
    try:
        import cv2  # of the extra sonar
    except ImportError:
        return _plain_window(values)
    size = (2 * RADIUS_PX + 1,) * 2
    means = cv2.GaussianBlur(values, size, SIGMA_PX, borderType=cv2.BORDER_REFLECT)
    return np.asarray(means, np.float64)


def _plain_window(values: Values) -> Values:
    """The same without OpenCV, to rounding."""
    weights = np.exp(-0.5 * (np.arange(-RADIUS_PX, RADIUS_PX + 1) / SIGMA_PX) ** 2)
    wide = np.pad(values, RADIUS_PX, mode="symmetric")
    for axis in (0, 1):
        views = np.lib.stride_tricks.sliding_window_view(wide, len(weights), axis=axis)
        wide = views @ (weights / weights.sum())
    return wide
