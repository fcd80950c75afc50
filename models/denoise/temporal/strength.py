"""How much of the noise that fusing leaves is removed, and by what: the recording itself says.

A frame outside the window has noise of its own, so what predicts it best is nearest to the scene
(Lehtinen et al. 2018 train on this; here three numbers are fitted).  The parts of the fused frame,
of its weak total variation and of the network are fitted for a frame alone and for a whole window;
between them they are interpolated by the logarithm of how many frames count in a pixel.
"""

from __future__ import annotations

import itertools

import cv2
import numpy as np
import numpy.typing as npt

from .motion import Grey

Floats = npt.NDArray[np.float64]
Parts = tuple[float, float, float]
"""Of the fused frame, its total variation and the network; they add up to 1."""

AS_FUSED: Parts = (1.0, 0.0, 0.0)
ALONE: Parts = (0.0, 0.0, 1.0)
TOLD: Parts = (0.0, 0.3, 0.7)
UNTOLD: Parts = (0.2, 0.5, 0.3)
"""Where nothing was measured: of a frame alone, and of a whole window for a network that knows how
many frames count and for one that does not."""

_VARIATION = 0.9
"""Weight of the total variation, standard deviations of the noise that is left."""
_VARIATION_STEPS = 10
_FINENESS = 20  # parts that are tried: twentieths
_LEAST_NETWORK = 0.3  # of a frame alone: it also removes what is no noise in time
_PRIOR = 2e-7  # how much worse a prediction counts far from what is usual
_LEAST_PIXELS = 500


class Strength:
    """Parts of the fused frame, its total variation and the network, by how many frames count.

    alone, whole: of a frame alone, and of a window of `frames`.
    measured: on how many frames they were.
    """

    def __init__(self, frames: int, usual: tuple[Parts, Parts]) -> None:
        """usual: of a frame alone and of a whole window, until anything is measured."""
        self._frames, self._usual = frames, usual
        self._least_network = _LEAST_NETWORK
        self.alone, self.whole = self._usual
        self.measured = 0
        self._sums = [(np.zeros((3, 3)), np.zeros(3), 0) for _ in range(2)]

    def needs(self, which: int) -> bool:
        """Whether a part counts anywhere."""
        return self.alone[which] > 0 or self.whole[which] > 0

    def applied(
        self, fused: Grey, variation: Grey | None, network: Grey | None, frames: Grey
    ) -> Grey:
        """All of them together, (H, W) in 0..1.  frames: how many count in each pixel."""
        along = np.clip(cv2.log(frames) / np.float32(np.log(max(self._frames, 2))), 0, 1)

        def part(which: int) -> Grey | np.float32:
            first, last = np.float32(self.alone[which]), np.float32(self.whole[which])
            return first if first == last else first + (last - first) * along

        result = fused.copy()
        for which, found in ((1, variation), (2, network)):
            if found is not None:
                result += part(which) * (found - fused)
        return np.clip(result, 0, 1)

    def add(self, whole: bool, planes: tuple[Grey, Grey, Grey], outside: Grey, where: Grey) -> None:
        """What predicts a frame outside the window.

        whole: of a whole window, else of a frame alone.  planes: fused, total variation, network.
        where: pixels of `outside` that show the same scene, bool.
        """
        if np.count_nonzero(where) < _LEAST_PIXELS:
            return
        fused, variation, network = (plane[where].astype(np.float64) for plane in planes)
        change = np.stack([np.zeros_like(fused), variation - fused, network - fused])
        target = outside[where] - fused
        level = target.mean()  # of another gain
        squares, products, pixels = self._sums[whole]
        self._sums[whole] = (
            squares + change @ change.T,
            products + change @ (target - level),
            pixels + fused.size,
        )

    def fit(self) -> None:
        """Choose the parts that predict best."""
        self.measured += 1
        self.alone, self.whole = (
            self._fitted(sums, usual, least)
            for sums, usual, least in zip(
                self._sums, self._usual, (self._least_network, 0.0), strict=True
            )
        )

    def _fitted(self, sums: tuple[Floats, Floats, int], usual: Parts, least: float) -> Parts:
        squares, products, pixels = sums
        if not pixels:
            return usual
        tried = _all_parts()
        tried = tried[tried[:, 2] >= least]
        error = np.einsum("ni,ij,nj->n", tried, squares, tried) - 2 * tried @ products
        error = error / pixels + _PRIOR * ((tried - np.array(usual)) ** 2).sum(axis=1)
        fused, variation, network = tried[int(np.argmin(error))]
        return float(fused), float(variation), float(network)

    def __str__(self) -> str:
        def said(parts: Parts) -> str:
            return f"{parts[2]:.2f} network, {parts[1]:.2f} variation, {parts[0]:.2f} as fused"

        return f"whole windows: {said(self.whole)}; a frame alone: {said(self.alone)}"


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
        length = np.maximum(cv2.magnitude(new_across, new_down), 1)
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
    divergence = across + down
    divergence[:, 1:] -= across[:, :-1]
    divergence[1:] -= down[:-1]
    divergence *= weight
    divergence += grey
    return divergence


def _all_parts() -> Floats:
    parts = [
        (first, second, _FINENESS - first - second)
        for first, second in itertools.product(range(_FINENESS + 1), repeat=2)
        if first + second <= _FINENESS
    ]
    return np.array(parts, np.float64) / _FINENESS
