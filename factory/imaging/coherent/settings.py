"""Keys of the `acoustics` group: how echoes become a picture."""

from __future__ import annotations

from dataclasses import field
from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from ...labels import class_names
from ...settings import STRICT

Decibel = Annotated[float, Field(ge=-80, le=20)]


def _default_reflectivity() -> dict[str, float]:
    return {"Background": -25.0}


@dataclass(frozen=True, config=STRICT)
class AcousticsSettings:
    """Keys of the `acoustics` group.

    formation: points (the paper's, every echo a point) or field (sonar equation and complex field;
        the keys below, `water` and `sonar.array` count for it alone).
    target: what the clean picture is: mean_log (the expected displayed picture: random noise
        averaged, systematic effects kept), restored (the same without the systematic ones) or
        geometry (the paper's T).
    standing: part of the speckle's power that stands still from ping to ping, 0 to 1.  It does not
        average out, so targets mean_log and restored keep it; 0 for a sonar that moves.
    lambert_exponent: backscatter falls as cos(incidence) to this power, in intensity; 2 is Lambert.
    reflectivity_db: backscatter coefficient of each object class at normal incidence, dB, for an
        albedo of 1; classes that are not named, and frames without labels, are Background.
    lambert_exponents: of object classes that have another.
    materials: a CSV file of `class,reflectivity_db,lambert_exponent` lines; it wins over both.
    tvg_log: time-varying gain k log10 r + 2 a r, this is k, dB per tenfold range.
    tvg_absorption: whether the gain knows 2 a r.
    """

    formation: Literal["points", "field"] = "points"
    target: Literal["mean_log", "restored", "geometry"] = "mean_log"
    standing: Annotated[float, Field(ge=0, le=1)] = 0.0
    lambert_exponent: Annotated[float, Field(ge=0, le=8)] = 2.0
    reflectivity_db: dict[str, Decibel] = field(default_factory=_default_reflectivity)
    lambert_exponents: dict[str, Annotated[float, Field(ge=0, le=8)]] = field(default_factory=dict)
    materials: str | None = None
    tvg_log: Annotated[float, Field(ge=0, le=80)] = 30.0
    tvg_absorption: bool = True

    def reflectivity(self) -> tuple[float, ...]:
        """Backscatter coefficient of every class, in the order of `labels.class_names`.

        The user's classes are those in `reflectivity_db` that are not in CLASSES, in order.
        """
        ground = self.reflectivity_db.get("Background", -25.0)
        names = class_names(self.reflectivity_db)
        return tuple(10 ** (self.reflectivity_db.get(name, ground) / 10) for name in names)

    def exponents(self) -> tuple[float, ...]:
        """Lambert's exponent of every class, in the same order."""
        usual, names = self.lambert_exponent, class_names(self.reflectivity_db)
        return tuple(self.lambert_exponents.get(name, usual) for name in names)
