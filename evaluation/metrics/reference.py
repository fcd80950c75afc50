"""A clean image, with what every comparison against it shares: several methods, one reference.

The filters are OpenCV's in double precision, several times faster than scipy's and equal to
rounding; half of their work depends on the reference alone and is done once.
"""

from __future__ import annotations

from functools import cached_property

import cv2
import numpy as np
import numpy.typing as npt

from ...factory.dataset.describe.similarity import SsimReference

Values = npt.NDArray[np.float64]

GMSD_C = 170.0
"""Of Xue et al. 2014, for gray values 0..255."""

_STEP, _THIRD = np.array([1.0, 0.0, -1.0]), np.full(3, 1 / 3)


class Reference:
    """One clean image (H, W) float64 of the given data range, checked by the caller."""

    def __init__(self, image: Values, data_range: float) -> None:
        self.image = image
        self.data_range = data_range
        self._ssim = SsimReference(image, data_range)

    def terms(self, image: Values) -> tuple[Values, Values]:
        """(H, W) luminance and contrast-structure terms of SSIM (Wang et al. 2004)."""
        return self._ssim.terms(image)

    def ssim_map(self, image: Values) -> Values:
        """(H, W) local structural similarity."""
        return Compared(self, image).ssim_map

    def gms_map(self, image: Values, *, pooled: bool) -> Values:
        """(H, W) or (ceil(H/2), ceil(W/2)) gradient magnitude similarity (Xue et al. 2014)."""
        other = self._gradients(image, pooled)
        twice, squared = self._pooled_gradients if pooled else self._plain_gradients
        below = other * other
        below += squared
        other *= twice
        other += GMSD_C
        other /= below
        return other

    @cached_property
    def halved(self) -> Reference:
        """The next scale of MS-SSIM."""
        return Reference(halved(self.image), self.data_range)

    @cached_property
    def _pooled_gradients(self) -> tuple[Values, Values]:
        return _twice_and_squared(self._gradients(self.image, True))

    @cached_property
    def _plain_gradients(self) -> tuple[Values, Values]:
        return _twice_and_squared(self._gradients(self.image, False))

    def _gradients(self, image: Values, pooled: bool) -> Values:
        gray = image * (255.0 / self.data_range)
        return prewitt_magnitude(mean_of_blocks(gray) if pooled else gray)


class Compared:
    """An image (H, W) float64 beside its reference, and what several metrics need of the two."""

    def __init__(self, reference: Reference, image: Values) -> None:
        self.reference = reference
        self.image = image

    @cached_property
    def terms(self) -> tuple[Values, Values]:
        """`Reference.terms` of the image."""
        return self.reference.terms(self.image)

    @property
    def ssim_map(self) -> Values:
        """(H, W) local structural similarity."""
        luminance, structure = self.terms
        return np.asarray(luminance * structure)

    @property
    def halved(self) -> Compared:
        """The next scale of MS-SSIM."""
        return Compared(self.reference.halved, halved(self.image))


def halved(values: Values) -> Values:
    """Means of 2x2 blocks, an odd last row or column left out."""
    height, width = (size // 2 * 2 for size in values.shape)
    return _quarter(values[:height, :width])


def mean_of_blocks(gray: Values) -> Values:
    """Mean of 2x2 blocks; an odd size is filled up with a row or column of zeros."""
    height, width = gray.shape
    if height % 2 or width % 2:
        gray = np.pad(gray, ((0, height % 2), (0, width % 2)))
    return _quarter(gray)


def prewitt_magnitude(gray: Values) -> Values:
    """Length of the gradient by Prewitt's kernels divided by 3, zeros beyond the border."""
    parts = [
        cv2.sepFilter2D(gray, cv2.CV_64F, along, down, borderType=cv2.BORDER_CONSTANT)
        for along, down in ((_STEP, _THIRD), (_THIRD, _STEP))
    ]
    return np.asarray(cv2.magnitude(parts[0], parts[1]), dtype=np.float64)


def _twice_and_squared(gradients: Values) -> tuple[Values, Values]:
    """What GMSD takes of the reference: 2 g, and g^2 + c."""
    return 2 * gradients, gradients * gradients + GMSD_C


def _quarter(even: Values) -> Values:
    rows = even[0::2] + even[1::2]
    return np.asarray((rows[:, 0::2] + rows[:, 1::2]) * 0.25)
