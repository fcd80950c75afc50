"""Aligned frames become one: the static scene is averaged, and moving targets are kept.

What noise explains is measured in the window itself, by grey level (`noise_by_level`).

- Static scene: a neighbour counts at a pixel where it agrees with the median of all frames, in a
  small window and in a wide one.
- Moving object that a single frame shows: where the frame itself disagrees with the median, only
  neighbours that agree with the frame and not with the median count, mostly none.
- Moving target that only several frames show: where the deviations along a path are significant
  (`tracking`) and explain the frame, the mean along the path is added to the scene.  The target
  keeps its contrast, and its noise falls as that of the scene does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from ....factory.common.array_types import Array, Bools, Float32s
from .motion import blurred, everywhere, factors, grey_of, reduced
from .noise_level import at_level, noise_by_level, some_of, standardised
from .tracking import MAX_OFFSET, Tracks, find_tracks

# In reduced pixels, `motion.factors` times as large as those of the frames.
_SMALL_SIGMA_PX = 0.8  # Gaussian of the small window
_WIDE_SIDE_PX = 7  # side of the wide window
_MAX_DEVIATION = 3.0  # in the wide window: an object nearby must not fill it
_AGREEMENT_LIMIT = 3.3
"""Standard deviations up to which a frame agrees with the median, and a neighbour with a frame."""
_OWN_LIMIT = 2.4
"""The same for the frame itself: the median of many frames has little noise, and a faint object
that is missed is lost in their mean."""
_GATE_START = 2.2
_GATE_END = 4.2
"""Significance of a path from which on it counts, and from which on it counts in full."""
_EXPLAINED_LIMIT = 2.5  # standard deviations between a frame and the mean along its path
_OBVIOUS = 8.0
"""Standard deviations from which on a single frame shows an object; no path is needed then."""
_MIN_TRACKED_FRAMES = 3
_DARK = 0.02  # grey value below which there is nothing to learn from
_MEASURED_NEIGHBOURS = 2  # that the noise of a pixel is measured by


@dataclass(frozen=True, eq=False)
class Neighbour:
    """Another frame of the window, aligned with the frame that is denoised.

    offset: its frame number less that of the frame.  levels: (H, W) or (H, W, C) float32 in 0..1.
    visible: (H, W) float32, 1 where it shows what the frame shows, else 0.
    """

    offset: int
    levels: Array
    visible: Array
    small: Array | None = None


@dataclass(frozen=True, eq=False)
class FusedFrame:
    """A frame fused with its neighbours.

    image: (H, W) or (H, W, C) float32.
    frame_count: (H, W), effective number of frames averaged at each pixel, >= 1.
    static_share: (H, W) in 0..1; 0 where something moves.
    pixel_noise: (256,) noise of a pixel of a single frame, by level.
    difference_noise: (256,) noise of a difference of two frames in the small window, by level.
    deviation, wide_deviation: (h, w) reduced, the frame less the scene in the small and the wide
    window, in standard deviations of that difference by noise alone.
    evidence: (h, w) reduced, of the best path through a pixel, in standard deviations above the
    usual; see `tracking`.
    """

    image: Array
    frame_count: Array
    static_share: Array
    pixel_noise: Array
    difference_noise: Array
    deviation: Array
    wide_deviation: Array
    evidence: Array


@dataclass(frozen=True, eq=False)
class _Reduced:
    """What the reduced, slightly blurred frames of a window say; all planes are (h, w).

    frame, median: the frame itself, and the median of the window.
    neighbours: each of them, replaced by the frame where it is not visible.
    """

    frame: Array
    median: Array
    neighbours: list[Array]


@dataclass(frozen=True, eq=False)
class _Targets:
    """Moving targets; all planes are reduced, (h, w).

    evidence: significance of the path through a pixel, standard deviations above the usual.
    gate: 0..1, how far the path through a pixel counts.
    faint: frame offset -> 1 where the frame deviates by less than `_OBVIOUS`, else 0.
    """

    tracks: Tracks
    evidence: Array
    gate: Array
    faint: dict[int, Array]


def fuse(frame: Array, neighbours: Sequence[Neighbour]) -> FusedFrame:
    """Fuse a frame, (H, W) or (H, W, C) float32 in 0..1, with its neighbours."""
    from . import kernels  # loads numba

    grey = grey_of(frame)
    if not neighbours:
        ones = np.ones(grey.shape, np.float32)
        unknown = np.zeros(256, np.float32)
        nowhere = np.zeros_like(reduced(grey))
        return FusedFrame(frame, ones, ones, unknown, unknown, nowhere, nowhere, nowhere)
    small, visible = _reduce(grey, neighbours)
    measured = some_of(len(neighbours))
    scene_greys = [small.median * visible[index] for index in measured]
    pixel_noise = _pixel_noise(grey, neighbours)

    # Of the neighbours, then of the frame itself.
    planes = [*small.neighbours, small.frame]
    with_median = _Agreement(planes, small.median, measured, scene_greys, _OWN_LIMIT)
    with_frame = _Agreement(small.neighbours, small.frame, measured, scene_greys)
    agrees_with_median = with_median.planes[:-1]
    static = with_median.planes[-1]

    # Where the frame shows an object, a neighbour that agrees with the median shows the scene,
    # even if noise alone could explain its difference from the frame.
    weights = [
        _smooth(kernels.neighbour_weight(median_agreement, frame_agreement, static))
        for median_agreement, frame_agreement in zip(
            agrees_with_median, with_frame.planes, strict=True
        )
    ]
    image, frame_count = _weighted_mean(frame, np.ones_like(grey), neighbours, weights)
    static_share = enlarge(static, grey.shape)
    fused = FusedFrame(
        image=image,
        frame_count=frame_count,
        static_share=static_share,
        pixel_noise=pixel_noise,
        difference_noise=with_frame.noise,
        deviation=with_median.deviation,
        wide_deviation=with_median.wide_deviation,
        evidence=np.zeros_like(small.frame),
    )

    trackable = [neighbour for neighbour in neighbours if abs(neighbour.offset) <= MAX_OFFSET]
    if len(trackable) + 1 < _MIN_TRACKED_FRAMES:
        return fused
    targets = _find_targets(small, neighbours, with_median.sigma)
    fused = replace(fused, evidence=targets.evidence)
    if not targets.gate.any():
        return fused
    return _with_targets(fused, frame, neighbours, agrees_with_median, targets)


def shows_same(fused: FusedFrame, other: Array, visible: Array) -> Bools:
    """Where another frame, (H, W), shows the static scene that was fused.

    Excludes pixels where something moves in either frame: calibration would mistake the motion
    for noise.
    """
    small = blurred(reduced(fused.image), _SMALL_SIGMA_PX)
    deviation = np.abs(blurred(reduced(other), _SMALL_SIGMA_PX) - small)
    agrees = deviation / at_level(small, fused.difference_noise) < _AGREEMENT_LIMIT
    lit = small > _DARK
    height, width = fused.image.shape
    same = cv2.resize(
        (agrees & lit).astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST
    )
    return np.asarray((same > 0) & (visible > 0) & (fused.static_share > 0.5))


def _reduce(grey: Array, neighbours: Sequence[Neighbour]) -> tuple[_Reduced, list[Array]]:
    """The frames reduced and blurred, and where each neighbour is visible there, 0 or 1."""
    frame = _blurred_small(grey)
    visible: list[Array] = []
    planes = []
    for neighbour in neighbours:
        plane = neighbour.small
        if plane is None:
            plane = _blurred_small(grey_of(neighbour.levels))
        if neighbour.visible is everywhere(*grey.shape):
            visible.append(np.ones(frame.shape, np.uint8))
            planes.append(plane)
            continue
        fully_visible = (reduced(neighbour.visible) > 0.99).astype(np.uint8)
        mask = cv2.erode(fully_visible, np.ones((5, 5), np.uint8))
        visible.append(mask)
        planes.append(np.where(mask > 0, plane, frame))
    return _Reduced(frame, median([*planes, frame]), planes), visible


def _blurred_small(grey: Array) -> Array:
    """A frame, (H, W), reduced and blurred."""
    return blurred(reduced(grey), _SMALL_SIGMA_PX)


def _pixel_noise(grey: Array, neighbours: Sequence[Neighbour]) -> Array:
    """The noise of a pixel, from the differences of a frame and its neighbours; by level."""
    nearest = neighbours[:_MEASURED_NEIGHBOURS]
    return noise_by_level(
        [(grey_of(near.levels) - grey) * np.float32(np.sqrt(0.5)) for near in nearest],
        [grey * near.visible for near in nearest],
    )


def _find_targets(small: _Reduced, neighbours: Sequence[Neighbour], sigma: Array) -> _Targets:
    """Find the objects that move along paths through the window.

    sigma: (h, w) noise of a deviation from the median.
    """
    lit = small.median > _DARK
    offsets = [*(neighbour.offset for neighbour in neighbours), 0]
    deviations = {
        offset: (plane - small.median) / sigma * lit
        for offset, plane in zip(offsets, (*small.neighbours, small.frame), strict=True)
        if abs(offset) <= MAX_OFFSET
    }
    faint = {offset: _faint(deviation) for offset, deviation in deviations.items()}
    tracks = find_tracks({offset: deviations[offset] * faint[offset] for offset in deviations})
    score = standardised(np.abs(tracks.score), lit)
    significance = np.clip((score - _GATE_START) / (_GATE_END - _GATE_START), 0, 1)
    significant = cv2.dilate(significance.astype(np.float32), np.ones((3, 3), np.uint8))
    gate = significant * _explained(deviations[0], tracks.mean)
    return _Targets(tracks, score, cv2.blur(gate, (3, 3)), faint)


class _Agreement:
    """How far frames agree in a small window and in a wide one, up to a limit in deviations.

    planes: 1 up to the limit in both windows, then falling to 0; (h, w) for each frame.
    noise: of a difference in the small window, by grey level.  sigma: (h, w) the same.
    deviation, wide_deviation: (h, w) of the last plane, in standard deviations by noise.
    """

    def __init__(
        self,
        planes: Sequence[Array],
        grey: Array,
        measured: Sequence[int],
        scene_greys: Sequence[Array],
        last_limit: float = _AGREEMENT_LIMIT,
    ) -> None:
        """planes: (h, w) each, that are compared with the plane `grey`.

        measured: indices of those that noise is measured on.  scene_greys: (h, w) grey values of
        the scene there; a pixel of 0 is left out.  last_limit: of the last plane.
        """
        from . import kernels  # loads numba

        self.noise = noise_by_level([planes[index] - grey for index in measured], scene_greys)
        self.sigma = at_level(grey, self.noise)
        most = np.float32(_MAX_DEVIATION)
        both = [kernels.deviations(plane, grey, self.sigma, most) for plane in planes]
        wide = [cv2.blur(clipped, (_WIDE_SIDE_PX, _WIDE_SIDE_PX)) for _, clipped in both]
        wide_noise = noise_by_level([wide[index] for index in measured], scene_greys)
        wide_sigma = at_level(grey, wide_noise)
        limits = [_AGREEMENT_LIMIT] * (len(planes) - 1) + [last_limit]
        exponents = [
            kernels.excess_exponent(deviation, wide_mean, wide_sigma, np.float32(limit))
            for (deviation, _), wide_mean, limit in zip(both, wide, limits, strict=True)
        ]
        self.planes: list[Float32s] = [
            np.asarray(cv2.exp(exponent), np.float32) for exponent in exponents
        ]
        self.deviation: Array = both[-1][0]
        self.wide_deviation: Array = wide[-1] / wide_sigma


def median(planes: Sequence[Array]) -> Array:
    """Median of planes, pixel by pixel, by a network of minima and maxima."""
    values = list(planes)
    count = len(values)
    for sorted_count in range(count // 2 + 1):
        for index in range(count - 1 - sorted_count):
            lesser = np.minimum(values[index], values[index + 1])
            values[index + 1] = np.maximum(values[index], values[index + 1])
            values[index] = lesser
    if count % 2:
        return values[count // 2]
    return (values[count // 2] + values[count // 2 - 1]) / np.float32(2)


def _smooth(weight: Array) -> Array:
    """Erode and blur a weight, so that it is 0 already beside a pixel that disagrees."""
    return cv2.blur(cv2.erode(weight, np.ones((3, 3), np.uint8)), (3, 3))


def _weighted_mean(
    frame: Array, frame_weight: Array, neighbours: Sequence[Neighbour], weights: Sequence[Array]
) -> tuple[Array, Array]:
    """Mean of a frame and its neighbours, and (H, W) how many frames count in it effectively.

    frame_weight: (H, W).  weights: (h, w) reduced, of each neighbour.
    """
    if frame.ndim == 3:
        means = []
        for channel in range(frame.shape[2]):
            of_channel = _in_channel(neighbours, channel)
            mean, frame_count = _weighted_mean(
                _channel(frame, channel), frame_weight, of_channel, weights
            )
            means.append(mean)
        return np.stack(means, axis=-1), frame_count

    from . import kernels  # loads numba

    total = frame * frame_weight
    count = frame_weight.copy()
    squares = frame_weight * frame_weight
    for neighbour, weight in zip(neighbours, weights, strict=True):
        part = enlarge(weight, frame.shape)
        kernels.add_weighted(total, count, squares, neighbour.levels, part, neighbour.visible)
    mean, frame_count = kernels.mean_and_count(total, count, squares)
    return mean, frame_count


def _with_targets(
    fused: FusedFrame,
    frame: Array,
    neighbours: Sequence[Neighbour],
    agrees_with_median: Sequence[Array],
    targets: _Targets,
) -> FusedFrame:
    """A fused frame that shows each moving target as its mean along its path.

    agrees_with_median: (h, w) reduced, 1 where a neighbour shows the static scene.
    """
    weights = [_smooth(agreement) for agreement in agrees_with_median]
    scene, scene_count = _weighted_mean(frame, fused.static_share, neighbours, weights)
    # Where too few frames show the scene there is none to add a target to.
    gate = enlarge(targets.gate, frame.shape) * (scene_count > 1)
    target = _mean_target(frame, scene, gate, neighbours, targets)
    image = fused.image + _like(gate, fused.image) * (scene + target - fused.image)
    static_share = fused.static_share * (1 - gate)
    return replace(fused, image=np.clip(image, 0, 1), static_share=static_share)


def _explained(deviation: Array, path_mean: Array) -> Array:
    """1 where the mean along a path explains the frame's deviation, else down to 0; (h, w).

    It does not at a bright object on another path, which the frame shows itself.
    """
    excess = np.abs(deviation - path_mean) - np.float32(_EXPLAINED_LIMIT)
    explained = cv2.exp(-np.square(np.maximum(excess, 0)))
    return cv2.erode(explained, np.ones((3, 3), np.uint8))


def _faint(deviation: Array) -> Array:
    """1 where a deviation, (h, w), and all beside it are less than `_OBVIOUS`, else 0."""
    faint = (np.abs(deviation) < _OBVIOUS).astype(np.float32)
    return cv2.erode(faint, np.ones((5, 5), np.uint8))


def _mean_target(
    frame: Array, scene: Array, gate: Array, neighbours: Sequence[Neighbour], targets: _Targets
) -> Array:
    """Mean deviation from the scene along the path through each pixel, as the scene in shape.

    gate: (H, W); where it is 0 nothing is computed, and the result is of no use.
    """
    if frame.ndim == 3:
        planes = []
        for channel in range(frame.shape[2]):
            of_channel = _in_channel(neighbours, channel)
            of_frame = _channel(frame, channel), _channel(scene, channel)
            planes.append(_mean_target(*of_frame, gate, of_channel, targets))
        return np.stack(planes, axis=-1)

    from . import kernels  # loads numba

    total = frame - scene
    near = [neighbour for neighbour in neighbours if abs(neighbour.offset) <= MAX_OFFSET]
    for neighbour in near:
        # Not interpolated: the mean of two velocities is the path of no target.
        kernels.add_along_paths(
            total,
            gate,
            neighbour.levels,
            scene,
            neighbour.visible,
            targets.faint[neighbour.offset],
            targets.tracks.velocity_px,
            neighbour.offset,
            *factors(frame.shape),
        )
    return total / np.float32(len(near) + 1)


def _in_channel(neighbours: Sequence[Neighbour], index: int) -> list[Neighbour]:
    """Neighbours with the levels of one channel of their colour."""
    return [
        replace(neighbour, levels=_channel(neighbour.levels, index)) for neighbour in neighbours
    ]


def _channel(levels: Array, index: int) -> Array:
    """(H, W), one channel of a frame in colour."""
    return np.ascontiguousarray(levels[..., index])


def enlarge(plane: Array, shape: tuple[int, ...], interpolation: int = cv2.INTER_LINEAR) -> Array:
    """A reduced plane, (h, w) or (h, w, C), at the size of the frames, (H, W)."""
    height, width = shape[:2]
    down, right = factors(shape[:2])
    size = width // right * right, height // down * down
    enlarged = cv2.resize(plane, size, interpolation=interpolation)
    if enlarged.shape[:2] == (height, width):
        return enlarged
    margin = [(0, height % down), (0, width % right), (0, 0)]
    return np.pad(enlarged, margin[: enlarged.ndim], mode="edge")


def _like(plane: Array, frame: Array) -> Array:
    """A plane, (H, W), that multiplies a frame of one plane or of several channels."""
    return plane if frame.ndim == 2 else plane[..., None]
