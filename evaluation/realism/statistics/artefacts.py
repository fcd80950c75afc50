"""What lies along whole beams and whole range rows, and how bright and dark the picture gets."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Gray = npt.NDArray[np.float32]

# One grey step of 8 bits: where a level in dB is needed, black counts as this.
_STEP = 1 / 255


def spoke_index(polar: Gray) -> float:
    """Variance of the beams' means over the variance of the picture; NaN when all is equal."""
    return _index(polar, 0)


def arc_index(polar: Gray) -> float:
    """Variance of the range rows' means over the variance of the picture; NaN when all is equal."""
    return _index(polar, 1)


def _index(polar: Gray, axis: int) -> float:
    values = polar.astype(np.float64)
    total = float(values.var())
    return float(values.mean(axis=axis).var()) / total if total > 1e-12 else float("nan")


def range_slope_db(polar: Gray) -> float:
    """Slope of the level along range: dB from the near to the far end of the window.

    Least squares on 20 log10 of the mean grey value of each range row.  For dB/m divide by the
    length of the window.
    """
    level_db = 20 * np.log10(np.maximum(polar.mean(axis=1, dtype=np.float64), _STEP))
    position = (np.arange(len(level_db)) + 0.5) / len(level_db)
    return float(np.polyfit(position, level_db, 1)[0])


def contrasts_db(polar: Gray) -> tuple[float, float]:
    """Highlight over background and background over shadow, dB.

    Of means of 5x5 cells, so that speckle counts for less: the 99.5th percentile over the median,
    and the median over the 1st percentile.
    """
    import cv2

    low, middle, high = np.percentile(cv2.blur(polar, (5, 5)), [1, 50, 99.5])
    background = max(float(middle), _STEP)
    return (
        20 * float(np.log10(max(float(high), _STEP) / background)),
        20 * float(np.log10(background / max(float(low), _STEP))),
    )
