"""What lies over a picture is removed first, by weights of its own, then what is in its grain."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ...factory.sonar.geometry import FanGeometry
from ..pretrained import REMOVAL
from .denoiser import Denoiser, load_denoiser
from .pictures import Gray

OVER: tuple[str, ...] = ("haze", "spokes", "ghosts", "gains")
"""Artefacts that `REMOVAL` was trained on: they need whole beams and arcs to be seen."""


class InTurn:
    """Denoises by one after the other.

    digest: of both.  knows_frames: whether the last knows how many frames were averaged.
    """

    def __init__(self, steps: Sequence[Denoiser]) -> None:
        self._steps = tuple(steps)
        together = "".join(step.digest for step in self._steps)
        self.digest = hashlib.sha256(together.encode()).hexdigest()
        self.knows_frames = self._steps[-1].knows_frames

    def __call__(
        self,
        gray: Gray,
        geometry: FanGeometry | None = None,
        *,
        layout: str | None = None,
        frames: float | Gray | None = None,
    ) -> Gray:
        """See `Denoiser`."""
        for step in self._steps:
            gray = step(gray, geometry, layout=layout, frames=frames)
        return gray


def asked_denoiser(
    weights: str | Path | None, device: str, remove: Sequence[str] | None, **how: Any
) -> Denoiser | InTurn:
    """What removes the artefacts that are asked for; None: the usual ones.

    weights: those that do all of it; None: of those that ship `REMOVAL` for what lies over a
    picture, and the default ones for the rest.  how: as of `load_denoiser`, which see for errors.
    """
    over = [name for name in remove or () if name in OVER]
    if weights is not None or not over:
        return load_denoiser(weights, device, remove=remove, **how)
    first = load_denoiser(REMOVAL, device, remove=over, **how)
    rest = [name for name in remove or () if name not in OVER]
    if not rest:
        return first
    return InTurn((first, load_denoiser(None, device, remove=rest, **how)))
