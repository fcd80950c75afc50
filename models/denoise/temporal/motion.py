"""How the scene moves from one frame to another: the whole frame, then blocks of it.

The motion of a frame is affine: a yaw shifts the beams of a ping and turns a fan, a surge shifts
its ranges.  It starts from what phase correlation, the frames before or the compass say, is
refined below a pixel by Gauss-Newton steps (Lucas and Kanade 1981; the Hessian is that of the fixed
frame, Baker and Matthews 2004), and must explain the frame better than no motion does: most
sonars are at rest, and laying a frame over another between its pixels costs sharpness.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import cv2
import numpy as np

from ....factory.common.array_types import Array, Float64s

ALIKE = 0.33
"""Frames whose band-passed images correlate less show something else."""
_BY_CHANCE = 4.0  # standard deviations of the correlation of unlike frames, the best of all shifts
_FURTHEST = 48  # reduced pixels that the peak of a phase correlation may lie away
_BETTER = 0.08  # part of what no motion leaves that a motion must explain
_STEPS = 4  # of Gauss and Newton, at most
_STEPS_BETWEEN = 2  # from a start by way of frames between, which is near
_SETTLED = 0.02  # largest change of a step that ends them
_STILL = 0.06  # reduced pixels: less is no motion
_WHITENED = 0.6  # exponent of the magnitudes in the phase correlation
_LIT = 0.012  # grey value: darker surroundings hold no scene
_CELL = 16  # reduced pixels: side of a block
_BLOCK_SURE = 30.0  # squared standard deviations: only then a block moves independently
_BLOCK_USUAL = 0.35  # reduced pixels: standard deviation expected of a block
_AFFINE_USUAL = 0.7  # and of the edges of a frame against its middle
_GRAIN = 8.0  # neighbouring pixels that noise shares
_LEAST_HALVED = 192
_SAMPLED = 7  # every such pixel tells the spread of a residual
_LIT_AROUND = (7, 7)  # reduced pixels over which a scene must be lit
_LEVEL_AROUND = (21, 21)  # reduced pixels whose mean is the coarse level
_LEAST_SHARE = 1e-3  # of them lit, against division by 0
_GRAIN_SIGMA = 1.0  # reduced pixels: blur that takes fine grain away
_SOBEL_SCALE = 1 / 8  # makes OpenCV's sums differences of a pixel
_OUTLIER = 2.5  # standard deviations at which a residual is clipped
_SIGMA_OF_MEDIAN = 1.4826  # standard deviation over the median magnitude of a normal variable
_LEAST_SIGMA = 1e-4
_BETTER_START = 0.01  # of the correlation, by which a start must be ahead of the others
_FLOW_SIGMA = 0.8  # cells: blur of the motion of blocks
_LEAST_FLOW = 0.15  # reduced pixels: less is no motion of a block


@dataclass(frozen=True, eq=False)
class Motion:
    """Where the pixels of a frame lie in another.

    affine: (6,) shift right and down of the middle, and its change along x and y from the middle
        to the right edge (x by x, x by y, y by x, y by y), in reduced pixels.
    flow: (rows, columns, 2) what blocks moved besides; None: nothing.
    """

    affine: Float64s
    flow: Array | None

    def inverse(self, shape: tuple[int, int]) -> Motion:
        """Where the pixels of the other lie in this one.  shape: of the reduced images."""
        back = -self.affine
        if self.affine[2:].any():
            back = _affine(np.linalg.inv(_matrix(self.affine, shape)), shape)
        return Motion(back, None if self.flow is None else -self.flow)


class _Residual(NamedTuple):
    """What a motion leaves of the difference of two frames.

    plane: (h, w), clipped where objects move.  noise: its power.  projected: (6,) its products with
    the changes of the frame by the numbers of a motion.
    """

    plane: Array
    noise: float
    projected: Float64s


class AlignmentView:
    """What alignment keeps of a frame: reduced, its noise made equal, coarse levels taken away.

    grey: (H, W) in 0..1.  shift_px: see `Aligner.add`.
    lit: (h, w) 1 where the scene is lit all around, else 0.  band: (h, w) root of the grey values
    without fine grain and coarse level, 0 where not lit.
    """

    def __init__(self, grey: Array, shift_px: tuple[float, float] | None) -> None:
        self.full_shape = grey.shape
        self.shift_px = shift_px
        small = np.sqrt(np.maximum(reduced(grey), 0))  # noise grows with the level
        lit = (cv2.blur(small, _LIT_AROUND) > np.sqrt(_LIT)).astype(np.float32)
        window = np.ones(_LIT_AROUND, np.uint8)
        self.lit: Array = cv2.erode(lit, window, borderType=cv2.BORDER_CONSTANT, borderValue=(1.0,))
        lit_share = np.maximum(cv2.blur(self.lit, _LEVEL_AROUND), _LEAST_SHARE)
        coarse_level = cv2.blur(small * self.lit, _LEVEL_AROUND) / lit_share
        self.band: Array = (blurred(small, _GRAIN_SIGMA) - coarse_level) * self.lit
        self.shape: tuple[int, int] = self.band.shape
        self.sampled = self.lit.ravel()[::_SAMPLED] > 0

    @cached_property
    def slopes(self) -> tuple[Array, Array]:
        """Slopes of the band along x and y."""
        along = cv2.Sobel(self.band, cv2.CV_32F, 1, 0, scale=_SOBEL_SCALE)
        down = cv2.Sobel(self.band, cv2.CV_32F, 0, 1, scale=_SOBEL_SCALE)
        return along * self.lit, down * self.lit

    @cached_property
    def hessian(self) -> Float64s:
        """(6, 6) products of the changes of the band with the numbers of a motion."""
        from . import kernels  # loads numba

        return np.asarray(kernels.hessian(*self.slopes))

    @cached_property
    def block_powers(self) -> tuple[Array, Array, Array]:
        """Sums of the products of the slopes over blocks: x by x, y by y, x by y."""
        along, down = self.slopes
        return _block_sums(along * along), _block_sums(down * down), _block_sums(along * down)

    @cached_property
    def spectrum(self) -> Array:
        """Spectrum of the band, faded out at the edges."""
        height, width = self.shape
        padded = np.zeros((cv2.getOptimalDFTSize(height), cv2.getOptimalDFTSize(width)), np.float32)
        faded: Array = np.outer(np.hanning(height), np.hanning(width)).astype(np.float32)
        padded[:height, :width] = self.band * faded
        return cv2.dft(padded, flags=cv2.DFT_COMPLEX_OUTPUT)


class Aligner:
    """Motions between frames of a recording, each found when it is first asked for.

    previous: the frame before one on its chain, or None; see `Grouping`.  A motion over several
    frames starts from those between neighbours, so it depends on the frames between alone.
    """

    def __init__(self, previous: Callable[[int], int | None]) -> None:
        self._previous = previous
        self._views: dict[int, AlignmentView] = {}
        self._motions: dict[tuple[int, int], Motion | None] = {}

    def add(self, number: int, grey: Array, shift_px: tuple[float, float] | None = None) -> None:
        """The next frame, (H, W) in 0..1.

        shift_px: how far right and down what the frame before saw lies now, where a compass tells
        it; a start, nothing more.
        """
        self._views[number] = AlignmentView(grey, shift_px)

    def forget(self, number: int) -> None:
        """Drop a frame and its motions."""
        self._views.pop(number, None)
        for pair in [pair for pair in self._motions if number in pair]:
            del self._motions[pair]

    def motion(self, number: int, neighbour: int) -> Motion | None:
        """Where the pixels of a frame lie in a neighbour; None where that shows something else."""
        if neighbour > number:
            motion = self.motion(neighbour, number)
            return None if motion is None else motion.inverse(self._views[number].shape)
        if (number, neighbour) not in self._motions:
            self._motions[number, neighbour] = self._estimate(number, neighbour)
        return self._motions[number, neighbour]

    def _estimate(self, number: int, neighbour: int) -> Motion | None:
        view = self._views.get(number)
        neighbour_view = self._views.get(neighbour)
        if view is None or neighbour_view is None or view.full_shape != neighbour_view.full_shape:
            return None
        start = self._by_way_of_previous(number, neighbour)
        pair = _Pair(view, neighbour_view)
        if start is not None:
            affine, correlation = _affine_motion(pair, [start], _STEPS_BETWEEN)
        else:
            affine, correlation = _affine_motion(pair, self._starts(view, neighbour_view), _STEPS)
        pixels = max(float(view.lit.sum()), 1.0)
        if correlation < ALIKE + _BY_CHANCE / np.sqrt(pixels / _GRAIN):
            return None
        return Motion(affine, _block_flow(pair, affine))

    def _by_way_of_previous(self, number: int, neighbour: int) -> Float64s | None:
        """The motion by way of the frame before, where that lies between both."""
        previous = self._previous(number)
        if previous is None or previous <= neighbour:
            return None
        first = self.motion(number, previous)
        second = self.motion(previous, neighbour)
        if first is None or second is None:
            return None
        shape = self._views[number].shape
        return _affine(_matrix(second.affine, shape) @ _matrix(first.affine, shape), shape)

    def _starts(self, view: AlignmentView, neighbour_view: AlignmentView) -> list[Float64s]:
        """Motions to start from between frames that follow each other."""
        starts = [_phase_shift(view, neighbour_view)]
        if view.shift_px is not None:
            right_px, down_px = view.shift_px
            down, right = factors(view.full_shape)
            starts.append(np.array([-right_px / right, -down_px / down, 0, 0, 0, 0]))
        return starts


def laid_over(grey: Array, motion: Motion) -> tuple[Array, Array]:
    """A frame as it looks where the other one was taken, and where it shows that, (H, W) of 0 or 1.

    grey: (H, W) or (H, W, C).  Whole pixels are copied, others interpolated (bicubic).
    """
    height, width = grey.shape[:2]
    down, right = factors(grey.shape)
    if motion.flow is None and not motion.affine.any():
        return grey, everywhere(height, width)
    matrix = _matrix(motion.affine, (height // down, width // right))
    # From reduced images to those of full size.
    up = np.diag([right, down, 1.0])
    up[:2, 2] = (right - 1) / 2, (down - 1) / 2
    matrix = (up @ matrix @ np.linalg.inv(up))[:2]
    whole = not motion.affine[2:].any() and np.allclose(matrix, np.round(matrix))
    size = (width, height)
    outside: dict[str, Any] = {"borderMode": cv2.BORDER_CONSTANT, "borderValue": -1.0}
    if motion.flow is None:
        interpolation = cv2.INTER_NEAREST if whole else cv2.INTER_CUBIC
        flags = interpolation | cv2.WARP_INVERSE_MAP
        laid = cv2.warpAffine(grey, matrix, size, flags=flags, **outside)
    else:
        y, x = (axis.astype(np.float32) for axis in np.ogrid[:height, :width])
        m = matrix.astype(np.float32)
        flow = cv2.resize(motion.flow, size, interpolation=cv2.INTER_LINEAR)
        laid = cv2.remap(
            grey,
            m[0, 0] * x + m[0, 1] * y + (m[0, 2] + right * flow[..., 0]),
            m[1, 0] * x + m[1, 1] * y + (m[1, 2] + down * flow[..., 1]),
            cv2.INTER_CUBIC,
            **outside,
        )
    shown = laid if laid.ndim == 2 else laid[..., 0]
    return np.clip(laid, 0, 1), (shown > -0.05).astype(np.float32)


@lru_cache(maxsize=8)
def everywhere(height: int, width: int) -> Array:
    """(H, W) ones, not to be changed; the same array for all frames that show all of another."""
    ones = np.ones((height, width), np.float32)
    ones.flags.writeable = False
    return ones


def grey_of(levels: Array) -> Array:
    """(H, W) of (H, W) or (H, W, C): the mean of the colours."""
    return levels if levels.ndim == 2 else levels.mean(axis=2, dtype=np.float32)


def reduced(grey: Array) -> Array:
    """Half as large, means of neighbours, along sides long enough."""
    down, right = factors(grey.shape)
    if down == right == 1:
        return grey
    height = grey.shape[0] // down
    width = grey.shape[1] // right
    even = grey[: height * down, : width * right]
    return cv2.resize(even, (width, height), interpolation=cv2.INTER_AREA)


def blurred(grey: Array, sigma: float) -> Array:
    """The image blurred by a Gaussian window."""
    return cv2.GaussianBlur(grey, (0, 0), sigma, borderType=cv2.BORDER_REFLECT)


def length_of(across: Array, down: Array) -> Array:
    """Length of vectors.  OpenCV's result depends on where the arrays lie in memory."""
    return np.sqrt(across * across + down * down)


