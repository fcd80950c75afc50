"""Keys of `acoustics` and `resample`, and how object classes echo."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from dataclasses import field, fields, replace
from pathlib import Path
from typing import Annotated, Literal, TypeGuard

from pydantic import Field, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass

from ...common.distribution import PositiveFraction, parse
from ...common.errors import FactoryError
from ...common.settings import STRICT
from ...common.small_files import one_line, read_regular
from ...dataset.meaning import CLASSES, class_names
from ..scenes.base import OwnClass

Decibel = Annotated[float, Field(ge=-80, le=20)]
GROUND_DB = -25.0
"""Backscatter coefficient of Background where nothing is said of it."""


@dataclass(frozen=True, config=STRICT)
class PointwiseSettings:
    """Keys of `acoustics=pointwise`: the paper's image formation, in which every echo is a point.

    What else decides its images: `resample`, sonar.accumulate, sonar.point_spread and
    sonar.tvg_db_per_decade.
    """

    formation: Literal["pointwise"] = "pointwise"


@dataclass(frozen=True, config=STRICT)
class CoherentSettings:
    """Keys of `acoustics=coherent`: the sonar equation and a complex field.

    What else decides its images: `water`, sonar.array, sonar.frequency_khz and
    sonar.samples_per_bin.

    target: what the clean image is: noise_free (the device without any effect of `noise`), mean_log
        (the expected displayed image: random noise averaged, systematic effects kept) or restored
        (the same without the systematic ones).
    standing: part of the speckle's power that stays from ping to ping, 0 to 1.  It does not average
        out, so targets mean_log and restored keep it; 0 for a sonar that moves.
    lambert_exponent: backscatter falls as cos(incidence) to this power, in intensity; 2 is Lambert.
    reflectivity_db: backscatter coefficient of each object class at normal incidence, dB, for an
        albedo of 1; classes that are not named, and frames without labels, are Background.
    lambert_exponents: of object classes that have another.
    materials: a CSV file of `class,reflectivity_db,lambert_exponent` lines; it wins over both.
    tvg_log: time-varying gain k log10 r + 2 a r, this is k, dB per tenfold range.
    tvg_absorption: whether the gain knows 2 a r.
    """

    formation: Literal["coherent"] = "coherent"
    target: Literal["noise_free", "mean_log", "restored"] = "noise_free"
    standing: Annotated[float, Field(ge=0, le=1)] = 0.0
    lambert_exponent: Annotated[float, Field(ge=0, le=8)] = 2.0
    reflectivity_db: dict[str, Decibel] = field(default_factory=lambda: {"Background": GROUND_DB})
    lambert_exponents: dict[str, Annotated[float, Field(ge=0, le=8)]] = field(default_factory=dict)
    materials: str | None = None
    tvg_log: Annotated[float, Field(ge=0, le=80)] = 30.0
    tvg_absorption: bool = True

    def of_classes(self) -> list[tuple[float, float]]:
        """Backscatter coefficient and Lambert's exponent of each of `meaning.class_names`.

        The user's classes are those in `reflectivity_db` that are not in CLASSES, in order.
        """
        echo_db = self.reflectivity_db
        usual = self.lambert_exponent
        ground_db = echo_db.get("Background", GROUND_DB)
        return [
            (10 ** (echo_db.get(name, ground_db) / 10), self.lambert_exponents.get(name, usual))
            for name in class_names(echo_db)
        ]


AcousticsSettings = Annotated[
    PointwiseSettings | CoherentSettings, Field(discriminator="formation")
]
"""The image formation, each with the settings that it uses."""


def is_coherent(acoustics: PointwiseSettings | CoherentSettings) -> TypeGuard[CoherentSettings]:
    """Whether images are formed by a complex field, whose beams are cones."""
    return isinstance(acoustics, CoherentSettings)


Formation = Literal["pointwise", "coherent"]
SETTINGS_OF: dict[Formation, type[PointwiseSettings] | type[CoherentSettings]] = {
    "pointwise": PointwiseSettings,
    "coherent": CoherentSettings,
}


def formation_of(key: str) -> Formation | None:
    """The formation that has this dotted key, such as acoustics.tvg_log, for itself."""
    group, _, name = key.partition(".")
    if group != "acoustics" or name == "formation":
        return None
    for formation, settings in SETTINGS_OF.items():
        if name.partition(".")[0] in {item.name for item in fields(settings)}:
            return formation
    return None


@dataclass(frozen=True, config=STRICT)
class ResampleSettings:
    """Keys of `resample`: how many points the sonar resolves.

    kind: how they are chosen.  rate: fraction of them that is kept, in (0, 1].
    """

    kind: Literal["random"] = "random"
    rate: PositiveFraction = parse({"uniform": [0.35, 0.9]}, 1e-6, 1.0)


def with_materials(
    acoustics: CoherentSettings, classes: tuple[str, ...], own: Iterable[OwnClass]
) -> CoherentSettings:
    """The settings with a reflectivity for each of the user's classes, in the order of `classes`.

    classes: those of `meaning.class_names`.  own: what they say wins over the keys, and what
    `acoustics.materials` says over both.  Raises FactoryError.
    """
    echo_db = dict(acoustics.reflectivity_db)
    exponents = dict(acoustics.lambert_exponents)
    material_of_class: dict[str, tuple[float | None, float | None]] = {}
    for own_class in own:
        material = own_class.reflectivity_db, own_class.lambert_exponent
        if material_of_class.setdefault(own_class.label, material) != material:
            raise FactoryError(
                f"scenes.own_objects: {own_class.label} has two materials; give the same, or "
                "two classes"
            )
    if acoustics.materials is not None:
        listed = _listed(Path(acoustics.materials).expanduser())
        material_of_class |= {
            own_class.label: (own_class.reflectivity_db, own_class.lambert_exponent)
            for own_class in listed
        }
    for name, (level_db, exponent) in material_of_class.items():
        echo_db |= {} if level_db is None else {name: level_db}
        exponents |= {} if exponent is None else {name: exponent}
    for name in (*echo_db, *exponents):
        if name not in classes:
            raise FactoryError(
                f"acoustics: no class is called {name}; there are {', '.join(classes)}"
            )
    ground_db = echo_db.get("Background", GROUND_DB)
    echo_db |= {name: echo_db.pop(name, ground_db) for name in classes[len(CLASSES) :]}
    return replace(acoustics, reflectivity_db=echo_db, lambert_exponents=exponents)


def _listed(path: Path) -> list[OwnClass]:
    """The classes that a CSV file of materials lists."""
    key = f"acoustics.materials={path}"
    expected = "expected class,reflectivity_db,lambert_exponent"
    try:
        lines = read_regular(path).decode("utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise FactoryError(f"{key}: {one_line(error)}") from error
    classes = []
    for number, line in enumerate(csv.DictReader(lines, skipinitialspace=True), start=2):
        entries = {name: value for name, value in line.items() if value}
        try:
            classes.append(TypeAdapter(OwnClass).validate_python(entries))
        except ValidationError as error:
            got = ",".join(map(str, entries.values()))
            raise FactoryError(f"{key}:{number}: {expected}, got {got[:60]!r}") from error
    return classes
