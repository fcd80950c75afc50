"""What a network left of a single image's detail, and what follows from it.

The network has learned what the ground of simulated scenes looks like.  Two remedies follow the
ratio of the detail that it left to the noise that it removed (docs/research/real-sonar.md, fine
detail):

- Where there is as little as noise alone leaves, as in open water, it is residue: a slight total
  variation removes it.
- Where there is ground, part of its detail is grain that the network took for ground, and part of
  the ground is lost.  A total variation of the noisy image errs elsewhere, so the mean of both is
  better than either.  How strong it is follows the grain.  Where neighbouring pixels of the removed
  noise correlate, pixels are finer than what the sonar resolves, so the finest detail is grain.
  Where they do not, as in an image shown at a smaller size, it is ground.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from ...factory.common.array_types import Float32s
from .grain_width import neighbour_covariance
from .total_variation import less_total_variation

_DETAIL_SIGMA_PX = 2.0  # detail is what a Gaussian of this width removes
_WINDOW_SIGMA_PX = 14.0  # of the window in which detail and noise are measured
_CELL_PX = 4  # they are measured at this fraction of the resolution
_LEAST_NOISE = 1e-4  # standard deviation in grey values, below which there is none
_COUNTED_NOISE = 0.01  # from which on the correlation of the noise is measured
_STEPS = 8

_RESIDUE_RATIO = 0.25
_KNOWN_RATIO = 0.4
"""Ratios of detail to noise: up to the first, detail is residue; from the second on, none is."""
_SLIGHT = 0.12  # weight of the total variation where detail is residue, in standard deviations

_LITTLE_GROUND = 0.3
_MUCH_GROUND = 0.9
_MOST_SHARE = 0.55
"""Ratios of detail to noise between which the share of the total variation rises from 0 to this."""
_SEPARATE_GRAIN = 0.2
_WIDE_GRAIN = 0.25
_WEAK = 0.6
_STRONG = 1.3
"""Correlations of neighbouring pixels of the noise up to which, and from which on, the weight of
the total variation is weak and strong, in standard deviations of the noise."""

_WHITE = 0.97  # grey value from which on a pixel is saturated
_FEW_WHITE = 0.01
_MANY_WHITE = 0.1
_BESIDE_WHITE = 2.5
"""Shares of saturated pixels between which the weight rises to this: they have lost their noise, so
it is measured too small there, and the dark rest of it looks like detail."""


class _Left(NamedTuple):
    """Detail that a network left and noise that it removed, for cells of `_CELL_PX` pixels.

    noise_sigma: grey values.  ratio: of the standard deviations of detail and noise.
    white_share: of saturated pixels.  noise_correlation: of neighbouring pixels of the noise, the
    lesser of rows and columns, median of the cells with noise.
    """

    noise_sigma: Float32s
    ratio: Float32s
    white_share: Float32s
    noise_correlation: float


def corrected_by_detail(grey: Float32s, denoised: Float32s) -> Float32s:
    """The denoised image, smoothed where residue is left, in part replaced where ground is.

    grey, denoised: (H, W) in 0..1, before the network and after it.
    """
    left = _measured(grey, denoised)
    smooth = _without_residue(denoised, left)
    return _with_ground(grey, smooth, left)


def _measured(grey: Float32s, denoised: Float32s) -> _Left:
    detail = denoised - cv2.GaussianBlur(denoised, (0, 0), _DETAIL_SIGMA_PX)
    noise = grey - denoised
    noise_sigma = np.maximum(_local_sigma(noise), _LEAST_NOISE)
    ratio = _local_sigma(detail) / noise_sigma
    white_share = _local_mean((grey > _WHITE).astype(np.float32))
    return _Left(noise_sigma, ratio, white_share, _noise_correlation(noise, noise_sigma))


def _noise_correlation(noise: Float32s, noise_sigma: Float32s) -> float:
    """See `_Left`; 0 where there is no noise."""
    is_noisy = noise_sigma > _COUNTED_NOISE
    if not is_noisy.any():
        return 0.0
    covariance = neighbour_covariance(noise, _local_mean)
    return float(np.median(covariance[is_noisy] / np.square(noise_sigma[is_noisy])))


def _without_residue(denoised: Float32s, left: _Left) -> Float32s:
    """Less total variation where the detail is no more than noise leaves."""
    emptiness = _ramp(left.ratio, _KNOWN_RATIO, _RESIDUE_RATIO)
    emptiness[left.noise_sigma <= _LEAST_NOISE] = 0
    if not emptiness.any():
        return denoised
    weight = np.float32(_SLIGHT) * left.noise_sigma * emptiness
    return less_total_variation(denoised, _enlarged(weight, *denoised.shape), _STEPS)


def _with_ground(grey: Float32s, denoised: Float32s, left: _Left) -> Float32s:
    """In part the noisy image with less total variation, where there is ground."""
    whiteness = _ramp(left.white_share, _FEW_WHITE, _MANY_WHITE)
    ground = np.maximum(_ramp(left.ratio, _LITTLE_GROUND, _MUCH_GROUND), whiteness)
    if not ground.any():
        return denoised
    correlations = (_SEPARATE_GRAIN, _WIDE_GRAIN)
    strength = np.float32(np.interp(left.noise_correlation, correlations, (_WEAK, _STRONG)))
    weight = left.noise_sigma * (strength + whiteness * (_BESIDE_WHITE - strength))
    smooth = less_total_variation(grey, _enlarged(weight, *grey.shape), _STEPS)
    share = _enlarged(np.float32(_MOST_SHARE) * ground, *grey.shape)
    return np.asarray(denoised + share * (smooth - denoised), np.float32)


def _ramp(values: Float32s, nothing: float, whole: float) -> Float32s:
    """0 at the value `nothing` and before, 1 at `whole` and beyond."""
    return np.asarray(np.clip((values - nothing) / (whole - nothing), 0, 1), np.float32)


def _local_sigma(plane: Float32s) -> Float32s:
    """Root of the local mean square of a plane (H, W), for cells of `_CELL_PX` pixels."""
    return np.sqrt(_local_mean(plane * plane))


def _local_mean(plane: Float32s) -> Float32s:
    """Mean of a plane (H, W) in a Gaussian window, for cells of `_CELL_PX` pixels."""
    height, width = plane.shape
    cells = max(1, width // _CELL_PX), max(1, height // _CELL_PX)
    means = cv2.resize(plane, cells, interpolation=cv2.INTER_AREA)
    windowed = cv2.GaussianBlur(means, (0, 0), _WINDOW_SIGMA_PX / _CELL_PX)
    return np.asarray(windowed, np.float32)


def _enlarged(cells: Float32s, height: int, width: int) -> Float32s:
    """Values of cells at the pixels of an image of height x width."""
    size = width, height
    return np.asarray(cv2.resize(cells, size, interpolation=cv2.INTER_LINEAR), np.float32)