def factors(shape: tuple[int, ...]) -> tuple[int, int]:
    """How many rows and columns a reduced pixel stands for."""
    down, right = (2 if side >= _LEAST_HALVED else 1 for side in shape[:2])
    return down, right


class _Pair:
    """Two frames, and what their bands leave of each other by the motions that were tried."""

    def __init__(self, view: AlignmentView, neighbour_view: AlignmentView) -> None:
        self.view = view
        self.neighbour_view = neighbour_view
        self._warped: dict[bytes, Array] = {}
        self._residuals: dict[bytes, _Residual] = {}

    def warped(self, affine: Float64s) -> Array:
        """The band of the neighbour as seen from the frame, interpolated linearly."""
        key = affine.tobytes()
        if key not in self._warped:
            self._warped[key] = _warp(self.neighbour_view.band, affine)
        return self._warped[key]

    def residual(self, affine: Float64s) -> _Residual:
        """What a motion leaves."""
        key = affine.tobytes()
        if key not in self._residuals:
            self._residuals[key] = _residual(self.view, self.warped(affine))
        return self._residuals[key]


def _affine_motion(pair: _Pair, starts: Sequence[Float64s], steps: int) -> tuple[Float64s, float]:
    """The simplest affine motion that explains the frame, and the correlation that it leaves."""
    band = pair.view.band
    neighbour_band = pair.neighbour_view.band
    none = np.zeros(6)
    still = _correlation(band, neighbour_band)
    start = none
    best = still
    for candidate in starts:
        if candidate.any():
            correlation = _correlation(band, pair.warped(candidate))
            if correlation > best + _BETTER_START:
                start = candidate
                best = correlation
    fine = _refined(pair, start, steps)
    if not start.any() and np.abs(fine).max() < _STILL:
        return none, still
    down, right = factors(pair.view.full_shape)
    whole = np.r_[np.round(fine[:2] * [right, down]) / [right, down], none[2:]]
    chosen = none
    best = still
    for candidate in (whole, np.r_[fine[:2], none[2:]], fine, start):
        if candidate.any():
            warped = _warp(neighbour_band, candidate, cv2.INTER_CUBIC)
            correlation = _correlation(band, warped)
            if correlation > best + _BETTER * (1 - best):
                chosen = candidate
                best = correlation
    return chosen, best


