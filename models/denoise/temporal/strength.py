"""How much of the noise that fusion leaves is removed, and by what: the recording calibrates it.

A frame outside the window has noise of its own, so what predicts it best is nearest to the static
scene (Lehtinen et al. 2018 train on this; here a few coefficients are fitted by least squares).
Predictors are the fused image, its weak total variation, the network and blurred images, each with
a coefficient by how much the image varies around a pixel.  Two sets are fitted: for a whole window,
and for a single frame, which is what is left where something moves.  Between them the logarithm of
the frame count interpolates.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
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
_SINGLE_FRAME_CHOICES = np.array([(tv, net) for tv in range(21) for net in range(6, 21 - tv)]) / 20
"""Parts of total variation and network that are tried for a single frame.  The network has its part
whatever predicts best, as it also removes static artefacts.  The frame gets the rest."""
_MIN_PIXELS = 500
LEAST_MEASURED = 3
"""Frames from which on a strength tells more of the recording than of one frame."""


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
    single: (2,) parts of total variation and network for a single frame.
    window: (classes of variation, predictors) for a whole window.
    """

    window_frames: int
    single: Float64s
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
        single[: len(self.single)] = self.single
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
    """How much each predictor contributes: in whole windows, and in single frames.

    measured: number of frames that this was fitted to.
    """

    network: float
    variation: float
    blurred: float
    single_network: float
    single_variation: float
    measured: int


class Strength:
    """Fits the coefficients of the predictors to frames outside the window.

    weights: fitted so far.  measured: number of frames that they were fitted to.
    """

    def __init__(self, window_frames: int, *, frame_aware: bool) -> None:
        """frame_aware: whether the network gets the number of averaged frames."""
        self._default = np.array(_DEFAULT_FRAME_AWARE if frame_aware else _DEFAULT_FRAME_BLIND)
        classes = len(_VARIATION_CLASSES)
        window = np.tile(self._default, (classes, 1))
        self.weights = Weights(window_frames, np.array([0.0, 1.0]), window)
        self.measured = 0
        self._single_squares = np.zeros((2, 2))
        self._single_products = np.zeros(2)
        self._window_squares = np.zeros((classes, _PREDICTORS, _PREDICTORS))
        self._window_products = np.zeros((classes, _PREDICTORS))
        self._window_pixels = np.zeros(classes)

    def add_single(self, predictors: Predictors, outside: Array, same: Bools) -> None:
        """Measure how well the predictors of a single frame predict a frame outside its window.

        outside: (H, W), that frame, aligned.  same: (H, W), where it shows the same scene.
        """
        if np.count_nonzero(same) < _MIN_PIXELS:
            return
        target = _target(predictors, outside, same)
        changes = _changes(predictors.changes[:2], same)
        self._single_squares += changes @ changes.T
        self._single_products += changes @ target

    def add_window(self, predictors: Predictors, outside: Array, same: Bools) -> None:
        """Add the predictors of a whole window."""
        if np.count_nonzero(same) < _MIN_PIXELS:
            return
        target = _target(predictors, outside, same)
        changes = _changes(predictors.changes, same)
        middles = np.array(_VARIATION_CLASSES) * _VARIATION_LEVELS / _VARIATION_CLASSES[-1]
        bounds = (middles[1:] + middles[:-1]) / 2
        classes = np.digitize(predictors.variation[same], bounds)
        for number in range(len(_VARIATION_CLASSES)):
            members = classes == number
            of_class = changes[:, members]
            self._window_squares[number] += of_class @ of_class.T
            self._window_products[number] += of_class @ target[members]
            self._window_pixels[number] += np.count_nonzero(members)

    def fit(self) -> None:
        """Choose the coefficients that predict best."""
        self.measured += 1
        choices = _SINGLE_FRAME_CHOICES
        squared_error = np.einsum("ni,ij,nj->n", choices, self._single_squares, choices)
        squared_error -= 2 * choices @ self._single_products
        single = self.weights.single
        if squared_error.any():
            single = choices[int(np.argmin(squared_error))]

        window = self.weights.window.copy()
        for number, pixels in enumerate(self._window_pixels):
            squares = self._window_squares[number]
            prior_weight = _PRIOR_SHARE + _PRIOR_PIXELS / (pixels + 1)
            prior = np.diag(np.diag(squares) * prior_weight + 1e-12)
            products = self._window_products[number] + prior @ self._default
            window[number] = np.linalg.solve(squares + prior, products)
        self.weights = replace(self.weights, single=single, window=window)

    @property
    def parts(self) -> StrengthParts:
        """The mean coefficients of the recording."""
        share = self._window_pixels / max(self._window_pixels.sum(), 1)
        variation, network, *blurs = (share @ self.weights.window).tolist()
        single_variation, single_network = self.weights.single.tolist()
        return StrengthParts(
            network, variation, sum(blurs), single_network, single_variation, self.measured
        )

    def __str__(self) -> str:
        parts = self.parts
        few = f", which is too few to rely on: {LEAST_MEASURED} at least"
        return (
            f"in whole windows {parts.network:.2f} network, {parts.variation:.2f} total "
            f"variation, {parts.blurred:.2f} blurred, the rest as fused; in single frames "
            f"{parts.single_network:.2f} network, {parts.single_variation:.2f} total variation "
            f"(measured on {parts.measured} frame{'s' * (parts.measured != 1)}"
            f"{few * (parts.measured < LEAST_MEASURED)})"
        )


def _target(predictors: Predictors, outside: Array, same: Bools) -> Float64s:
    """What the changes are to add up to, (pixels,), without a difference in gain."""
    target: Float64s = (outside - predictors.grey)[same].astype(np.float64)
    target -= target.mean()
    return target


def _changes(planes: Array, same: Bools) -> Float64s:
    """(predictors, pixels): the values of each plane where both frames show the same."""
    changes: Float64s = np.stack([plane[same] for plane in planes]).astype(np.float64)
    return changes
