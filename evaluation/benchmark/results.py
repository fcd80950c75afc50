"""Result files: the figures of a method on every picture, sealed by a hash."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
import numpy.typing as npt
from pydantic import Field
from pydantic.dataclasses import dataclass

from ...factory.errors import FactoryError
from ...factory.files import write_atomically
from ...factory.settings import STRICT, build
from ...factory.small_files import one_line
from .folder import VERSION, Benchmark, Digest, Name, load_json, sealed
from .measure import METRICS, Figures

SCHEMA: Final = "simnfnd-benchmark-result/1"
ABOUT_MOST = 300
_SEAL = "sha256"

Column = tuple[float | None, ...]


@dataclass(frozen=True, config=STRICT)
class Made:
    """What a method is.  kind: the door by which it came.

    sha256: of its file.  parameters, levels: of a filter, by set.
    """

    kind: Literal["folder", "function", "onnx", "command", "weights", "baseline"]
    source: Annotated[str, Field(max_length=ABOUT_MOST)] = ""
    sha256: str = ""
    parameters: dict[str, dict[str, float]] | None = None
    levels: dict[str, dict[str, float]] | None = None


@dataclass(frozen=True, config=STRICT)
class SetResult:
    """Of every picture of a set, in its order.

    benchmark: digest of the set.  outputs: of the denoised pictures.  figures: None where a figure
    does not exist.  cpu_s: None where nobody knows.
    """

    benchmark: Digest
    outputs: tuple[Digest, ...]
    figures: dict[str, Column]
    cpu_s: Column

    def column(self, name: str) -> npt.NDArray[np.float64]:
        """(N,) of a figure, NaN where it does not exist."""
        known = self.figures.get(name, (None,) * len(self.outputs))
        return np.array([math.nan if one is None else one for one in known])

    @property
    def median_cpu_s(self) -> float | None:
        """The first picture loads and compiles, so the median."""
        known = [one for one in self.cpu_s if one is not None]
        return float(np.median(known)) if known else None


@dataclass(frozen=True, config=STRICT)
class Result:
    """A method's result.  about: one line by those who entered it."""

    schema: Literal["simnfnd-benchmark-result/1"]
    version: int
    name: Name
    about: Annotated[str, Field(max_length=ABOUT_MOST)]
    made_with: str
    method: Made
    sets: dict[Name, SetResult]

    @property
    def is_filter(self) -> bool:
        """Whether the best filter may be this one; the noisy pictures are none."""
        return self.method.kind == "baseline" and self.method.source != "identity"


def column_of(values: list[float]) -> Column:
    """Figures as JSON takes them."""
    return tuple(float(one) if math.isfinite(one) else None for one in values)


def columns_of(figures: list[Figures]) -> dict[str, Column]:
    """Figure -> its value of each picture."""
    names = [name for name in METRICS if any(name in one for one in figures)]
    return {name: column_of([one[name] for one in figures]) for name in names}


def write(benchmark: Benchmark, result: Result) -> Path:
    """Write a result file with its seal.  FactoryError when the folder cannot be written to."""
    path = path_of(benchmark, result.name)
    content = _plain(result)
    path.parent.mkdir(parents=True, exist_ok=True)
    text = json.dumps({**content, _SEAL: sealed(content)}, indent=1) + "\n"
    write_atomically(path, text.encode(), key="--benchmark")
    return path


def path_of(benchmark: Benchmark, name: str) -> Path:
    """Of the result file of a method."""
    return benchmark.results / f"{name}.json"


def read(path: Path, benchmark: Benchmark) -> Result:
    """A result file, which a stranger may have written.

    Raises FactoryError, one line, when its seal does not fit, or it is not of this benchmark.
    """
    content = load_json(path)
    seal = content.pop(_SEAL, None)
    if content.get("version") != VERSION:
        given = str(content.get("version"))[:20]
        raise FactoryError(
            f"{path}: of version {given} of the benchmark, this is {VERSION}; enter it again"
        )
    try:
        right = sealed(content)
    except ValueError:  # NaN
        right = None
    if seal is None or seal != right:
        raise FactoryError(
            f"{path}: its content is not what its hash says; it was changed or damaged, enter the "
            "method again"
        )
    try:
        found: Result = build(Result, content)
    except FactoryError as error:
        raise FactoryError(f"{path}: {one_line(error)}") from error
    if path.stem != found.name:
        raise FactoryError(f"{path}: is the result of {found.name}; call it {found.name}.json")
    _check(path, found, benchmark)
    return found


def read_all(benchmark: Benchmark) -> tuple[list[Result], list[str]]:
    """All results by name, and a line for each file that is refused."""
    found, refused = [], []
    for path in sorted(benchmark.results.glob("*.json")):
        try:
            found.append(read(path, benchmark))
        except FactoryError as error:
            refused.append(str(error))
    return found, refused


def _check(path: Path, result: Result, benchmark: Benchmark) -> None:
    known = {name: one for name, one in result.sets.items() if name in benchmark.sets}
    if not known:
        raise FactoryError(f"{path}: has none of the sets of this benchmark")
    for name, one in known.items():
        pictures = benchmark.sets[name]
        if one.benchmark != pictures.entry.digest:
            raise FactoryError(
                f"{path}: set {name} had other pictures (hash {one.benchmark[:12]}, here "
                f"{pictures.entry.digest[:12]}); enter the method again"
            )
        columns = [one.outputs, one.cpu_s, *one.figures.values()]
        if {len(column) for column in columns} != {len(pictures.pictures)}:
            raise FactoryError(f"{path}: set {name} has not one figure a picture")
        if not set(one.figures) <= set(METRICS):
            raise FactoryError(f"{path}: set {name} has figures that are not of this benchmark")


def _plain(result: Result) -> dict[str, Any]:
    """As JSON gives it back, so that the seal is over the same."""
    found: dict[str, Any] = json.loads(json.dumps(asdict(result)))
    return found


def digests(benchmark: Benchmark) -> Mapping[str, str]:
    """Set -> what its pictures are known by."""
    return {name: one.entry.digest for name, one in benchmark.sets.items()}