def _refined(pair: _Pair, affine: Float64s, steps: int) -> Float64s:
    """The motion after at most this many steps of Gauss and Newton.

    The damping pulls the edges of a frame towards its middle, as far as motions are usually shifts.
    """
    hessian = pair.view.hessian
    # Frames without any slope have no Hessian.
    least = 1e-6 * np.trace(hessian) + 1e-9
    for _ in range(steps):
        _, noise, projected = pair.residual(affine)
        damping = np.full(6, least)
        damping[2:] += noise / _AFFINE_USUAL**2
        damped = hessian.copy()
        damped.flat[::7] += damping
        step = np.linalg.solve(damped, projected + damping * affine)
        affine = affine - step
        if np.abs(step).max() < _SETTLED:
            break
    return affine


def _block_flow(pair: _Pair, affine: Float64s) -> Array | None:
    """What blocks move besides, where that is beyond doubt; (rows, columns, 2).

    Each block solves two normal equations for its shift to the right and down (Lucas and Kanade);
    `usual` pulls towards no shift, as far as shifts are usual.
    """
    along, down = pair.view.slopes
    residual, noise, _ = pair.residual(affine)
    usual = np.float32(noise / _BLOCK_USUAL**2)
    xx, yy, xy = pair.view.block_powers
    xx = xx + usual
    yy = yy + usual
    x = _block_sums(along * residual)
    y = _block_sums(down * residual)
    determinant: Array = xx * yy - xy * xy
    right = -(yy * x - xy * y) / determinant
    lower = -(xx * y - xy * x) / determinant
    # By how much the shift lowers the squared residual.
    is_sure = -(right * x + lower * y) > _BLOCK_SURE * noise
    if not is_sure.any():
        return None
    shifts = np.stack([right * is_sure, lower * is_sure], axis=-1)
    flow = cv2.GaussianBlur(shifts, (0, 0), _FLOW_SIGMA)
    largest = np.hypot(flow[..., 0], flow[..., 1]).max()
    return flow if largest > _LEAST_FLOW else None


