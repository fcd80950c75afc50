"""What turns grey values into sound pressure: columns on request, `dataset.columns=[calibration]`.

Level at the receiver = full scale of the picture, its transfer curve backwards, less the gain, plus
the source level; layer intensity_db is the result.
"""

from __future__ import annotations

from ..dataset.format.schema import Column
from ..imaging.coherent.settings import AcousticsSettings
from ..sonar.acoustics import WaterSettings
from ..sonar.settings import SonarSettings

COLUMNS = (
    Column("source_level_db", "f8", "dB re 1 uPa at 1 m", "of the device"),
    Column("sound_speed_m_s", "f8", "m/s", "of the water"),
    Column("absorption_db_per_m", "f8", "dB/m", "of the water at the frequency, one way"),
    Column("tvg_db_per_decade", "f8", "dB", "time-varying gain of the pictures, per tenfold range"),
    Column("tvg_db_per_m", "f8", "dB/m", "time-varying gain of the pictures, per metre"),
)


def row(
    sonar: SonarSettings, water: WaterSettings, acoustics: AcousticsSettings
) -> dict[str, float]:
    """The values of `COLUMNS`."""
    absorption = water.absorption_db_per_m(sonar.frequency_khz)
    values = (
        sonar.array.source_level_db,
        water.sound_speed_m_s(),
        absorption,
        acoustics.tvg_log,
        2 * absorption if acoustics.tvg_absorption else 0.0,
    )
    return {column.name: value for column, value in zip(COLUMNS, values, strict=True)}
