"""What a network left of a single image's detail, and what follows from it.

The network has learned how fine the ground of simulated scenes is.  Two remedies follow the ratio
of the detail that it left to the noise that it removed (docs/research/real-sonar.md, fine detail):

- Where there is as little as noise alone leaves, as in open water, it is residue: a slight total
  variation removes it.
- Where there is much, the ground is finer than any that the network knows, as in an image shown at
  a smaller size, and the network removes part of it.  A weak total variation of the noisy image
  keeps it, and errs elsewhere, so a weighted mean of both is better than either.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from ...factory.common.array_types import Float32s
from .total_variation import less_total_variation

_DETAIL_SIGMA_PX = 2.0  # detail is what a Gaussian of this width removes
_WINDOW_SIGMA_PX = 14.0  # of the window in which detail and noise are measured
_CELL_PX = 4  # they are measured at this fraction of the resolution
_LEAST_NOISE = 1e-4
_STEPS = 8

_RESIDUE_RATIO = 0.25
_GROUND_RATIO = 0.4
_FINE_RATIO = 1.0
"""Ratios of detail to noise: up to the first, detail is residue of the noise; at the second it is
the ground as the network knows it; from the third on the ground is fine."""
_SLIGHT = 0.12  # weight of the total variation where detail is residue, in standard deviations

_MOST_SHARE = 0.6  # of total variation where the ground is fine
_STRONG = 1.0
_WEAK = 0.6
"""Its weight in standard deviations of the noise, at ground as usual and at fine ground."""


class _Left(NamedTuple):
    """Detail that a network left and noise that it removed, for cells of `_CELL_PX` pixels.

    noise_sigma: grey values.  ratio: of the standard deviations of detail and noise.
    """

    noise_sigma: Float32s
    ratio: Float32s


def corrected_by_detail(grey: Float32s, denoised: Float32s) -> Float32s:
    """The denoised image, smoothed where residue is left, in part replaced where ground is fine.

    grey, denoised: (H, W) in 0..1, before the network and after it.
    """
    left = _measured(grey, denoised)
    smooth = _without_residue(denoised, left)
    return _with_fine_ground(grey, smooth, left)


def _measured(grey: Float32s, denoised: Float32s) -> _Left:
    detail = denoised - cv2.GaussianBlur(denoised, (0, 0), _DETAIL_SIGMA_PX)
    noise_sigma = np.maximum(_local_sigma(grey - denoised), _LEAST_NOISE)
    return _Left(noise_sigma, _local_sigma(detail) / noise_sigma)


def _without_residue(denoised: Float32s, left: _Left) -> Float32s:
    """Less total variation where the detail is no more than noise leaves."""
    emptiness = _ramp(left.ratio, _GROUND_RATIO, _RESIDUE_RATIO)
    emptiness[left.noise_sigma <= _LEAST_NOISE] = 0
    if not emptiness.any():
        return denoised
    weight = np.float32(_SLIGHT) * left.noise_sigma * emptiness
    return less_total_variation(denoised, _enlarged(weight, *denoised.shape), _STEPS)


def _with_fine_ground(grey: Float32s, denoised: Float32s, left: _Left) -> Float32s:
    """In part the noisy image with less total variation, where the ground is fine."""
    fineness = _ramp(left.ratio, _GROUND_RATIO, _FINE_RATIO)
    if not fineness.any():
        return denoised
    weight = left.noise_sigma * (_STRONG + np.float32(_WEAK - _STRONG) * fineness)
    smooth = less_total_variation(grey, _enlarged(weight, *grey.shape), _STEPS)
    share = _enlarged(np.float32(_MOST_SHARE) * fineness, *grey.shape)
    return np.asarray(denoised + share * (smooth - denoised), np.float32)


def _ramp(ratio: Float32s, nothing: float, whole: float) -> Float32s:
    """0 at the ratio `nothing` and before, 1 at `whole` and beyond."""
    return np.asarray(np.clip((ratio - nothing) / (whole - nothing), 0, 1), np.float32)


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
