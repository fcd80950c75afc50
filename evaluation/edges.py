"""Are the edges still there?"""

from __future__ import annotations

import math

import cv2
import numpy as np
import numpy.typing as npt

from evaluation.checks import Image, Mask, checked_mask, checked_pair


def edge_preservation(
    reference: Image, image: Image, *, data_range: float, mask: Mask | None = None
) -> float:
    """Edge preservation index beta in -1..1, 1 = the edges of the clean image.

    The correlation of both images' high-pass parts, by the 3x3 Laplacian of four neighbours, the
    border of one pixel left out (Sattar et al. 1997).  It ignores gain and offset, so it sees edges
    and not brightness.  NaN when either image has no edge at all.
    """
    a, b = checked_pair(reference, image, data_range, smallest=3)
    inner = np.zeros(a.shape, dtype=bool)
    inner[1:-1, 1:-1] = True
    if mask is not None:
        inner = checked_mask(checked_mask(mask, a) & inner, a)
    high_a, high_b = (_centred(cv2.Laplacian(gray, cv2.CV_64F)[inner]) for gray in (a, b))
    norm = math.sqrt(float(high_a @ high_a) * float(high_b @ high_b))
    # A flat picture leaves rounding errors of the Laplacian, which are no edges.
    if norm < 1e-16 * data_range**2 * high_a.size:
        return math.nan
    return float(high_a @ high_b) / norm


def _centred(values: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    return np.asarray(values - values.mean())
