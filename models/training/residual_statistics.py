"""A loss on what a network takes away: it is to have the statistics of speckle.

Pillai, Savner, Sahoo: Physics-Guided Self-Supervised Statistical Residual Learning for Sonar
Despeckling with Improved Generalization, arXiv 2605.24716, 2026.  The logarithm of noisy / denoised
is to have mean 0 and the variance of the speckle's logarithm in each picture, and to be smooth
where the denoised picture is; the denoised picture is drawn to the median of 5x5 pixels, more and
more over three fifths of the training.  Weights and bounds are the published ones.  Ours: black
pixels count for nothing, for there is no speckle outside of a fan, and any network can be taught.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn import functional

_FLOOR = 1 / 255
"""One grey level: what is below it is black."""
_LARGEST = math.log(4.0)
"""Bound of the logarithm of noisy / denoised."""
_EDGE = 0.01
"""Step of grey values at which the smoothness counts for 1 / e."""
_MEDIAN, _STATISTICS, _SMOOTHNESS = 0.3, 0.4, 0.15
_GROWING = 0.6
"""Part of the training in which the weight of the median grows."""
_WINDOW = 5


def residual_loss(denoised: Tensor, noisy: Tensor, variance: float, done: float) -> Tensor:
    """Scalar, of images (N, C, H, W) in 0..1.

    variance: of the natural logarithm of the speckle.  done: part of the training, 0 to 1.
    """
    lit = (noisy >= _FLOOR).to(noisy.dtype)
    # Linear below black, so that a network that predicts less than nothing is told so.
    logarithm = torch.log(denoised.clamp_min(_FLOOR)) + (denoised / _FLOOR - 1).clamp_max(0)
    taken = (torch.log(noisy.clamp_min(_FLOOR)) - logarithm).clamp(-_LARGEST, _LARGEST)
    statistics = _statistics(taken, lit, variance)
    smoothness = sum(
        _weighed(_step(taken, axis).abs() * _flat(denoised, axis), _both(lit, axis))
        for axis in (-2, -1)
    )
    middle = torch.log(median(noisy).clamp_min(_FLOOR))
    drawn = _weighed((logarithm - middle).abs(), lit)
    weight = _MEDIAN * min(1.0, done / _GROWING)
    return weight * drawn + _STATISTICS * statistics + _SMOOTHNESS * smoothness


def median(images: Tensor) -> Tensor:
    """(N, C, H, W) -> the same: the median of 5x5 pixels; the borders are repeated."""
    margin = _WINDOW // 2
    wide = functional.pad(images, (margin,) * 4, mode="replicate")
    windows = wide.unfold(2, _WINDOW, 1).unfold(3, _WINDOW, 1)
    return windows.flatten(-2).median(dim=-1).values


def _statistics(taken: Tensor, lit: Tensor, variance: float) -> Tensor:
    """How far mean and variance are from those of speckle, mean over the pictures."""
    count = lit.sum(dim=(2, 3)).clamp_min(1)
    mean = (taken * lit).sum(dim=(2, 3)) / count
    spread = ((taken - mean[..., None, None]).square() * lit).sum(dim=(2, 3)) / count
    some = (lit.sum(dim=(2, 3)) > 0).to(taken.dtype)
    return (mean.abs() + some * (spread - variance).abs()).mean()


def _step(images: Tensor, axis: int) -> Tensor:
    return images.diff(dim=axis)


def _flat(images: Tensor, axis: int) -> Tensor:
    return torch.exp(-_step(images, axis).abs() / _EDGE)


def _both(lit: Tensor, axis: int) -> Tensor:
    """Whether both pixels of a step are lit."""
    size = lit.shape[axis]
    return lit.narrow(axis, 0, size - 1) * lit.narrow(axis, 1, size - 1)


def _weighed(values: Tensor, weights: Tensor) -> Tensor:
    """Mean of the values that count."""
    return (values * weights).sum() / weights.sum().clamp_min(1)
