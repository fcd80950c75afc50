"""How bright frames are: a gain for dark recordings, and how unlike two frames are.

Frames are compared by thumbnails, in which grain averages out and the scene does not.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from ....factory.common.array_types import Array

UNLIKE = 0.05
"""Relative difference of thumbnails up to which frames are alike; of the recordings that ship,
successive frames have .013 at most, and frames of a gain of 1.2 have .09."""
_THUMBNAIL_PX = 24  # side
_PART_PX = 8  # side of an image's part that a pixel of a thumbnail stands for, at least
_DARK = 0.01  # grey value: darker parts show nothing
_LEAST_PARTS = 10

_BRIGHT = 0.125  # grey value from which on the brightest echoes of an image are bright enough
_OUTLIERS = 0.001  # part of the lit pixels that are brighter than what a scale goes by
_LEAST_SHOWN = 1 / 12
_WANTED = 0.5
_MOST_GAIN = 2.0**14


class Likeness(NamedTuple):
    """How unlike two frames of one scene are.

    gain: what the first is multiplied by to be as bright as the second, the median ratio of small
    parts.  difference: median relative difference that is left with it, 0 to 1.
    """

    gain: float
    difference: float


def gain_of(grey: Array, before: float) -> float:
    """Power of two by which an image is multiplied, so that its echoes fill the grey scale.

    grey: (H, W) in 0..1.  before: the gain of the image before, which is kept while it suits.
    Samples of 10 bits in files of 16 fill a 64th of the scale, where noise and rounding cannot be
    told apart.  A few brighter pixels do not count: letters, or a broken receiver.
    """
    sampled = grey[::2, ::2]
    lit_count = np.count_nonzero(sampled)
    if not lit_count:
        return before
    outlier_count = int(_OUTLIERS * lit_count)
    if before == 1 and np.count_nonzero(sampled > _BRIGHT) > outlier_count:
        return 1.0
    values = sampled[sampled > 0]
    place = len(values) - 1 - outlier_count
    bright = float(np.partition(values, place)[place])
    if before != 1 and _LEAST_SHOWN < bright * before <= 1:
        return before
    if bright > _BRIGHT:
        return 1.0
    return float(min(2.0 ** np.floor(np.log2(_WANTED / bright)), _MOST_GAIN))


def likeness_of(thumbnail: Array, other_thumbnail: Array) -> Likeness:
    """How unlike two thumbnails are in brightness and besides."""
    lit = np.minimum(thumbnail, other_thumbnail) > _DARK
    if np.count_nonzero(lit) < _LEAST_PARTS:
        return Likeness(1.0, difference(thumbnail, other_thumbnail))
    gain = float(np.median(other_thumbnail[lit] / thumbnail[lit]))
    return Likeness(gain, difference(thumbnail * np.float32(gain), other_thumbnail))


def thumbnail_of(grey: Array, full_shape: tuple[int, ...] | None = None) -> Array:
    """Means of the parts of an image, (H, W).

    full_shape: of the image that it was reduced from; None: of none.
    """
    sides = full_shape or grey.shape
    height, width = (min(_THUMBNAIL_PX, max(side // _PART_PX, 1)) for side in sides[:2])
    return np.asarray(cv2.resize(grey, (width, height), interpolation=cv2.INTER_AREA), np.float32)


def difference(thumbnail: Array, other_thumbnail: Array) -> float:
    """Median relative difference of two thumbnails where one of them is lit, 0 to 1."""
    lit = np.maximum(thumbnail, other_thumbnail) > _DARK
    if np.count_nonzero(lit) < _LEAST_PARTS:
        return 0.0
    apart = np.abs(thumbnail - other_thumbnail)[lit]
    return float(np.median(apart / (thumbnail + other_thumbnail)[lit]))
