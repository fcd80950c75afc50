"""Weak sides of the sector: transmitter and receivers look ahead, and less to the sides.

Pictures of the Marine Debris Dataset are a third darker at the sides of the sector than in its
middle (docs/realism.md); makers give a sector as the width at which that is 3 dB.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from pydantic.dataclasses import dataclass

from ...distribution import NonNegative
from ...imaging.coherent.expected import Expected
from ...imaging.coherent.signal import Floats, Ping
from ...settings import STRICT
from ...sonar.settings import SonarSettings
from ..effect import Effect, EffectSettings, parameter


@dataclass(frozen=True, config=STRICT)
class SectorEdgesSettings(EffectSettings):
    """Keys of `noise.sector_edges`.

    level_db: how far the outermost bearings of the sector lie below straight ahead, dB; in between
        it grows with the square of the bearing, as the main lobe of a beam pattern does.
    """

    level_db: NonNegative = parameter(3, "dB")


def sector_edges(field: Floats, ping: Ping, rng: np.random.Generator, *, level_db: float) -> Floats:
    """The field, weaker to the sides."""
    field *= (10 ** (_gain_db(ping.sonar, level_db) / 20)).astype(np.float32)
    return field


def expect_sector_edges(
    expected: Expected, ping: Ping, rng: np.random.Generator, *, level_db: float
) -> None:
    """The intensities, weaker to the sides."""
    expected.scale(10 ** (_gain_db(ping.sonar, level_db) / 10))


def _gain_db(sonar: SonarSettings, level_db: float) -> npt.NDArray[np.float64]:
    """(beams,) dB, none straight ahead."""
    side = sonar.beam_centres_rad() / (np.deg2rad(sonar.hfov_deg) / 2)
    return np.asarray(-level_db * side**2)


SECTOR_EDGES = Effect(
    SectorEdgesSettings,
    sector_edges,
    "picture",
    systematic=True,
    expected=expect_sector_edges,
    artefact="gains",
)
