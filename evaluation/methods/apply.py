"""One method on one picture."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..data.pairs import Place, geometry_of
from ..filters import REGISTRY
from ..filters.base import Gray
from .method import Method
from .networks import network

if TYPE_CHECKING:
    from ...factory.sonar.geometry import FanGeometry


def denoised(
    method: Method,
    image: Gray,
    device: str,
    place: Place | None,
    geometry: FanGeometry | None = None,
) -> Gray:
    """The method's picture without levels, (H, W) in 0..1; raises whatever the method raises.

    place: where the image is, None for one that is in no dataset.  geometry: where range and
    bearing are, for those that can use it; by default what the dataset says.
    """
    if method.weights is None:
        baseline = REGISTRY[method.name]
        if baseline.uses_geometry and place is not None:
            geometry = geometry or geometry_of(place)
        return baseline(image, method.parameters, geometry)
    result = network(method.weights, device)(image, place, geometry)
    if result.shape != image.shape[-2:] or not np.isfinite(result).all():
        raise ValueError(f"gave {result.shape} or NaN for a picture of {image.shape}")
    return np.clip(result, 0, 1).astype(np.float32)
