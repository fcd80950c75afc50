"""Under what somebody drew over a picture: the level of what is around it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Levels = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]


def means_around(levels: Levels, known: Mask, side_px: int) -> tuple[Levels, Mask]:
    """The mean of what is known in the square around each pixel, and whether any of it is.

    levels: (H, W).
    """
    import cv2  # an extra, as are pictures

    size = (side_px, side_px)
    there = cv2.blur(known.astype(np.float32), size)
    means = cv2.blur(levels * known, size) / np.maximum(there, np.float32(1e-6))
    return np.asarray(means), there > 0
