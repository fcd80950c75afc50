"""Are the edges still there?"""

from __future__ import annotations

import math

import cv2
import numpy as np
import numpy.typing as npt

from .checks import Image, Mask, checked_mask, checked_pair

Values = npt.NDArray[np.float64]


def edge_preservation(
    reference: Image, image: Image, *, data_range: float, mask: Mask | None = None
) -> float:
    """Edge preservation index beta in -1..1, 1 = the edges of the clean image.

    The correlation of both images' high-pass parts, by the 3x3 Laplacian of four neighbours, the
    border of one pixel left out (Sattar et al. 1997).  It ignores gain and offset, so it sees edges
    and not brightness.  NaN when either image has no edge at all.
    """
    a, b = checked_pair(reference, image, data_range, smallest=3)
    return Edges(a, data_range, mask).kept(b)


class Edges:
    """The edges of a reference (H, W) float64 inside a mask, for several images beside it."""

    def __init__(self, reference: Values, data_range: float, mask: Mask | None = None) -> None:
        inner = np.zeros(reference.shape, dtype=bool)
        inner[1:-1, 1:-1] = True
        if mask is not None:
            inner = checked_mask(checked_mask(mask, reference) & inner, reference)
        self._inner = np.flatnonzero(inner)
        self._own = self._high_pass(reference)
        # A flat picture leaves rounding errors of the Laplacian, which are no edges.
        self._least = 1e-16 * data_range**2 * self._inner.size

    def kept(self, image: Values) -> float:
        """`edge_preservation` of an image that was checked already."""
        other = self._high_pass(image)
        norm = math.sqrt(float(self._own @ self._own) * float(other @ other))
        return math.nan if norm < self._least else float(self._own @ other) / norm

    def _high_pass(self, image: Values) -> Values:
        values = cv2.Laplacian(image, cv2.CV_64F).ravel()[self._inner]
        return np.asarray(values - values.mean())
