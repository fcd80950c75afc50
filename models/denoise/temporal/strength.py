"""How much of the noise that fusion leaves is removed, and by what: the recording calibrates it.

A frame outside the window has noise of its own, so what predicts it best is nearest to the static
scene (Lehtinen et al. 2018 train on this; here a few coefficients are fitted by least squares).
Predictors are the fused image, its weak total variation, the network and blurred images, each with
a coefficient by how much the image varies around a pixel.  They are fitted for a whole window;
where something moves a single frame is left, and there the network counts alone.  Between both the
logarithm of the frame count interpolates.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from ....factory.common.array_types import Array, Bools, Float64s, UInt8s
from ..total_variation import less_total_variation
from .motion import blurred

_TV_WEIGHT = 0.9
_TV_STEPS = 5
"""Weight of the total variation, standard deviations of the noise that is left; its iterations."""
_BLUR_SIGMAS_PX = (0.7, 1.2, 2.5)
_PREDICTORS = 2 + len(_BLUR_SIGMAS_PX)  # total variation, network, blurred
_DEFAULT_FRAME_AWARE = (0.3, 0.7, *[0.0] * len(_BLUR_SIGMAS_PX))
_DEFAULT_FRAME_BLIND = (0.5, 0.3, *[0.0] * len(_BLUR_SIGMAS_PX))
"""Coefficients before anything is measured, for networks that get the frame count and others."""
_VARIATION_CLASSES = (0.45, 0.75, 1.1, 1.55, 2.2, 3.3, 5.0)
"""Middles of the classes of local variation, standard deviations of the image's noise."""
_VARIATION_SIGMA_PX = 2.2  # of the window in which it is measured
_VARIATION_LEVELS = 64  # of its table
_PRIOR_PIXELS = 300.0
_PRIOR_SHARE = 1e-3
"""Pixels that count for the default coefficients, and their part whatever is measured."""
_NETWORK = 1  # index of its predictor
_STRIDE = 2  # of the pixels that are measured
_MIN_PIXELS = 100


@dataclass(frozen=True, eq=False)
class Predictors:
    """What an image may be like without its noise.

    grey: (H, W) the image itself.
    changes: (n, H, W) of total variation, network and blurred images, relative to `grey`.
    variation: (H, W) uint8, level of how much the image varies around a pixel.
    """

    grey: Array
    changes: Array
    variation: UInt8s

    @classmethod
    def of(cls, grey: Array, sigma: Array, network_output: Array) -> Predictors:
        """Predictors of an image, (H, W), whose noise has standard deviation `sigma`, (H, W)."""
        from . import kernels  # loads numba

        changes = np.empty((_PREDICTORS, *grey.shape), np.float32)
        weight = np.float32(_TV_WEIGHT) * sigma
        np.subtract(less_total_variation(grey, weight, _TV_STEPS), grey, out=changes[0])
        np.subtract(network_output, grey, out=changes[1])
        for change, sigma_px in zip(changes[2:], _BLUR_SIGMAS_PX, strict=True):
            np.subtract(blurred(grey, sigma_px), grey, out=change)

        variation = kernels.variation_level(
            blurred(grey * grey, _VARIATION_SIGMA_PX),
            blurred(grey, _VARIATION_SIGMA_PX),
            sigma,
            np.float32(_VARIATION_LEVELS / _VARIATION_CLASSES[-1]),
            np.float32(_VARIATION_LEVELS - 1),
        )
        return cls(grey, changes, variation)


