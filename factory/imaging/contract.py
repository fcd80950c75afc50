"""What an image formation is: from a frame's surface to clean and noisy polar pictures.

`simnfnd.factory.pairs` assembles pairs with it and knows no more; each `Formation` is one line
there.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Protocol

import numpy as np
import numpy.typing as npt

from .effect import DrawnEffect

if TYPE_CHECKING:
    from ..sonar.array import WaterSettings
    from ..sonar.settings import SonarSettings
    from ..sonar.surface import LitSurface
    from .settings import AcousticsSettings, ResampleSettings

Floats = npt.NDArray[np.float32]
Layers = npt.NDArray[np.generic]


class ImagingSettings(Protocol):
    """The groups of the configuration that pictures are formed by."""

    @property
    def seed(self) -> int:
        """Root of all random streams."""

    @property
    def sonar(self) -> SonarSettings:
        """The device."""

    @property
    def water(self) -> WaterSettings:
        """What the sound goes through."""

    @property
    def acoustics(self) -> AcousticsSettings:
        """How the field is formed."""

    @property
    def resample(self) -> ResampleSettings:
        """How points are thinned."""


class Scene(Protocol):
    """A frame as the sonar observes it: what all its samples share; no randomness."""

    @property
    def filled(self) -> npt.NDArray[np.bool_]:
        """(range_bins, beams) bool: bins in which insonified surface lies."""

    def sample(
        self, variant: int, effects: Sequence[DrawnEffect], config: ImagingSettings
    ) -> Sample:
        """One sample; config is that of the scene but for the noise.  Equal calls, equal bytes."""


class Sample(Protocol):
    """One sample of a scene.

    Pictures are (range_bins, beams) float32 grey values, 0 to 1, and 0 in beams without data.
    """

    @property
    def rate(self) -> float:
        """Fraction of the scene's points that resampling has kept."""

    @property
    def points(self) -> int:
        """Number of scene points in the pictures."""

    @property
    def added(self) -> Mapping[str, int]:
        """Points that each effect of stage points has added or moved, by its name."""

    @property
    def full_scale(self) -> float:
        """Echo intensity, after time-varying gain, that the noisy picture shows as grey value 1."""

    @property
    def clean_full_scale(self) -> float:
        """The same of the clean picture, in the unit of its target."""

    @property
    def clean(self) -> Floats:
        """The clean picture."""

    def noisy(self, effects: Collection[str]) -> Floats:
        """The picture with those of the drawn effects that are named."""

    def without(self, artefacts: Collection[str]) -> Floats:
        """The picture as it would be without these artefacts, under the same random streams.

        Without speckle it is the expected displayed picture: what averages out is averaged.
        """

    def measured(self, effects: Collection[str], layers: Collection[str]) -> Mapping[str, Layers]:
        """Those of the layers that say what was received, with those of the drawn effects."""


Formation = Callable[["LitSurface", ImagingSettings], Scene]
"""The frame as the sonar observes it; raises FrameError when no surface lies in its sector."""
