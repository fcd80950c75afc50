"""Settings of the sonar that a recording states for each of its frames.

A sonar that pings at two frequencies in turn, two heads on one topic, a gain that the operator
changes: frames of unlike settings show the same scene in another way, and must not be averaged.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from .base import SonarFrame

_SAME_FREQUENCY = 0.01  # part of it: devices state measured ones
_SAME_GAIN_DB = 0.5
_SAME_GAIN_PERCENT = 1.0
_SAME_PULSE = 0.02  # part of it
_SAME_RANGE = 0.02  # part of the largest: it follows the measured speed of sound
_IN_NAME = re.compile(r"(?<![a-z0-9])(\d+(?:\.\d+)?) ?([km]hz|db)(?![a-z])", re.IGNORECASE)
_KHZ_OF_UNIT = {"khz": 1.0, "mhz": 1000.0}


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
        if (self.sequence, self.head, self.beams) != (other.sequence, other.head, other.beams):
            return False
        range_m = max(self.range_max_m or 0.0, other.range_max_m or 0.0)
        return (
            _is_near(self.frequency_khz, other.frequency_khz, share=_SAME_FREQUENCY)
            and _is_near(self.pulse_us, other.pulse_us, share=_SAME_PULSE)
            and _is_near(self.gain_db, other.gain_db, difference=_SAME_GAIN_DB)
            and _is_near(self.gain_percent, other.gain_percent, difference=_SAME_GAIN_PERCENT)
            and _is_near(self.range_min_m, other.range_min_m, difference=_SAME_RANGE * range_m)
            and _is_near(self.range_max_m, other.range_max_m, difference=_SAME_RANGE * range_m)
        )

    def differences(self, other: RecordedSettings) -> list[str]:
        """What is stated and unlike in another one, such as `750 kHz`."""
        texts = {
            "sequence": self.sequence,
            "head": self.head,
            "frequency_khz": f"{self.frequency_khz:.4g} kHz" if self.frequency_khz else "",
            "pulse_us": f"pulse {self.pulse_us:.4g} us" if self.pulse_us else "",
            "gain_db": "" if self.gain_db is None else f"gain {self.gain_db:.4g} dB",
            "gain_percent": "" if self.gain_percent is None else f"gain {self.gain_percent:.4g} %",
            "range_min_m": "" if self.range_min_m is None else f"from {self.range_min_m:.4g} m",
            "range_max_m": "" if self.range_max_m is None else f"to {self.range_max_m:.4g} m",
            "beams": f"{self.beams} beams" if self.beams else "",
        }
        return [text for name, text in texts.items() if _differs(self, other, name) and text]


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
    frequencies = [values[unit] * khz for unit, khz in _KHZ_OF_UNIT.items() if unit in values]
    return RecordedSettings(
        frequency_khz=frequencies[0] if frequencies else None, gain_db=values.get("db")
    )


def _is_near(
    value: float | None, other: float | None, *, share: float = 0.0, difference: float = 0.0
) -> bool:
    if value is None or other is None:
        return value is other
    return math.isclose(value, other, rel_tol=share, abs_tol=difference)


def _differs(settings: RecordedSettings, other: RecordedSettings, name: str) -> bool:
    """Whether one of the values is what makes both unlike."""
    single = {name: getattr(settings, name)}
    of_other = {name: getattr(other, name)}
    if name.startswith("range"):  # within a share of the largest range
        single["range_max_m"] = settings.range_max_m
        of_other["range_max_m"] = other.range_max_m
    return not RecordedSettings(**single).is_like(RecordedSettings(**of_other))
