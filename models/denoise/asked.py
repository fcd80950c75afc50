"""The weights for what is asked: what lies over a picture goes first, then what is in its grain."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ...factory.errors import FactoryError
from ...factory.sonar.geometry import FanGeometry
from ..pretrained import POINTS, REMOVAL
from .denoiser import Denoiser, load_denoiser
from .pictures import Gray

OVER: tuple[str, ...] = ("haze", "spokes", "ghosts", "gains")
"""Artefacts that `REMOVAL` was trained on: they need whole beams and arcs to be seen."""

REAL, OF_POINTS = "real", "points"
NOISES = (REAL, OF_POINTS)
"""Of real sonars, or of the points that the paper simulates."""


class InTurn:
    """Denoises by one after the other.

    name, digest: of both.  knows_frames: whether one of them does.
    """

    def __init__(self, steps: Sequence[Denoiser]) -> None:
        self._steps = tuple(steps)
        self.knows_frames = any(step.knows_frames for step in self._steps)
        self.name = ", then ".join(step.name for step in self._steps)
        together = "".join(step.digest for step in self._steps)
        self.digest = hashlib.sha256(together.encode()).hexdigest()

    def __call__(
        self,
        gray: Gray,
        geometry: FanGeometry | None = None,
        *,
        frames: float | Gray | None = None,
    ) -> Gray:
        """See `Denoiser`."""
        for step in self._steps:
            gray = step(gray, geometry, frames=frames)
        return gray


def asked_denoiser(
    weights: str | Path | None,
    device: str,
    remove: Sequence[str] | None,
    *,
    noise: str = REAL,
    **how: Any,
) -> Denoiser | InTurn:
    """What removes the artefacts that are asked for; None: the usual ones.

    weights: those that do all of it; None: of those that ship `REMOVAL` for what lies over a
    picture, and the default ones for the rest.  noise: of NOISES, which of those that ship are
    the default.  how: as of `load_denoiser`, which see for errors.
    Raises FactoryError for both weights and noise of points, too.
    """
    if noise not in NOISES:
        raise FactoryError(f"--noise {noise}: is none of {', '.join(NOISES)}")
    if noise == OF_POINTS:
        if weights is not None:
            raise FactoryError(
                "--noise points chooses among weights that ship; leave out --weights"
            )
        weights = POINTS
    over = [name for name in remove or () if name in OVER]
    if weights is not None or not over:
        return load_denoiser(weights, device, remove=remove, **how)
    first = load_denoiser(REMOVAL, device, remove=over, **how)
    rest = [name for name in remove or () if name not in OVER]
    if not rest:
        return first
    return InTurn((first, load_denoiser(None, device, remove=rest, **how)))