@dataclass(frozen=True, eq=False)
class Weights:
    """Coefficients of the predictors.

    window_frames: frames of a whole window.
    window: (classes of variation, predictors) for a whole window.  A single frame is what the
    network makes of it.
    """

    window_frames: int
    window: Float64s

    def apply(self, predictors: Predictors, frame_count: Array) -> Array:
        """The prediction, (H, W) in 0..1.  frame_count: (H, W), frames averaged at each pixel."""
        from . import kernels  # loads numba

        log_window = np.float32(np.log(max(self.window_frames, 2)))
        window_share = np.clip(cv2.log(frame_count) / log_window, 0, 1)

        variation = np.arange(_VARIATION_LEVELS) * _VARIATION_CLASSES[-1] / _VARIATION_LEVELS
        tables = np.array(
            [np.interp(variation, _VARIATION_CLASSES, values) for values in self.window.T],
            np.float32,
        )
        single = np.zeros(len(tables), np.float32)
        single[_NETWORK] = 1
        return np.asarray(
            kernels.weighted_changes(
                predictors.grey,
                predictors.changes,
                predictors.variation,
                window_share,
                tables,
                single,
            )
        )


class StrengthParts(NamedTuple):
    """How much each predictor contributes in whole windows; measured: frames it was fitted to."""

    network: float
    variation: float
    blurred: float
    measured: int


@dataclass(frozen=True, eq=False)
class Measurement:
    """How well the predictors of a frame predict a frame outside its window.

    squares, products: of the normal equations, by class of variation.  pixels: of each class.
    """

    squares: Float64s
    products: Float64s
    pixels: Float64s

    @classmethod
    def of(cls, predictors: Predictors, outside: Array, same: Bools) -> Measurement | None:
        """Measure on a grey frame; None where both frames share too little.

        outside: (H, W), the other frame, aligned.  same: (H, W), where it shows the same scene.
        """
        from . import kernels  # loads numba

        if np.count_nonzero(same) < _MIN_PIXELS:
            return None
        middles = np.array(_VARIATION_CLASSES) * _VARIATION_LEVELS / _VARIATION_CLASSES[-1]
        bounds = (middles[1:] + middles[:-1]) / 2
        sums = kernels.normal_equations(
            predictors.changes,
            predictors.variation,
            outside - predictors.grey,
            np.ascontiguousarray(same).view(np.uint8),
            np.digitize(np.arange(_VARIATION_LEVELS), bounds),
            _STRIDE,
        )
        changes = np.s_[:, :_PREDICTORS]
        target, one = sums[:, -2], sums[:, -1]
        pixels = one[:, -1]
        # Without a difference in gain.
        mean = one[:, -2].sum() / max(pixels.sum(), 1)
        squares = np.tril(sums[changes][..., :_PREDICTORS])
        squares = squares + np.tril(squares, -1).transpose(0, 2, 1)
        products = target[changes] - mean * one[changes]
        return cls(squares, products, pixels)


class Strength(NamedTuple):
    """Coefficients that were fitted to some frames.  parts: their means, for reports."""

    weights: Weights
    parts: StrengthParts


def fitted(
    measurements: Sequence[Measurement], window_frames: int, *, frame_aware: bool
) -> Strength:
    """The coefficients that predict best.

    frame_aware: whether the network gets the number of averaged frames.
    """
    default = np.array(_DEFAULT_FRAME_AWARE if frame_aware else _DEFAULT_FRAME_BLIND)
    window = np.tile(default, (len(_VARIATION_CLASSES), 1))
    pixels = sum((each.pixels for each in measurements), np.zeros(len(_VARIATION_CLASSES)))
    if measurements:
        squares = np.sum([each.squares for each in measurements], axis=0)
        products = np.sum([each.products for each in measurements], axis=0)
        for number in range(len(_VARIATION_CLASSES)):
            prior_weight = _PRIOR_SHARE + _PRIOR_PIXELS / (_STRIDE**2 * pixels[number] + 1)
            prior = np.diag(np.diag(squares[number]) * prior_weight + 1e-12)
            window[number] = np.linalg.solve(
                squares[number] + prior, products[number] + prior @ default
            )
    variation, network, *blurs = (pixels / max(pixels.sum(), 1) @ window).tolist()
    parts = StrengthParts(network, variation, sum(blurs), len(measurements))
    return Strength(Weights(window_frames, window), parts)
