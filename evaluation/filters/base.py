"""What a classical denoising method is to the report: a pure function and a grid to tune it on."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ...factory.errors import FactoryError

Gray = npt.NDArray[np.float32]
"""(H, W) in 0..1, 0 = no echo."""

Number = int | float
Parameters = dict[str, Number]


class BaselineError(FactoryError, ValueError):
    """A method gave something that is no picture, or got parameters that it does not have."""


@dataclass(frozen=True)
class Baseline:
    """One method.

    function: (image, **parameters) -> (H, W).
    default: what its authors or its library recommend, scaled to 0..1.
    grid: the values to try of each parameter, ascending; parameters not in it stay at the default.
    source: where the method was published.
    """

    name: str
    function: Callable[..., npt.NDArray[np.floating]]
    default: Mapping[str, Number]
    grid: Mapping[str, tuple[Number, ...]]
    source: str

    def points(self) -> list[Parameters]:
        """Every combination of the grid, completed by the defaults."""
        combinations = itertools.product(*self.grid.values())
        return [{**self.default, **dict(zip(self.grid, c, strict=True))} for c in combinations]

    def __call__(self, image: npt.NDArray[Any], parameters: Mapping[str, Number]) -> Gray:
        """The denoised picture, (H, W) float32 clipped to 0..1.

        Raises BaselineError when the method gives another shape or a value that is no number.
        """
        image = np.ascontiguousarray(image, dtype=np.float32)
        result = np.asarray(self.function(image, **parameters))
        if result.shape != image.shape:
            raise BaselineError(f"{self.name}: gave {result.shape} for {image.shape}")
        if not np.isfinite(result).all():
            raise BaselineError(f"{self.name}: gave NaN or infinite pixels")
        return np.clip(result, 0, 1).astype(np.float32)
