"""Settings of the sonar that a recording states for each of its frames.

A sonar that pings at two frequencies in turn, two heads on one topic, a gain that the operator
changes: frames of unlike settings show the same scene in another way, and must not be averaged.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from .base import SonarFrame

_SAME_FREQUENCY = 0.01  # part of it: devices state measured ones
_SAME_GAIN_DB = 0.5
_SAME_GAIN_PERCENT = 1.0
_SAME_PULSE = 0.02  # part of it
_SAME_RANGE = 0.02  # part of the largest: it follows the measured speed of sound
_IN_NAME = re.compile(r"(?<![a-z0-9])(\d+(?:\.\d+)?) ?([km]hz|db)(?![a-z])", re.IGNORECASE)
_TEXTS = {
    "sequence": "{}", "head": "{}", "frequency_khz": "{:.4g} kHz", "gain_db": "gain {:.4g} dB",
    "gain_percent": "gain {:.4g} %", "pulse_us": "pulse {:.4g} us", "range_min_m": "from {:.4g} m",
    "range_max_m": "to {:.4g} m", "beams": "{} beams",
}  # fmt: skip
"""Field -> how its value is said."""


@dataclass(frozen=True)
class RecordedSettings:
    """What a frame says of how it was recorded; None and empty: it does not say.

    sequence: its channel, slice or topic.  head: name of the sonar.  beams: their number, 0 for an
    image.
    """

    sequence: str = ""
    head: str = ""
    frequency_khz: float | None = None
    gain_db: float | None = None
    gain_percent: float | None = None
    pulse_us: float | None = None
    range_min_m: float | None = None
    range_max_m: float | None = None
    beams: int = 0

    def is_like(self, other: RecordedSettings) -> bool:
        """Whether frames of both may be fused."""
        return not self._unlike(other)

    def differences(self, other: RecordedSettings) -> list[str]:
        """What is stated and unlike in another one, such as `750 kHz`."""
        values = {field: getattr(self, field) for field in self._unlike(other)}
        return [
            _TEXTS[field].format(value)
            for field, value in values.items()
            if value not in (None, "")
        ]

    def _unlike(self, other: RecordedSettings) -> list[str]:
        """The fields whose values are further apart than devices state them."""
        range_m = max(self.range_max_m or 0.0, other.range_max_m or 0.0)
        frequency_khz = max(self.frequency_khz or 0.0, other.frequency_khz or 0.0)
        pulse_us = max(self.pulse_us or 0.0, other.pulse_us or 0.0)
        tolerances = {
            "frequency_khz": _SAME_FREQUENCY * frequency_khz,
            "gain_db": _SAME_GAIN_DB,
            "gain_percent": _SAME_GAIN_PERCENT,
            "pulse_us": _SAME_PULSE * pulse_us,
            "range_min_m": _SAME_RANGE * range_m,
            "range_max_m": _SAME_RANGE * range_m,
        }
        unlike = []
        for field in _TEXTS:
            value = getattr(self, field)
            compared = getattr(other, field)
            if field in tolerances and None not in (value, compared):
                is_unlike = abs(value - compared) > tolerances[field]
            else:
                is_unlike = value != compared
            if is_unlike:
                unlike.append(field)
        return unlike


def settings_of(frame: SonarFrame) -> RecordedSettings:
    """The settings that a frame of a recording states."""
    beams = frame.beams
    return RecordedSettings(
        sequence=frame.sequence,
        head=frame.device.name,
        frequency_khz=frame.device.frequency_khz,
        gain_db=frame.device.gain_db,
        gain_percent=frame.device.gain_percent,
        pulse_us=frame.device.pulse_us,
        range_min_m=None if beams is None else beams.range_min_m,
        range_max_m=None if beams is None else beams.range_max_m,
        beams=0 if beams is None else len(beams.azimuths_rad),
    )


def settings_in_name(name: str) -> RecordedSettings:
    """The settings that the name of an image states: a number before kHz, MHz or dB."""
    values = {unit.lower(): float(number) for number, unit in _IN_NAME.findall(name)}
    frequency_khz = values.get("khz", 1000 * values["mhz"] if "mhz" in values else None)
    return RecordedSettings(frequency_khz=frequency_khz, gain_db=values.get("db"))
