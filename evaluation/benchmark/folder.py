"""A benchmark on disk: its manifest, its pictures and references, checked when they are read.

benchmark.json          version, sets, hashes
noisy/SET/NAME.png      what methods get, with geometry.csv
references/SET/...      what they are compared with: clean/, and shadow/ or where/
practice/SET/...        noisy/ and clean/ of other scenes, to tune and try on
results/NAME.json       one file a method
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
import numpy.typing as npt
from pydantic import Field
from pydantic.dataclasses import dataclass

from ...factory.errors import FactoryError
from ...factory.files import write_atomically
from ...factory.settings import STRICT, build
from ...factory.small_files import one_line, parse_json, read_regular
from ...factory.sonar.geometry import FanGeometry
from ...models.data.fans import read_fans
from . import pictures
from .pictures import Gray8

SCHEMA: Final = "simnfnd-benchmark/1"
VERSION = 1
"""Of the sets and of the figures: results of different versions do not stand in one table."""

MANIFEST, NOISY, REFERENCES, PRACTICE, RESULTS = (
    "benchmark.json",
    "noisy",
    "references",
    "practice",
    "results",
)
CLEAN, GEOMETRY = "clean", "geometry.csv"
MASKS = {"simulated": "shadow", "real": "where"}
"""Kind of a set -> folder of its masks: the true shadow, or what is judged."""

Digest = Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
# Both are names of files.
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._+-]{0,63}$")]


@dataclass(frozen=True, config=STRICT)
class Entry:
    """A picture.  group: its place or scene, the unit of intervals and tests."""

    name: Name
    group: str
    noisy: Digest
    clean: Digest
    mask: Digest


@dataclass(frozen=True, config=STRICT)
class SetEntry:
    """A set.  practice: name of the practice pairs that are like it, or ''."""

    kind: Literal["simulated", "real"]
    about: str
    practice: str
    pictures: tuple[Entry, ...]

    @property
    def digest(self) -> str:
        """Changes with any pixel of the set, its groups or its order."""
        return sealed([self.kind, [asdict(one) for one in self.pictures]])


@dataclass(frozen=True, config=STRICT)
class Manifest:
    """benchmark.json."""

    schema: Literal["simnfnd-benchmark/1"]
    version: int
    made_with: str
    seed: int
    sets: dict[Name, SetEntry]
    practice: dict[Name, SetEntry]

    def write(self, root: Path) -> None:
        """Write it.  FactoryError when the folder cannot be written to."""
        content = json.dumps(asdict(self), indent=1) + "\n"
        write_atomically(root / MANIFEST, content.encode(), key="--out")


class PictureSet:
    """The pictures of a set, or of the practice pairs, with what they are compared with."""

    def __init__(self, name: str, entry: SetEntry, noisy: Path, references: Path) -> None:
        self.name, self.entry = name, entry
        self.folder, self._references = noisy, references

    @property
    def pictures(self) -> tuple[Entry, ...]:
        """In the order of all tables."""
        return self.entry.pictures

    @property
    def groups(self) -> list[str]:
        """Of each picture."""
        return [one.group for one in self.pictures]

    def path(self, one: Entry) -> Path:
        """Of the noisy picture."""
        return self.folder / f"{one.name}.png"

    def noisy(self, one: Entry) -> Gray8:
        """(H, W) uint8.  FactoryError when it is absent or another picture."""
        return pictures.read(self.path(one), one.noisy)

    def clean(self, one: Entry) -> npt.NDArray[np.float32]:
        """(H, W) in 0..1: the clean picture, or the mean of the other frames."""
        path = self._references / CLEAN / f"{one.name}.png"
        return pictures.in_unit_range(pictures.read(path, one.clean))

    def mask(self, one: Entry) -> npt.NDArray[np.bool_]:
        """(H, W) bool: the true shadow, or what is judged of a real picture."""
        path = self._references / MASKS[self.entry.kind] / f"{one.name}.png"
        return np.asarray(pictures.read(path, one.mask) > 0)

    def geometry(self, one: Entry) -> FanGeometry | None:
        """Where range and bearing are, as `geometry.csv` tells everybody; None: unknown."""
        return self._fans.get(f"{one.name}.png")

    @cached_property
    def _fans(self) -> Mapping[str, FanGeometry]:
        table = self.folder / GEOMETRY
        return read_fans(table) if table.is_file() else {}


class Benchmark:
    """A benchmark in a folder."""

    def __init__(self, root: Path) -> None:
        """Raises FactoryError for a folder that holds none, or one of another version."""
        self.root = root
        self.manifest = _manifest(root)
        self.sets = {
            name: PictureSet(name, one, root / NOISY / name, root / REFERENCES / name)
            for name, one in self.manifest.sets.items()
        }
        self.practice = {
            name: PictureSet(name, one, root / PRACTICE / name / NOISY, root / PRACTICE / name)
            for name, one in self.manifest.practice.items()
        }

    @property
    def results(self) -> Path:
        """Folder of the result files."""
        return self.root / RESULTS


def sealed(content: Any) -> str:
    """SHA-256 of plain data, the same for the same content however it was written."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def load_json(path: Path) -> dict[str, Any]:
    """An object in a small file that a stranger may have written.  Raises FactoryError."""
    try:
        content = parse_json(read_regular(path))
    except OSError as error:
        raise FactoryError(f"{path}: cannot be read ({one_line(error)})") from error
    except ValueError as error:
        raise FactoryError(f"{path}: not JSON ({one_line(error)})") from error
    if not isinstance(content, dict):
        raise FactoryError(f"{path}: not a JSON object")
    return content


def _manifest(root: Path) -> Manifest:
    path = root / MANIFEST
    if not path.is_file():
        raise FactoryError(
            f"{root}: holds no benchmark ({MANIFEST}); `simnfnd benchmark make --out {root}` "
            "makes one"
        )
    try:
        found: Manifest = build(Manifest, load_json(path))
    except FactoryError as error:
        raise FactoryError(f"{path}: {error}".replace(f"{path}: {path}", str(path))) from error
    if found.version != VERSION:
        raise FactoryError(
            f"{path}: version {found.version} of the benchmark, this program has {VERSION}; make "
            "it anew"
        )
    return found
