"""A nearly noise-free truth for real images: frames of a static scene.

The mean of the *other* frames is the reference of each (leave one out).  It removes what changes
in time (receiver noise, decorrelated speckle); what is static stays in the reference, so a
method that takes away standing speckle, too, is capped, and one that keeps it is not punished.
Frames are registered below a pixel first, and those that moved too far are left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from ...factory.common.array_types import Bools, Float32s, Float64s

_SIDE = 96  # of the small images that are compared with each other, pixels
_BROAD = 8.0  # pixels of a small image: what is wider counts as brightness, not as scene
_LEAST_SPREAD = 0.1 / 255  # less is rounding, where there is hardly any noise
_ECC_STEPS = cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 60, 1e-5


@dataclass(frozen=True, eq=False)
class StaticGroup:
    """Frames of one static scene, by their numbers among the images, in order."""

    numbers: tuple[int, ...]
    shifts_px: Float64s
    """(N, 2) right and down, by which the scene lies away from where the first frame has it."""


def find_groups(
    images: Sequence[Float32s],
    sectors: Sequence[Bools],
    *,
    least: int = 6,
    alike: float = 0.75,
    furthest_px: float = 4.0,
) -> list[StaticGroup]:
    """Groups of at least `least` frames that show one scene, in any order among the others.

    images: (H, W) float32 in 0..1.  sectors: (H, W) bool, what each image shows of the fan.
    alike: correlation of the small, smoothed images above which two frames may show one scene.
    furthest_px: how far the scene of a group may move.
    """
    # One at a time: the images may be read from files only here.
    near = np.array([_small(*both) for both in zip(images, sectors, strict=True)])
    likeness = near @ near.T
    left = list(range(len(near)))
    groups = []
    while len(left) >= least:
        # The frame with most frames like it begins, of equal ones that in their middle; what it
        # does not take is tried again.
        among = likeness[np.ix_(left, left)]
        similar = among > alike
        first = int(np.argmax(np.where(similar, among, 0.0).sum(axis=1)))
        numbers = [left[first]] + [left[i] for i in np.flatnonzero(similar[first]) if i != first]
        if len(numbers) < least:
            break
        frames = [images[i] for i in numbers]
        group = aligned(frames, sectors[left[first]], furthest_px=furthest_px)
        members = tuple(numbers[i] for i in group.numbers)
        if len(members) >= least:
            groups.append(StaticGroup(members, group.shifts_px))
            left = [number for number in left if number not in members]
        else:
            left.remove(numbers[0])
    return groups


def aligned(frames: Sequence[Float32s], sector: Bools, *, furthest_px: float = 4.0) -> StaticGroup:
    """The frames that lie within `furthest_px` of the first, with their shifts below a pixel."""
    shift_of_frame = {0: (0.0, 0.0)}
    for number, frame in enumerate(frames[1:], start=1):
        shift = shift_px(frames[0], frame, sector) if frame.shape == frames[0].shape else None
        if shift is not None and np.hypot(*shift) <= furthest_px:
            shift_of_frame[number] = shift
    return StaticGroup(tuple(shift_of_frame), np.array(list(shift_of_frame.values())))


def shift_px(fixed: Float32s, moved: Float32s, sector: Bools) -> tuple[float, float] | None:
    """How far right and down the scene of `fixed` lies in `moved`; None when nothing fits.

    Maximises the enhanced correlation coefficient inside the sector (Evangelidis and Psarakis
    2008, OpenCV).
    """
    inner = cv2.erode(sector.astype(np.uint8), np.ones((9, 9), np.uint8))
    start = np.eye(2, 3, dtype=np.float32)
    try:
        _, matrix = cv2.findTransformECC(
            fixed, moved, start, cv2.MOTION_TRANSLATION, _ECC_STEPS, inner, 9
        )
    except cv2.error:  # it did not converge
        return None
    return float(matrix[0, 2]), float(matrix[1, 2])


def laid_over(
    frames: Sequence[Float32s], group: StaticGroup, reference: int, numbers: Sequence[int]
) -> list[Float32s]:
    """Return frames shifted so that their scene lies where the reference frame has it, (H, W) each.

    frames: those of the group, in its order.  reference, numbers: indices into them; the reference
    frame itself is returned as it is.
    """
    own = group.shifts_px[reference]
    return [
        frames[number]
        if number == reference
        else shifted(frames[number], group.shifts_px[number] - own)
        for number in numbers
    ]


def moving(frames: Sequence[Float32s], sector: Bools, *, times: float = 4.0) -> Bools:
    """(H, W) bool: where something moved through the frames, with a margin.

    There the smoothed frames spread in time `times` as much as in the median of the sector.
    """
    smooth = np.stack([cv2.GaussianBlur(frame, (0, 0), 3.0) for frame in frames])
    spread = smooth.std(axis=0)
    usual = float(np.median(spread[sector])) if sector.any() else 0.0
    is_moving = (spread > times * max(usual, _LEAST_SPREAD)) & sector
    return cv2.dilate(is_moving.astype(np.uint8), np.ones((15, 15), np.uint8)).astype(bool)


def shifted(frame: Float32s, shift_px: Float64s) -> Float32s:
    """The frame, (H, W) or (H, W, C), with its scene moved left and up by (right, down) pixels.

    Cubic, the border reflected.
    """
    matrix = np.array([[1, 0, shift_px[0]], [0, 1, shift_px[1]]], np.float64)
    interpolation = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    border = cv2.BORDER_REFLECT
    moved = cv2.warpAffine(
        frame, matrix, frame.shape[1::-1], flags=interpolation, borderMode=border
    )
    return np.asarray(moved, np.float32)


def _small(image: Float32s, sector: Bools) -> Float64s:
    """(_SIDE * _SIDE,) of unit length: the scene without brightness, speckle and border."""
    weight = cv2.resize(sector.astype(np.float32), (_SIDE, _SIDE), interpolation=cv2.INTER_AREA)
    small = cv2.resize(image * sector, (_SIDE, _SIDE), interpolation=cv2.INTER_AREA)
    total = np.asarray(cv2.GaussianBlur(small, (0, 0), _BROAD))
    wide = total / np.maximum(cv2.GaussianBlur(weight, (0, 0), _BROAD), 1e-3)
    scene = np.where(weight > 0.99, cv2.GaussianBlur(small, (0, 0), 1.0) - wide, 0.0).ravel()
    scene -= scene.mean()
    return np.asarray(scene / max(float(np.linalg.norm(scene)), 1e-12), np.float64)
