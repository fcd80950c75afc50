"""Pictures whose metrics were worked out elsewhere."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]


def waves(height: int, width: int) -> tuple[Array, Array]:
    """The recipe of the golden images: whole gray values from a formula, no random numbers."""
    y, x = np.mgrid[0:height, 0:width].astype(float)
    clean = 127.5 + 80 * np.sin(x / 5) * np.cos(y / 7) + 40 * ((x // 8 + y // 8) % 2)
    clean = np.clip(np.rint(clean), 0, 255)
    noisy = 0.6 * clean + 20 + 90 * np.sin(12.9898 * x + 78.233 * y)
    return clean.astype(np.uint8), np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
