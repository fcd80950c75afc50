"""The weights that suit a picture of which nothing is known."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from ....factory.sonar.geometry import FanGeometry
from ...pretrained import POINTS
from ...recordings.presentation import presentation_of
from ..denoiser import known_geometry
from ..pictures import Denoise, Gray
from .points import likelihood

_SURE = 0.1
"""Nearer to 0 or 1 than this, one of both denoises alone; between, both, weighed."""


class Suited:
    """Denoises each picture by the weights for its kind of noise, or by both where in doubt."""

    def __init__(self, usual: Denoise, points: Callable[[], Denoise]) -> None:
        """usual: for real sonars.  points: gives those for the paper's noise, when needed."""
        self._usual, self._points = usual, points
        self._seen, self._of_points = 0, 0

    def __call__(
        self,
        gray: Gray,
        geometry: FanGeometry | None = None,
        *,
        layout: str | None = None,
    ) -> Gray:
        """See `Denoiser`; neither of the weights sees several pictures."""
        given = presentation_of(gray, known_geometry(geometry, layout, gray))
        return given.undone(self._denoise(given.shown(gray), given.geometry))

    def _denoise(self, gray: Gray, geometry: FanGeometry | None) -> Gray:
        part = likelihood(gray, geometry)
        self._seen += 1
        self._of_points += part > 0.5
        if part > 1 - _SURE:
            return self._points()(gray, geometry)
        usual = self._usual(gray, geometry)
        if part < _SURE:
            return usual
        return usual + np.float32(part) * (self._points()(gray, geometry) - usual)

    def summary(self) -> Iterator[str]:
        """One line where pictures were taken for those of points."""
        if self._of_points:
            yield (
                f"weights: {POINTS} for {self._of_points} of {self._seen} pictures, whose noise is "
                "that of points; --weights takes one for all"
            )
