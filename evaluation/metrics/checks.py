"""What may be measured: the checks that every metric makes before it counts anything."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from ...factory.errors import FactoryError

Image = npt.NDArray[Any]
Mask = npt.NDArray[np.bool_]


class MetricError(FactoryError, ValueError):
    """The images cannot be compared: other shapes, NaN, too small, values beyond the data range."""


def checked_pair(
    reference: Image, image: Image, data_range: float, *, smallest: int
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Both images as float64, or MetricError that says why they cannot be compared."""
    if not (math.isfinite(data_range) and data_range > 0):
        raise MetricError(f"data_range must be a positive number, got {data_range}")
    reference, image = np.asarray(reference), np.asarray(image)
    if reference.shape != image.shape:
        raise MetricError(f"images differ in shape: {reference.shape} against {image.shape}")
    if reference.ndim != 2:
        raise MetricError(f"expected a gray image (H, W), got shape {reference.shape}")
    if min(reference.shape) < smallest:
        height, width = reference.shape
        raise MetricError(f"image of {height}x{width} is too small; at least {smallest} a side")
    pair = []
    for name, array in (("reference", reference), ("image", image)):
        values = array.astype(np.float64)
        if not np.isfinite(values).all():
            raise MetricError(f"{name} has NaN or infinite pixels")
        low, high = float(values.min()), float(values.max())
        # A denoiser may overshoot a little; a range that is off by a factor is a mistake.
        if high > 1.5 * data_range or low < -0.5 * data_range:
            raise MetricError(
                f"{name} has values {low:g}..{high:g}, which do not fit data_range {data_range:g}"
            )
        if array.dtype.kind in "ui" and data_range < 2:
            raise MetricError(f"{name} is {array.dtype} but data_range is {data_range:g}")
        pair.append(values)
    floats = reference.dtype.kind == "f" and image.dtype.kind == "f"
    if floats and data_range >= 100 and 0 < max(pair[0].max(), pair[1].max()) <= 1:
        raise MetricError(f"images have values 0..1 but data_range is {data_range:g}")
    return pair[0], pair[1]


def checked_mask(mask: Mask, image: npt.NDArray[np.generic]) -> Mask:
    """The mask as bool, or MetricError when it has another shape or no pixel."""
    mask = np.asarray(mask, dtype=bool)
    if mask.shape != image.shape:
        raise MetricError(f"mask is {mask.shape} but the image is {image.shape}")
    if not mask.any():
        raise MetricError("mask is empty; nothing to measure")
    return mask
