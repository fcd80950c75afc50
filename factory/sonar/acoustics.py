"""The water: how fast sound runs in it, how much it takes from it, how loud it is by itself."""

from __future__ import annotations

import math
from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from ..settings import STRICT


@dataclass(frozen=True, config=STRICT)
class WaterSettings:
    """Keys of the `water` group.

    temperature_c: degrees Celsius.  salinity_psu: practical salinity; 35 is sea, 0 is fresh.
    depth_m: of the sonar below the surface, metres.  ph: acidity.
    """

    temperature_c: Annotated[float, Field(ge=-2, le=40)] = 10.0
    salinity_psu: Annotated[float, Field(ge=0, le=45)] = 35.0
    depth_m: Annotated[float, Field(ge=0, le=11_000)] = 5.0
    ph: Annotated[float, Field(ge=6, le=9)] = 8.0

    def sound_speed_m_s(self) -> float:
        """Speed of sound, m/s: the linear formula of Francois & Garrison (1982)."""
        return 1412 + 3.21 * self.temperature_c + 1.19 * self.salinity_psu + 0.0167 * self.depth_m

    def absorption_db_per_m(self, frequency_khz: float) -> float:
        """Absorption of sound, one way, dB/m.

        Francois & Garrison, J. Acoust. Soc. Am. 72 (1982), 896 and 1879: boric acid, magnesium
        sulphate and the water itself, each a relaxation with a strength, a pressure factor and a
        frequency.
        """
        t, s, d, f2 = self.temperature_c, self.salinity_psu, self.depth_m, frequency_khz**2
        speed = self.sound_speed_m_s()

        boric = 8.86 / speed * 10 ** (0.78 * self.ph - 5)
        boric_khz = 2.8 * math.sqrt(s / 35) * 10 ** (4 - 1245 / (273 + t))

        sulphate = 21.44 * s / speed * (1 + 0.025 * t) * (1 - 1.37e-4 * d + 6.2e-9 * d**2)
        sulphate_khz = 8.17 * 10 ** (8 - 1990 / (273 + t)) / (1 + 0.0018 * (s - 35))

        if t <= 20:
            pure = 4.937e-4 - 2.59e-5 * t + 9.11e-7 * t**2 - 1.50e-8 * t**3
        else:
            pure = 3.964e-4 - 1.146e-5 * t + 1.45e-7 * t**2 - 6.5e-10 * t**3
        pure *= 1 - 3.83e-5 * d + 4.9e-10 * d**2

        db_per_km = (
            boric * boric_khz * f2 / (boric_khz**2 + f2)
            + sulphate * sulphate_khz * f2 / (sulphate_khz**2 + f2)
            + pure * f2
        )
        return db_per_km / 1000


def thermal_noise_db(frequency_khz: float, bandwidth_khz: float) -> float:
    """Thermal noise of the sea in a band, dB re 1 uPa: -15 + 20 log10 f + 10 log10 B.

    Mellen, J. Acoust. Soc. Am. 24 (1952), 478, as in Urick, Principles of Underwater Sound.
    frequency_khz, bandwidth_khz: kHz.
    """
    return -15 + 20 * math.log10(frequency_khz) + 10 * math.log10(1000 * bandwidth_khz)
