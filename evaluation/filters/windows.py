"""Means over the frames around one in time: the classical denoisers of a recording."""

from __future__ import annotations

import cv2
import numpy as np
from scipy import ndimage

from ..metrics.measure import Grey

_BAND_PX = (1.0, 8.0)  # sigmas of the blurs whose difference is registered


def mean_around(frames: Grey, number: int, reach: int) -> Grey:
    """(H, W): mean of the frames (N, H, W) up to `reach` before and after one."""
    return np.asarray(frames[max(0, number - reach) : number + reach + 1].mean(axis=0), np.float32)


def registered_mean(frames: Grey, number: int, reach: int) -> Grey:
    """Mean of the frames, each laid over the one at `number` first.

    The shift of whole frames is the peak of their phase correlation (Kuglin and Hines 1975),
    rounded to pixels, so that no frame is interpolated.
    """
    fixed = frames[number]
    laid = [
        ndimage.shift(frame, np.negative(shift_px(fixed, frame))[::-1], order=0, cval=np.nan)
        for frame in frames[max(0, number - reach) : number + reach + 1]
    ]
    return np.asarray(np.nanmean(laid, axis=0, dtype=np.float64), np.float32)


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
