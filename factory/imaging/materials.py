"""How object classes echo: keys of `acoustics`, a CSV file, and what the user's objects say."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Protocol

from pydantic import TypeAdapter, ValidationError

from ..errors import FactoryError
from ..labels import CLASSES
from ..small_files import one_line, read_regular
from .coherent.settings import AcousticsSettings

_HEADER = ["class", "reflectivity_db", "lambert_exponent"]


class Material(Protocol):
    """What an object of the user's says of its class."""

    @property
    def label(self) -> str:
        """The class."""

    @property
    def reflectivity_db(self) -> float | None:
        """See `AcousticsSettings`; None: not said here."""

    @property
    def lambert_exponent(self) -> float | None:
        """Likewise."""


def with_materials(
    acoustics: AcousticsSettings, classes: tuple[str, ...], own: Iterable[Material]
) -> AcousticsSettings:
    """The settings with a reflectivity for each of the user's classes, in the order of `classes`.

    classes: those of `labels.class_names`.  own: their materials win over the keys, and those of
    `acoustics.materials` over both.  Raises FactoryError.
    """
    echo_db, exponents = dict(acoustics.reflectivity_db), dict(acoustics.lambert_exponents)
    said: dict[str, tuple[float | None, float | None]] = {}
    for one in own:
        here = one.reflectivity_db, one.lambert_exponent
        if said.setdefault(one.label, here) != here:
            raise FactoryError(
                f"scenes.own_objects: {one.label} has two materials; give the same, or two classes"
            )
    if acoustics.materials is not None:
        said |= _listed(Path(acoustics.materials).expanduser())
    for name, (level_db, exponent) in said.items():
        echo_db |= {} if level_db is None else {name: level_db}
        exponents |= {} if exponent is None else {name: exponent}
    for key, names in (("reflectivity_db", echo_db), ("lambert_exponents", exponents)):
        for name in names:
            if name not in classes:
                raise FactoryError(
                    f"acoustics.{key}: no class is called {name}; there are {', '.join(classes)}"
                )
    ground_db = echo_db.get("Background", -25.0)
    echo_db |= {name: echo_db.pop(name, ground_db) for name in classes[len(CLASSES) :]}
    return replace(acoustics, reflectivity_db=echo_db, lambert_exponents=exponents)


def _listed(path: Path) -> dict[str, tuple[float | None, float | None]]:
    """Class -> reflectivity and exponent, None for an empty field."""
    try:
        lines = read_regular(path).decode("utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise FactoryError(f"acoustics.materials={path}: {one_line(error)}") from error
    rows = list(csv.reader(lines))
    if not rows or [word.strip() for word in rows[0]] != _HEADER:
        raise FactoryError(
            f"acoustics.materials={path}: the first line must be {','.join(_HEADER)}"
        )
    found = {}
    for number, row in enumerate(rows[1:], start=2):
        try:
            name, *fields = (word.strip() for word in row)
            level_db, exponent = (float(field) if field else None for field in fields)
            checked = {} if level_db is None else {name: level_db}
            powers = {} if exponent is None else {name: exponent}
            TypeAdapter(AcousticsSettings).validate_python(
                {"reflectivity_db": checked, "lambert_exponents": powers}
            )
        except (ValueError, ValidationError) as error:
            raise FactoryError(
                f"acoustics.materials={path}:{number}: expected {','.join(_HEADER)}, got "
                f"{','.join(row)[:60]!r}"
            ) from error
        found[name] = level_db, exponent
    return found
