"""What tests give `denoise` instead of weights."""

from __future__ import annotations

from collections.abc import Sequence

from simnfnd.factory.sonar.geometry import FanGeometry
from simnfnd.models.denoise import command
from simnfnd.models.denoise.pictures import Gray


def main(words: Sequence[str]) -> int:
    """`simnfnd denoise`, each frame by itself, so that its result is easy to foretell."""
    return command.main([*words, "--frames", "1"])


class Halving:
    """A denoiser whose result is easy to foretell, and which keeps what it was told."""

    name, digest = "halving", "0"

    def __init__(self) -> None:
        self.told: list[FanGeometry | None] = []

    def __call__(self, gray: Gray, geometry: FanGeometry | None = None) -> Gray:
        self.told.append(geometry)
        return gray / 2
