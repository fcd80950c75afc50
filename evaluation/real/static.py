"""A nearly noise-free truth for real pictures: frames of a scene that stands still.

The mean of the *other* frames is the reference of each (leave one out).  It removes what changes
in time (receiver noise, decorrelated speckle); what stands still stays in the reference, so a
method that takes away standing speckle, too, is capped, and one that keeps it is not punished.
Frames are registered below a pixel first, and those that moved too far are left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from simnfnd.evaluation.metrics.fidelity import finite_psnr, psnr, ssim
from simnfnd.evaluation.metrics.levels import fit_levels

Gray = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]

_SIDE = 96  # of the small pictures that are compared with each other, pixels
_BROAD = (
    8.0  # what is wider than this counts as brightness, not as scene; pixels of a small picture
)
_ECC_STEPS = cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 60, 1e-5


@dataclass(frozen=True, eq=False)
class StaticGroup:
    """Frames of one scene that stands still.

    numbers: of the frames among the pictures that were searched, in order.
    shifts_px: (N, 2) right and down, by which the scene lies away from where the first frame has
    it.
    """

    numbers: tuple[int, ...]
    shifts_px: npt.NDArray[np.float64]


@dataclass(frozen=True)
class Score:
    """One picture against its reference, after one gain and offset: PSNR in dB, and SSIM."""

    psnr_db: float
    ssim: float


def find_groups(
    pictures: Sequence[Gray],
    sectors: Sequence[Mask],
    *,
    least: int = 6,
    alike: float = 0.75,
    furthest_px: float = 4.0,
) -> list[StaticGroup]:
    """Groups of at least `least` frames that show one scene, in any order among the others.

    pictures: (H, W) float32 in 0..1.  sectors: (H, W) bool, what each picture shows of the fan.
    alike: correlation of the small, smoothed pictures above which two frames may show one scene.
    furthest_px: how far the scene of a group may move.
    """
    small = [_small(picture, sector) for picture, sector in zip(pictures, sectors, strict=True)]
    sizes = [picture.shape for picture in pictures]
    left = list(range(len(pictures)))
    groups = []
    while len(left) >= least:
        # The frame with most frames like it begins; what it does not take is tried again.
        near = np.stack([small[i] for i in left])
        similar = near @ near.T > alike
        first = int(np.argmax(similar.sum(axis=1)))
        numbers = [left[first]] + [
            one
            for place, one in enumerate(left)
            if place != first and similar[first, place] and sizes[one] == sizes[left[first]]
        ]
        if len(numbers) < least:
            break
        frames = [pictures[i] for i in numbers]
        group = aligned(frames, sectors[left[first]], furthest_px=furthest_px)
        kept = tuple(numbers[i] for i in group.numbers)
        if len(kept) >= least:
            groups.append(StaticGroup(kept, group.shifts_px))
            left = [one for one in left if one not in kept]
        else:
            left.remove(numbers[0])
    return groups


def aligned(frames: Sequence[Gray], sector: Mask, *, furthest_px: float = 4.0) -> StaticGroup:
    """The frames that lie within `furthest_px` of the first, with their shifts below a pixel."""
    numbers, shifts = [0], [(0.0, 0.0)]
    for number, frame in enumerate(frames[1:], start=1):
        shift = shift_px(frames[0], frame, sector)
        if shift is not None and np.hypot(*shift) <= furthest_px:
            numbers.append(number)
            shifts.append(shift)
    return StaticGroup(tuple(numbers), np.array(shifts))


def shift_px(fixed: Gray, moved: Gray, sector: Mask) -> tuple[float, float] | None:
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


def references(frames: Sequence[Gray], group: StaticGroup) -> list[Gray]:
    """For each frame of the group the mean of the others, laid over it; (H, W) each.

    frames: those of the group, in its order.
    """
    found = []
    for one, own in enumerate(group.shifts_px):
        total = np.zeros(frames[0].shape, np.float64)
        for other, shift in enumerate(group.shifts_px):
            if other != one:
                total += _shifted(frames[other], shift - own)
        found.append((total / (len(group.numbers) - 1)).astype(np.float32))
    return found


def moving(frames: Sequence[Gray], sector: Mask, *, times: float = 4.0) -> Mask:
    """(H, W) bool: where something moved through the frames, with a margin.

    There the smoothed frames spread in time `times` as much as in the median of the sector.
    """
    smooth = np.stack([cv2.GaussianBlur(frame, (0, 0), 3.0) for frame in frames])
    spread = smooth.std(axis=0)
    usual = float(np.median(spread[sector])) if sector.any() else 0.0
    found = (spread > times * usual) & sector
    return cv2.dilate(found.astype(np.uint8), np.ones((15, 15), np.uint8)).astype(bool)


def score(picture: Gray, reference: Gray, where: Mask) -> Score:
    """How near a picture is to its reference where `where`, after one gain and offset."""
    levels = fit_levels([(picture[where], reference[where])])
    fitted = levels(picture)
    return Score(
        finite_psnr(psnr(reference, fitted, data_range=1.0, mask=where)),
        ssim(reference, fitted, data_range=1.0, mask=where),
    )


def _small(picture: Gray, sector: Mask) -> npt.NDArray[np.float64]:
    """(_SIDE * _SIDE,) of unit length: the scene without brightness, speckle and border."""
    weight = cv2.resize(sector.astype(np.float32), (_SIDE, _SIDE), interpolation=cv2.INTER_AREA)
    small = cv2.resize(picture * sector, (_SIDE, _SIDE), interpolation=cv2.INTER_AREA)
    total = np.asarray(cv2.GaussianBlur(small, (0, 0), _BROAD))
    wide = total / np.maximum(cv2.GaussianBlur(weight, (0, 0), _BROAD), 1e-3)
    scene = np.where(weight > 0.99, cv2.GaussianBlur(small, (0, 0), 1.0) - wide, 0.0).ravel()
    scene -= scene.mean()
    return np.asarray(scene / max(float(np.linalg.norm(scene)), 1e-12), np.float64)


def _shifted(frame: Gray, shift_px: npt.NDArray[np.float64]) -> Gray:
    """The frame with its scene moved left and up by (right, down) pixels, cubic."""
    matrix = np.array([[1, 0, shift_px[0]], [0, 1, shift_px[1]]], np.float64)
    shifted = cv2.warpAffine(
        frame,
        matrix,
        frame.shape[::-1],
        flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REFLECT,
    )
    return np.asarray(shifted, np.float32)