def _block_sums(plane: Array) -> Array:
    """Sums over blocks of three cells, one a cell."""
    height, width = plane.shape
    columns = max(width // _CELL, 1)
    rows = max(height // _CELL, 1)
    area = height * width / (rows * columns)
    cells = cv2.resize(plane, (columns, rows), interpolation=cv2.INTER_AREA)
    return cv2.blur(cells, (3, 3), borderType=cv2.BORDER_REFLECT) * np.float32(9 * area)


def _residual(view: AlignmentView, warped: Array) -> _Residual:
    """What is left of the difference to a neighbour's band, seen from the frame.

    The spread of a static scene is that of the median magnitude; larger differences are clipped.
    """
    from . import kernels  # loads numba

    plane = (warped - view.band) * view.lit
    magnitudes = np.abs(plane.ravel()[::_SAMPLED][view.sampled])
    middle = len(magnitudes) // 2
    median = float(np.partition(magnitudes, middle)[middle]) if len(magnitudes) else 0.0
    sigma = max(_SIGMA_OF_MEDIAN * median, _LEAST_SIGMA)
    projected = kernels.clip_and_project(plane, *view.slopes, np.float32(_OUTLIER * sigma))
    return _Residual(plane, _GRAIN * sigma * sigma, projected)


def _correlation(band: Array, neighbour_band: Array) -> float:
    """Correlation of two bands where both show something; -1 where that is too little."""
    from . import kernels  # loads numba

    return float(kernels.correlation(band, neighbour_band))


def _phase_shift(view: AlignmentView, neighbour_view: AlignmentView) -> Float64s:
    """The shift with the highest phase correlation (Kuglin and Hines 1975), in whole pixels."""
    cross = cv2.mulSpectrums(neighbour_view.spectrum, view.spectrum, 0, conjB=True)
    magnitude = np.maximum(length_of(cross[..., 0], cross[..., 1]), 1e-12)
    cross = cross / cv2.pow(magnitude, _WHITENED)[..., None]
    peaks = cv2.dft(cross, flags=cv2.DFT_INVERSE | cv2.DFT_REAL_OUTPUT)
    down, right = (min(_FURTHEST, side // 3) for side in peaks.shape)
    near = np.roll(peaks, (down, right), (0, 1))[: 2 * down + 1, : 2 * right + 1]
    row, column = np.unravel_index(int(np.argmax(near)), near.shape)
    return np.array([column - right, row - down, 0, 0, 0, 0], np.float64)


def _warp(band: Array, affine: Float64s, interpolation: int = cv2.INTER_LINEAR) -> Array:
    """The band of a neighbour, moved to where the frame shows the same."""
    if not affine.any():
        return band
    matrix = _matrix(affine, band.shape)[:2]
    size = (band.shape[1], band.shape[0])
    return cv2.warpAffine(band, matrix, size, flags=interpolation | cv2.WARP_INVERSE_MAP)


def _matrix(affine: Float64s, shape: tuple[int, ...]) -> Float64s:
    """(3, 3) pixel -> where it lies in the other frame."""
    middle = _middle(shape)
    turn = _UNIT + affine[2:].reshape(2, 2) / (shape[1] / 2)
    matrix = np.zeros((3, 3))
    matrix[:2, :2] = turn
    matrix[:2, 2] = affine[:2] + middle - turn @ middle
    matrix[2, 2] = 1
    return matrix


def _affine(matrix: Float64s, shape: tuple[int, ...]) -> Float64s:
    """The reverse of `_matrix`."""
    middle = _middle(shape)
    turn = matrix[:2, :2]
    affine = np.empty(6)
    affine[:2] = matrix[:2, 2] - middle + turn @ middle
    affine[2:] = ((turn - _UNIT) * (shape[1] / 2)).ravel()
    return affine


def _middle(shape: tuple[int, ...]) -> Float64s:
    return np.array([(shape[1] - 1) / 2, (shape[0] - 1) / 2])


_UNIT = np.eye(2)
