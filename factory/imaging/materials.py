"""How object classes echo: keys of `acoustics`, a CSV file, and what the user's objects say."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from ..errors import FactoryError
from ..labels import CLASSES
from ..scenes.base import OwnClass
from ..small_files import one_line, read_regular
from .coherent.settings import AcousticsSettings


def with_materials(
    acoustics: AcousticsSettings, classes: tuple[str, ...], own: Iterable[OwnClass]
) -> AcousticsSettings:
    """The settings with a reflectivity for each of the user's classes, in the order of `classes`.

    classes: those of `labels.class_names`.  own: what they say wins over the keys, and what
    `acoustics.materials` says over both.  Raises FactoryError.
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
        listed = _listed(Path(acoustics.materials).expanduser())
        said |= {one.label: (one.reflectivity_db, one.lambert_exponent) for one in listed}
    for name, (level_db, exponent) in said.items():
        echo_db |= {} if level_db is None else {name: level_db}
        exponents |= {} if exponent is None else {name: exponent}
    for name in (*echo_db, *exponents):
        if name not in classes:
            raise FactoryError(
                f"acoustics: no class is called {name}; there are {', '.join(classes)}"
            )
    ground_db = echo_db.get("Background", -25.0)
    echo_db |= {name: echo_db.pop(name, ground_db) for name in classes[len(CLASSES) :]}
    return replace(acoustics, reflectivity_db=echo_db, lambert_exponents=exponents)


def _listed(path: Path) -> list[OwnClass]:
    """The lines of a file."""
    key, expected = f"acoustics.materials={path}", "expected class,reflectivity_db,lambert_exponent"
    try:
        lines = read_regular(path).decode("utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise FactoryError(f"{key}: {one_line(error)}") from error
    found = []
    for number, line in enumerate(csv.DictReader(lines, skipinitialspace=True), start=2):
        given = {name: value for name, value in line.items() if value}
        try:
            found.append(TypeAdapter(OwnClass).validate_python(given))
        except ValidationError as error:
            got = ",".join(map(str, given.values()))
            raise FactoryError(f"{key}:{number}: {expected}, got {got[:60]!r}") from error
    return found
