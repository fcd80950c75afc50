"""Where a single image shows finer detail than the network knows, part of it is smoothed instead.

The network has learned how fine the ground of simulated scenes is.  The ground of a real scene that
is shown at a smaller size is finer, and the network removes part of it.  A weak total variation
keeps it, and errs elsewhere, so a weighted mean of both is better than either.  The weight follows
the detail that the network left, compared with the noise that it removed: where noise dominates,
the result is the network's alone (docs/research/real-sonar.md, fine detail).
"""

from __future__ import annotations

import cv2
import numpy as np

from ...factory.common.array_types import Float32s
from .total_variation import less_total_variation

_DETAIL_SIGMA_PX = 2.0  # detail is what a Gaussian of this width removes
_WINDOW_SIGMA_PX = 14.0  # of the window in which detail and noise are measured
_CELL_PX = 4  # they are measured at this fraction of the resolution
_LEAST_NOISE = 1e-4
_LEAST_RATIO = 0.4
_HIGHEST_RATIO = 1.0
"""Ratio of detail to noise from which on total variation counts, and that where it counts most."""
_MOST_SHARE = 0.6
_STRONG = 1.0
_WEAK = 0.6
"""Weight of the total variation in standard deviations of the noise, at both ratios."""
_STEPS = 8


def with_fine_detail(grey: Float32s, denoised: Float32s) -> Float32s:
    """The denoised image, in part replaced by total variation where its detail is fine.

    grey, denoised: (H, W) in 0..1, before the network and after it.
    """
    detail = denoised - cv2.GaussianBlur(denoised, (0, 0), _DETAIL_SIGMA_PX)
    detail_sigma = _local_sigma(detail)
    noise_sigma = np.maximum(_local_sigma(grey - denoised), _LEAST_NOISE)
    ratio = detail_sigma / noise_sigma
    fineness = np.asarray(
        np.clip((ratio - _LEAST_RATIO) / (_HIGHEST_RATIO - _LEAST_RATIO), 0, 1), np.float32
    )
    if not fineness.any():
        return denoised
    weight = noise_sigma * (_STRONG + np.float32(_WEAK - _STRONG) * fineness)
    height, width = grey.shape
    smooth = less_total_variation(grey, _enlarged(weight, height, width), _STEPS)
    share = _enlarged(np.float32(_MOST_SHARE) * fineness, height, width)
    return np.asarray(denoised + share * (smooth - denoised), np.float32)


def _local_sigma(plane: Float32s) -> Float32s:
    """Root of the local mean square of a plane (H, W), for cells of `_CELL_PX` pixels."""
    height, width = plane.shape
    cells = max(1, width // _CELL_PX), max(1, height // _CELL_PX)
    mean_square = cv2.resize(plane * plane, cells, interpolation=cv2.INTER_AREA)
    windowed = cv2.GaussianBlur(mean_square, (0, 0), _WINDOW_SIGMA_PX / _CELL_PX)
    return np.asarray(np.sqrt(windowed), np.float32)


def _enlarged(cells: Float32s, height: int, width: int) -> Float32s:
    """Values of cells at the pixels of an image of height x width."""
    size = width, height
    return np.asarray(cv2.resize(cells, size, interpolation=cv2.INTER_LINEAR), np.float32)
