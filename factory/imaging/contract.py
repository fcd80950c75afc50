"""What an image formation is: from a frame's surface to clean and noisy polar pictures.

`simnfnd.factory.pairs` assembles pairs with it and knows no more; each `Formation` is one line
there.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, Protocol

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from ..sonar.acoustics import WaterSettings
    from ..sonar.settings import SonarSettings
    from ..sonar.surface import LitSurface
    from .coherent.settings import AcousticsSettings
    from .resample import ResampleSettings

Floats = npt.NDArray[np.float32]
Layers = npt.NDArray[np.generic]

# When an effect of noise acts: on the echoes as points; on the complex field before the device
# blurs it; after beamforming; after time-varying gain.
Stage = Literal["points", "echo", "beam", "picture"]

# What an effect of noise shows in a picture, and what a denoiser can be told to remove: grain that
# averages out; a level added to the ground; bright beams and arcs; copies of objects at the wrong
# place; smeared ranges; wrong gains of beams and ranges.
Artefact = Literal["speckle", "haze", "spokes", "ghosts", "blur", "gains"]
ARTEFACTS: tuple[Artefact, ...] = ("speckle", "haze", "spokes", "ghosts", "blur", "gains")


class DrawnEffect(Protocol):
    """An effect of noise with the parameters and the random stream of one sample."""

    @property
    def name(self) -> str:
        """Its block of the `noise` group."""

    @property
    def stage(self) -> Stage:
        """When it acts."""

    @property
    def moves(self) -> bool:
        """Of stage points: whether it displaces the scene's echoes; the others add some."""

    @property
    def systematic(self) -> bool:
        """Whether it is there in every picture of a scene; the others average out."""

    @property
    def artefact(self) -> Artefact | None:
        """What it shows in a picture; None: a property of the scene."""

    def expect(self, expected: Any, context: Any) -> None:
        """Change expected intensities as it does on average; equal calls do the same."""

    def realise(self, expected: Any, context: Any) -> None:
        """The same as it does in this one sample, where that differs and can be told."""

    def apply(self, subject: Any, context: Any) -> Any:
        """What it makes of `subject`; equal calls give equal results."""


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
