"""How much of the noise that fusing leaves is removed, and by what: the recording itself says.

A frame outside the window has noise of its own, so what predicts it best is nearest to the scene
(Lehtinen et al. 2018 train on this; here a few numbers are fitted by least squares).  What predicts
are the fused frame, its weak total variation, the network and blurred frames, each with a weight by
how much the picture varies around a pixel.  A frame alone is fitted by itself, for what moves;
between it and a whole window the logarithm of how many frames count interpolates.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt

from .motion import Floats, Grey, blurred, length_of

_VARIATION, _VARIATION_STEPS = 0.9, 5
"""Weight of the total variation, standard deviations of the noise that is left; its iterations."""
_BLURS = (0.7, 1.2, 2.5)  # sigma, pixels
_PREDICTORS = 2 + len(_BLURS)  # total variation, network, blurred
_TOLD = (0.3, 0.7, *[0.0] * len(_BLURS))
_UNTOLD = (0.5, 0.3, *[0.0] * len(_BLURS))
"""Weights where nothing was measured, for a network that knows how many frames count, or not."""
_VARIES = (0.45, 0.75, 1.1, 1.55, 2.2, 3.3, 5.0)
"""Middles of the classes of how much a picture varies, standard deviations of its noise."""
_AROUND = 2.2  # sigma of the window in which it varies, pixels
_LEVELS = 64  # of how much it varies, in a table
_KNOWN, _SURE = 300.0, 1e-3
"""Pixels that count for the usual weights, and their part whatever is measured."""
_PARTS = np.array([(tv, net) for tv in range(21) for net in range(6, 21 - tv)]) / 20
"""Of total variation and network that are tried for a frame alone.  The network has its part, as it
also removes what is no noise in time; the rest of the frame stays as it is."""
_LEAST_PIXELS = 500


@dataclass(frozen=True, eq=False)
class Predictors:
    """What a picture without its noise may be like.

    grey: (H, W) as it is.  changes: of total variation, network and blurred frames from it.
    varies: (H, W) uint8, how much the picture varies around a pixel.
    """

    grey: Grey
    changes: list[Grey]
    varies: npt.NDArray[np.uint8]

    @classmethod
    def of(cls, grey: Grey, sigma: Grey, network: Grey) -> Predictors:
        """sigma: (H, W) of the picture's noise.  network: what that makes of it."""
        planes = [total_variation(grey, sigma), network, *(blurred(grey, one) for one in _BLURS)]
        spread = blurred(grey * grey, _AROUND) - blurred(grey, _AROUND) ** 2
        varies = np.sqrt(np.maximum(spread, 0)) / np.maximum(sigma, 1e-4)
        level = np.clip(varies * np.float32(_LEVELS / _VARIES[-1]), 0, _LEVELS - 1)
        return cls(grey, [plane - grey for plane in planes], level.astype(np.uint8))


@dataclass(frozen=True, eq=False)
class Weights:
    """What each predictor gets.

    frames: of a whole window.  alone: parts of the total variation and the network for a frame
    alone.  whole: (classes, predictors) for a whole window.
    """

    frames: int
    alone: Floats
    whole: Floats

    def applied(self, found: Predictors, frames: Grey) -> Grey:
        """All of it together, (H, W) in 0..1.  frames: how many count in each pixel."""
        along = np.clip(cv2.log(frames) / np.float32(np.log(max(self.frames, 2))), 0, 1)
        levels = np.minimum(np.arange(256), _LEVELS - 1) * _VARIES[-1] / _LEVELS
        whole, alone = np.zeros_like(found.grey), np.zeros_like(found.grey)
        for column, change in zip(self.whole.T, found.changes, strict=True):
            table = np.interp(levels, _VARIES, column).astype(np.float32)
            whole += cv2.LUT(found.varies, table) * change
        for part, change in zip(self.alone, found.changes[:2], strict=True):
            if part:
                alone += np.float32(part) * change
        return np.asarray(np.clip(found.grey + alone + along * (whole - alone), 0, 1))


