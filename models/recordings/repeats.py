"""Frames that are copies of the one before: a sonar of 8 Hz in a video of 24 Hz.

Copies have the noise of the frame that they repeat, so a mean over them is no cleaner.  A codec
stores copies that differ a little, by far less than two pings do.
"""

from __future__ import annotations

import hashlib
from collections import deque
from collections.abc import Iterable

import cv2
import numpy as np

from ...factory.common.array_types import Bools, Float32s

_WINDOW_PX = 5  # side of the mean that grain is measured against
_DARK = 0.02  # grey value: what is darker has no grain
_LEAST_PIXELS = 500
_MOST_CHANGED = 0.05
"""Part of the grain's power that a copy changes at most: codecs .00 to .03, pings .18 to .8."""
_SURELY_COPIED = 0.005  # so little is no ping's noise
_OF_OTHERS = 0.3  # part of what other frames of the recording change
_CLIPPED = 3.0  # standard deviations of grain: a clock beside the fan counts no more
_REMEMBERED = 64


class RepeatFinder:
    """Tells copies from new frames, one frame after the other."""

    def __init__(self) -> None:
        self._original: Float32s | None = None
        self._changes: deque[float] = deque(maxlen=_REMEMBERED)

    def is_repeat(self, grey: Float32s) -> bool:
        """Whether a frame, (H, W) in 0..1, repeats the last one that did not."""
        original = self._original
        if original is None or original.shape != grey.shape:
            self._original = grey
            return False
        changed = changed_grain(original, grey)
        self._changes.append(changed)
        if changed <= most_change_of_copies(self._changes):
            return True
        self._original = grey
        return False


def most_change_of_copies(changes: Iterable[float]) -> float:
    """Most change that a copy may show; it is smaller in recordings that change little.

    changes: of the last frames, each from the one that it may copy.
    """
    largest = sorted(changes)[-2:]
    usual = _OF_OTHERS * largest[0] if len(largest) == 2 else _MOST_CHANGED
    return min(max(usual, _SURELY_COPIED), _MOST_CHANGED)


def changed_grain(frame: Float32s, reference: Float32s) -> float:
    """Part of two frames' grain, by its power, in which they differ.

    0: one is a copy of the other; 1: their noise is independent, but for what belongs to the scene.
    """
    if np.array_equal(frame, reference):
        return 0.0
    lit = (frame > _DARK) | (reference > _DARK)
    if np.count_nonzero(lit) < _LEAST_PIXELS:
        return 1.0
    power = _mean_square(_grain(frame), lit) + _mean_square(_grain(reference), lit)
    if power <= 0:
        return 1.0
    limit = np.float32(_CLIPPED * np.sqrt(power / 2))
    difference = np.clip(_grain(frame - reference), -limit, limit)
    return _mean_square(difference, lit) / power


class CopyFinder:
    """Tells frames whose noise an earlier frame has: copies of the one before, and exact copies."""

    def __init__(self) -> None:
        self._repeats = RepeatFinder()
        self._digests: set[bytes] = set()

    def is_copy(self, grey: Float32s) -> bool:
        """Whether a frame, (H, W) in 0..1, is a copy of one that was asked for before."""
        digest = hashlib.sha256(np.ascontiguousarray(grey).tobytes()).digest()
        is_copy = self._repeats.is_repeat(grey) or digest in self._digests
        self._digests.add(digest)
        return is_copy


def _mean_square(plane: Float32s, lit: Bools) -> float:
    """Mean square of the lit pixels, summed in 64 bits."""
    return cv2.norm(plane, cv2.NORM_L2SQR, lit.view(np.uint8)) / np.count_nonzero(lit)


def _grain(plane: Float32s) -> Float32s:
    return np.asarray(plane - cv2.blur(plane, (_WINDOW_PX, _WINDOW_PX)), np.float32)
