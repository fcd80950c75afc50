"""Means over the frames around one in time: the classical denoisers of a recording."""

from __future__ import annotations

import cv2
import numpy as np

from ..metrics.measure import Grey

_BAND_PX = (1.0, 8.0)  # sigmas of the blurs whose difference is registered
_UNKNOWN = -1.0  # where a registered frame shows nothing


def mean_around(frames: Grey, number: int, reach: int) -> Grey:
    """(H, W): mean of the frames (N, H, W) up to `reach` before and after one."""
    return np.asarray(frames[max(0, number - reach) : number + reach + 1].mean(axis=0), np.float32)


def registered_mean(frames: Grey, number: int, reach: int) -> Grey:
    """Mean of the frames, each laid over the one at `number` first.

    The shift of whole frames is the peak of their phase correlation (Kuglin and Hines 1975),
    rounded to pixels, so that no frame is interpolated.
    """
    fixed = frames[number]
    total = fixed.astype(np.float64)
    count = np.ones_like(total)
    for index in range(max(0, number - reach), min(number + reach + 1, len(frames))):
        if index == number:
            continue
        laid = _moved(frames[index], shift_px(fixed, frames[index]))
        shown = laid != _UNKNOWN
        total += np.where(shown, laid, 0)
        count += shown
    return np.asarray(total / count, np.float32)


def shift_px(fixed: Grey, moved: Grey) -> tuple[int, int]:
    """How far right and down the scene of `fixed` lies in `moved`, whole pixels."""
    fade = cv2.createHanningWindow(fixed.shape[::-1], cv2.CV_32F)
    (right, down), _ = cv2.phaseCorrelate(_band(fixed), _band(moved), fade)
    return round(right), round(down)


def _band(image: Grey) -> Grey:
    """The image without fine grain and without brightness."""
    fine, broad = _BAND_PX
    image = np.asarray(image, np.float32)
    return np.asarray(
        cv2.GaussianBlur(image, (0, 0), fine) - cv2.GaussianBlur(image, (0, 0), broad)
    )


def _moved(image: Grey, shift_px: tuple[int, int]) -> Grey:
    """An image with its scene moved left and up by (right, down) pixels; -1 where it shows none."""
    right, down = shift_px
    matrix = np.array([[1, 0, right], [0, 1, down]], np.float64)
    flags = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
    size = image.shape[::-1]
    return np.asarray(
        cv2.warpAffine(
            np.asarray(image, np.float32),
            matrix,
            size,
            flags=flags,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=(_UNKNOWN,),
        )
    )
