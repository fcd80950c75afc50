"""Limits of physical keys, with units, and a hint at the unit that a number looks like."""

from __future__ import annotations

import math
from dataclasses import dataclass

from pydantic import AfterValidator

# Unit of a key -> other units of the same quantity, and the factor from each to the key's.
_OTHER_UNITS = {
    "kHz": (("Hz", 1e-3), ("MHz", 1e3)),
    "m": (("mm", 1e-3), ("cm", 1e-2), ("km", 1e3)),
    "deg": (("radians", 180 / math.pi),),
    "psu": (("kg of salt a kg of water", 1e3),),
    "s": (("ms", 1e-3),),
    "m/s": (("km/h", 1 / 3.6), ("mm/s", 1e-3)),
    "dB/m": (("dB/km", 1e-3),),
}
_KELVIN = 273.15


@dataclass(frozen=True)
class Limits:
    """The numbers that a key takes: low to high in its unit, and 0 where `or_zero` says so."""

    low: float
    high: float
    unit: str = ""
    or_zero: bool = False

    def check(self, value: float) -> None:
        """Raise ValueError for a number outside, with the limits and a hint at its unit."""
        if self._holds(value):
            return
        left = "(-inf" if math.isinf(self.low) else f"[{self.low:g}"
        right = "inf)" if math.isinf(self.high) else f"{self.high:g}]"
        zero = "be 0 or " if self.or_zero else ""
        unit = f" {self.unit}" if self.unit else ""
        interval = f"{zero}lie in {left}, {right}{unit}"
        raise ValueError(f"must {interval}, got {value:g}{self._hint(value)}")

    def _holds(self, value: float) -> bool:
        return self.low <= value <= self.high or (self.or_zero and value == 0)

    def _hint(self, value: float) -> str:
        """A question where the number would be right in another unit."""
        if value == 0:
            return ""
        if self.unit == "C" and self._holds(value - _KELVIN):
            return "; did you give K?"
        for unit, factor in _OTHER_UNITS.get(self.unit, ()):
            if self._holds(value * factor):
                return f"; did you give {unit}?"
        return ""


@dataclass(frozen=True)
class LimitedNumber(AfterValidator):
    """A validator that states its limits, as pages with sliders look for them."""

    ge: float = -math.inf
    le: float = math.inf


def limited(low: float, high: float, unit: str = "", *, or_zero: bool = False) -> LimitedNumber:
    """Return a validator for a key that holds a number.

    As in `Annotated[float, limited(0, 90, "deg")]`.
    """
    limits = Limits(low, high, unit, or_zero)

    def check(value: float) -> float:
        limits.check(value)
        return value

    return LimitedNumber(check, 0.0 if or_zero else low, high)
