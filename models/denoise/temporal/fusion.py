"""Frames laid over each other become one, where they show the same as far as noise lets it be seen.

What noise explains is measured in the recording itself, one usual difference a grey level.  A
neighbour goes into a pixel where it agrees with the median of all frames (and so does the frame
itself), over a small window and over a wide one; where the frame does not agree with the median,
something moves there: then only neighbours that agree with the frame itself go in, mostly none.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from .motion import Floats, Grey, blurred, factors, grey_of, reduced

_LEVELS = 32
_LEAST_PIXELS = 20
_LEAST_SIGMA = 0.0015
_NORMAL = 1.4826  # from the median of absolute values to a standard deviation
_EVERY = 3  # pixels along each side from one that is measured to the next
_LEARNED, _AGAIN = 30, 8
"""Frames after which differences are measured in every so many only."""
_SMALL, _WIDE, _CLIP = 0.8, 7, 3.0
"""Sigma of the small window, reduced pixels; side of the wide one; deviations count no more."""
_AGREES, _LIKE = 7.0, 4.0
"""Standard deviations up to which a frame agrees with the median, and a neighbour with a frame."""
_DARK = 0.02  # grey value below which there is nothing to learn from


@dataclass(frozen=True, eq=False)
class Fused:
    """picture: (H, W) or (H, W, C) float32.  frames: (H, W), how many count in each pixel, >= 1.

    agrees: (H, W), how far the frame itself agrees with the others, 0..1; 0: something moves.
    """

    picture: Grey
    frames: Grey
    agrees: Grey


class Fusion:
    """Fuses frames, and learns with each what noise explains.

    noise: of a pixel of a single frame.
    """

    def __init__(self) -> None:
        self._seen = 0
        self._to_median, self._to_frame = _Agreement(_AGREES), _Agreement(_LIKE)
        self.noise = Usual()

    def __call__(self, own: Grey, laid: Sequence[Grey], shown: Sequence[Grey]) -> Fused:
        """The frame with its neighbours.

        own, laid: (H, W) or (H, W, C) float32 in 0..1.  shown: (H, W), 1 where a neighbour shows
        what the frame does, else 0.
        """
        grey, others = grey_of(own), [grey_of(other) for other in laid]
        one = np.ones(grey.shape, np.float32)
        if not laid:
            return Fused(own, one, one)
        # The neighbour that noise is measured with; None: not now.
        now = self._seen < _LEARNED or self._seen % _AGAIN == 0
        which = self._seen % len(laid) if now else None
        self._seen += 1
        if which is not None:
            apart = (others[which] - grey) * np.float32(np.sqrt(0.5))
            self.noise.add(apart, grey * shown[which])
        weights, agrees = self._weights(grey, others, shown, which)
        (height, width), (down, right) = grey.shape, factors(grey.shape)
        size = width // right * right, height // down * down

        def enlarged(plane: Grey) -> Grey:
            found = cv2.resize(plane, size, interpolation=cv2.INTER_LINEAR)
            return np.pad(found, ((0, height % down), (0, width % right)), mode="edge")

        total, count, squares = own.copy(), one.copy(), one.copy()
        for other, mask, weight in zip(laid, shown, weights, strict=True):
            part = enlarged(weight) * mask
            total += other * (part if own.ndim == 2 else part[..., None])
            count += part
            squares += part * part
        total = total / (count if own.ndim == 2 else count[..., None])
        return Fused(total, count * count / squares, enlarged(agrees))

    def same(self, fused: Grey, outside: Grey, shown: Grey) -> npt.NDArray[np.bool_]:
        """Where another frame, (H, W), shows what was fused, as far as noise lets it be seen."""
        small = blurred(reduced(fused), _SMALL)
        apart = np.abs(blurred(reduced(outside), _SMALL) - small) / self._to_frame.usual.at(small)
        agrees = (apart < _LIKE) & (small > _DARK)
        size = fused.shape[1], fused.shape[0]
        found = cv2.resize(agrees.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
        return np.asarray(found & (shown > 0))

    def _weights(
        self, own: Grey, others: Sequence[Grey], shown: Sequence[Grey], which: int | None
    ) -> tuple[list[Grey], Grey]:
        """Of the neighbours, and how far the frame itself agrees with the median; all reduced."""
        own = blurred(reduced(own), _SMALL)
        seen = [cv2.erode((reduced(one) > 0.99).astype(np.uint8), np.ones((5, 5))) for one in shown]
        smalls = [
            np.where(mask > 0, blurred(reduced(other), _SMALL), own)
            for other, mask in zip(others, seen, strict=True)
        ]
        middle = median([*smalls, own])
        level = middle if which is None else middle * seen[which]
        apart = [one - middle for one in (*smalls, own)]
        *agree, agrees = self._to_median(apart, middle, which, level)
        like = self._to_frame([one - own for one in smalls], own, which, level)
        weights = []
        for one, other in zip(agree, like, strict=True):
            least = cv2.erode(one * agrees + (1 - agrees) * other, np.ones((3, 3), np.uint8))
            weights.append(cv2.blur(least, (3, 3)))
        return weights, agrees


class _Agreement:
    """How far frames agree in a small window and in a wide one, up to a limit in deviations."""

    def __init__(self, limit: float) -> None:
        self._limit, self.usual, self._wide = np.float32(limit), Usual(), Usual()

    def __call__(
        self, apart: Sequence[Grey], grey: Grey, learned: int | None, level: Grey
    ) -> list[Grey]:
        """Of deviations from `grey`: 1 up to the limit in both windows, then falling to 0.

        learned: which of them are measured, by grey `level`; None: none.
        """
        if learned is not None:
            self.usual.add(apart[learned], level)
        sigma = self.usual.at(grey)
        apart = [one / sigma for one in apart]
        # A thing that moves nearby must not fill the wide window.
        wide = [cv2.blur(np.clip(one, -_CLIP, _CLIP), (_WIDE, _WIDE)) for one in apart]
        if learned is not None:
            self._wide.add(wide[learned], level)
        sigma, found = self._wide.at(grey), []
        for small, large in zip(apart, wide, strict=True):
            over = np.maximum(np.maximum(np.abs(small), np.abs(large / sigma)) - self._limit, 0)
            found.append(cv2.exp(-over * over))
        return found


class Usual:
    """How far values deviate by noise alone, by grey level: robust, the mean over frames."""

    def __init__(self) -> None:
        self._sum, self._pixels = np.zeros(_LEVELS), np.zeros(_LEVELS)

    def add(self, deviation: Grey, grey: Grey) -> None:
        """Deviations of pixels of some grey value in 0..1."""
        level = np.minimum(grey[::_EVERY, ::_EVERY] * _LEVELS, _LEVELS - 1).astype(np.int32).ravel()
        size = np.abs(deviation[::_EVERY, ::_EVERY]).ravel()
        order = np.argsort(level, kind="stable")
        size, ends = size[order], np.searchsorted(level[order], np.arange(_LEVELS + 1))
        for number, (first, last) in enumerate(itertools.pairwise(ends)):
            if last - first >= _LEAST_PIXELS:
                usual = _NORMAL * float(np.median(size[first:last]))
                self._sum[number] += usual * (last - first)
                self._pixels[number] += last - first

    def at(self, grey: Grey) -> Grey:
        """Standard deviation at each pixel of such a grey value.

        Neighbouring levels share what they know.
        """
        known = self._pixels > 0
        if not known.any():
            return np.full(grey.shape, _LEAST_SIGMA, np.float32)
        middles = (np.arange(_LEVELS) + 0.5) / _LEVELS
        sigma = np.interp(middles, middles[known], self._sum[known] / self._pixels[known])
        pixels = np.interp(middles, middles[known], self._pixels[known])
        window = np.array([1.0, 2, 3, 2, 1])
        power: Floats = np.convolve(np.pad(sigma**2 * pixels, 2, mode="edge"), window, "valid")
        power = power / np.convolve(np.pad(pixels, 2, mode="edge"), window, "valid")
        fine = np.interp(np.linspace(0, 1, 256), middles, np.sqrt(power))
        table = np.maximum(fine, _LEAST_SIGMA).astype(np.float32)
        return cv2.LUT(np.clip(grey * 255, 0, 255).astype(np.uint8), table)


def median(planes: Sequence[Grey]) -> Grey:
    """Of some planes, pixel by pixel, by a network of lesser and greater ones."""
    left, count = list(planes), len(planes)
    for done in range(count // 2 + 1):
        for one in range(count - 1 - done):
            lesser = np.minimum(left[one], left[one + 1])
            left[one + 1] = np.maximum(left[one], left[one + 1])
            left[one] = lesser
    if count % 2:
        return left[count // 2]
    return (left[count // 2] + left[count // 2 - 1]) / np.float32(2)
