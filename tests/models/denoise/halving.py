"""What tests give `denoise` instead of weights."""

from __future__ import annotations

from simnfnd.factory.sonar.geometry import FanGeometry
from simnfnd.models.denoise.pictures import Gray


class Halving:
    """A denoiser whose result is easy to foretell, and which keeps what it was told."""

    digest, pictures, unchanged, looks = "0", 0, 0, 1

    def __init__(self) -> None:
        self.told: list[FanGeometry | None] = []

    def __call__(self, gray: Gray, geometry: FanGeometry | None = None) -> Gray:
        self.told.append(geometry)
        return gray / 2