class Strength:
    """Weights of what predicts, by how much the picture varies; see the top.

    weights: chosen so far.  measured: on how many frames they were.
    """

    def __init__(self, frames: int, *, told: bool) -> None:
        """told: whether the network knows how many frames count."""
        self._usual = np.array(_TOLD if told else _UNTOLD)
        whole = np.tile(self._usual, (len(_VARIES), 1))
        self.weights = Weights(frames, np.array([0.0, 1.0]), whole)
        self.measured = 0
        self._alone_sums = np.zeros((2, 2)), np.zeros(2)
        self._squares = np.zeros((len(_VARIES), _PREDICTORS, _PREDICTORS))
        self._products = np.zeros((len(_VARIES), _PREDICTORS))
        self._pixels = np.zeros(len(_VARIES))

    def add(
        self, whole: bool, found: Predictors, outside: Grey, where: npt.NDArray[np.bool_]
    ) -> None:
        """What predicts a frame outside the window.

        whole: of a whole window, else of a frame alone.
        where: pixels of `outside` that show the same scene.
        """
        if np.count_nonzero(where) < _LEAST_PIXELS:
            return
        target = (outside - found.grey)[where].astype(np.float64)
        target -= target.mean()  # of another gain
        kept = found.changes if whole else found.changes[:2]
        changes = np.stack([change[where] for change in kept]).astype(np.float64)
        if not whole:
            squares, products = self._alone_sums
            self._alone_sums = squares + changes @ changes.T, products + changes @ target
            return
        middles = np.array(_VARIES) * _LEVELS / _VARIES[-1]
        classes = np.digitize(found.varies[where], (middles[1:] + middles[:-1]) / 2)
        for number in range(len(_VARIES)):
            here = classes == number
            some = changes[:, here]
            self._squares[number] += some @ some.T
            self._products[number] += some @ target[here]
            self._pixels[number] += np.count_nonzero(here)

    def fit(self) -> None:
        """Choose the weights that predict best."""
        self.measured += 1
        squares, products = self._alone_sums
        error = np.einsum("ni,ij,nj->n", _PARTS, squares, _PARTS) - 2 * _PARTS @ products
        alone = _PARTS[int(np.argmin(error))] if error.any() else self.weights.alone
        whole = self.weights.whole.copy()
        for number, pixels in enumerate(self._pixels):
            power = self._squares[number]
            usual = np.diag(np.diag(power) * (_SURE + _KNOWN / (pixels + 1)) + 1e-12)
            whole[number] = np.linalg.solve(
                power + usual, self._products[number] + usual @ self._usual
            )
        self.weights = replace(self.weights, alone=alone, whole=whole)

    def __str__(self) -> str:
        pixels = self._pixels / max(self._pixels.sum(), 1)
        variation, network, *blurs = pixels @ self.weights.whole
        return (
            f"in whole windows {network:.2f} network, {variation:.2f} total variation, "
            f"{sum(blurs):.2f} blurred, the rest as fused; where something moves "
            f"{self.weights.alone[1]:.2f} network, {self.weights.alone[0]:.2f} total variation "
            f"(measured on {self.measured} frames)"
        )


def total_variation(grey: Grey, sigma: Grey) -> Grey:
    """The picture with less total variation, by how much noise is left in each pixel.

    grey: (H, W).  sigma: (H, W) standard deviation of its noise.
    Fast gradient projection of the dual (Beck and Teboulle 2009), isotropic.
    """
    weight = np.maximum(np.float32(_VARIATION) * sigma, np.float32(1e-4))
    step = np.float32(0.125) / weight
    height, width = grey.shape
    across, down = np.zeros((2, height, width), np.float32)
    last_across, last_down = across, down
    momentum = 1.0
    for _ in range(_VARIATION_STEPS):
        now = _less(grey, across, down, weight)
        new_across, new_down = across.copy(), down.copy()
        new_across[:, :-1] += (now[:, 1:] - now[:, :-1]) * step[:, :-1]
        new_down[:-1] += (now[1:] - now[:-1]) * step[:-1]
        length = np.maximum(length_of(new_across, new_down), 1)
        new_across /= length
        new_down /= length
        following = (1 + np.sqrt(1 + 4 * momentum * momentum)) / 2
        push = np.float32((momentum - 1) / following)
        across = new_across + push * (new_across - last_across)
        down = new_down + push * (new_down - last_down)
        last_across, last_down, momentum = new_across, new_down, following
    return _less(grey, last_across, last_down, weight)


def _less(grey: Grey, across: Grey, down: Grey, weight: Grey) -> Grey:
    """The picture and the divergence of the dual, times the weight."""
    divergence: Grey = across + down
    divergence[:, 1:] -= across[:, :-1]
    divergence[1:] -= down[:-1]
    divergence *= weight
    divergence += grey
    return divergence
