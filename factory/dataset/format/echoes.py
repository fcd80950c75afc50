"""`/echoes`: every echo behind a pair, in lists of any length.

One flat array a field, each in one piece; `/echoes/place` has the first echo of every sample and
the one after its last.  Samples of one frame that differ in noise alone share a list.  Within a
list bins ascend, so all echoes of a bin are one slice.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

from ...errors import FactoryError, FrameError
from .axes import dataset_inside, exists, object_inside
from .checksums import all_picture_sums, crc32
from .schema import ECHO_FIELDS, ECHO_FOLDER, MAX_PIXELS, Layer

PLACE = f"{ECHO_FOLDER}place"
_GRID = "grid"
_MOST_BYTES = 1 << 31
_FIELDS = {field.name: field for field in ECHO_FIELDS}
_LABELS = frozenset({"segmentation", "instance"})

Values = npt.NDArray[Any]


@dataclass(frozen=True, eq=False)
class EchoList:
    """The echoes behind one pair.

    grid: range bins and beams.  fields: name of `layers.ECHO_FIELDS` -> (N,) array; `bin`, which is
    range bin * beams + beam, ascends.
    """

    grid: tuple[int, int]
    fields: Mapping[str, Values]

    def __len__(self) -> int:
        """Number of echoes."""
        return len(self.fields["bin"])

    def __getitem__(self, name: str) -> Values:
        """(N,) values of a field.  Raises KeyError for labels of a frame without any."""
        return self.fields[name]

    def in_bin(self, range_bin: int, beam: int) -> slice:
        """Where the echoes of a bin are: `echoes["elevation"][echoes.in_bin(120, 40)]`."""
        if not (0 <= range_bin < self.grid[0] and 0 <= beam < self.grid[1]):
            raise IndexError(f"bin {range_bin}, {beam} of {self.grid[0]} x {self.grid[1]}")
        flat = range_bin * self.grid[1] + beam
        first, end = np.searchsorted(self.fields["bin"], [flat, flat + 1])
        return slice(int(first), int(end))


def write_echoes(file: h5py.File, lists: Sequence[EchoList]) -> dict[str, list[int]]:
    """Write /echoes; returns name of each field in the file -> `crc32` of each sample's values.

    Raises FrameError when the lists differ in form, FactoryError when they are too long for a file.
    """
    first = lists[0]
    fresh = [True, *(one is not before for before, one in pairwise(lists))]
    own = [one for one, new in zip(lists, fresh, strict=True) if new]
    if any((one.grid, set(one.fields)) != (first.grid, set(first.fields)) for one in lists):
        raise FrameError("echoes: its samples differ in grid or labels")
    known = [field for field in ECHO_FIELDS if field.name in first.fields]
    total = sum(map(len, own)) * sum(np.dtype(field.dtype).itemsize for field in known)
    if total > _MOST_BYTES:
        raise FactoryError(
            f"dataset.layers: echoes take {total / 1e9:.1f} GB of a shard, {_MOST_BYTES / 1e9:.1f} "
            "at most go; set scheduler.shard_size lower"
        )
    ends = np.cumsum([0, *map(len, own)])
    numbers = np.cumsum(fresh) - 1
    place = np.stack([ends[numbers], ends[numbers + 1]], axis=1).astype("<i8")
    file.create_dataset(PLACE, data=place, track_times=False)
    sums: dict[str, list[int]] = {}
    for field in known:
        values = np.concatenate([one[field.name] for one in own]).astype(field.dtype, copy=False)
        stored = file.create_dataset(f"{ECHO_FOLDER}{field.name}", data=values, track_times=False)
        stored.attrs["description"], stored.attrs["units"] = field.description, field.units
        if field.classes:
            stored.attrs["classes"] = list(field.classes)
        if field.name == "bin":
            stored.attrs[_GRID] = np.asarray(first.grid, "<i8")
        own_sums = [crc32(values[a:b]) for a, b in pairwise(ends.tolist())]
        sums[f"{ECHO_FOLDER}{field.name}"] = [own_sums[number] for number in numbers]
    return sums


def echo_names(file: h5py.File) -> tuple[str, ...]:
    """Names in the file of the fields that a shard has; none where it has no /echoes.

    Raises FactoryError when something else is there, or something is absent.
    """
    folder = ECHO_FOLDER.rstrip("/")
    if not exists(file, folder):
        return ()
    group = object_inside(file, folder)
    wanted = {*_FIELDS, "place"}
    found = set(group) if isinstance(group, h5py.Group) and len(group) <= len(wanted) else set()
    if found not in (wanted, wanted - _LABELS):
        raise FactoryError(f"/{folder} must hold {', '.join(_FIELDS)} and place; generate it again")
    return tuple(f"{ECHO_FOLDER}{name}" for name in _FIELDS if name in found)


def check_echoes(file: h5py.File, samples: int) -> None:
    """Raises FactoryError when the parts of /echoes do not fit the schema."""
    names = echo_names(file)
    if not names:
        return
    place = dataset_inside(file, PLACE)
    if place.shape != (samples, 2) or place.dtype != np.dtype("<i8"):
        raise FactoryError(f"/{PLACE} must be {samples} pairs of int64; generate it again")
    lists = {name: dataset_inside(file, name) for name in names}
    for name, values in lists.items():
        dtype = _FIELDS[name.removeprefix(ECHO_FOLDER)].dtype
        if values.ndim != 1 or values.dtype != np.dtype(dtype):
            raise FactoryError(f"/{name} must be a list of {dtype}; generate it again")
    lengths = {len(values) for values in lists.values()}
    first, end = place[()].T
    ordered = (first >= 0) & (first <= end) & (end <= min(lengths)) & (end - first <= MAX_PIXELS)
    if len(lengths) != 1 or not ordered.all():
        raise FactoryError("/echoes: lists of different lengths, or beyond their end")
    _grid(file)


def read_echoes(file: h5py.File, row: int) -> EchoList:
    """The list of one sample of a shard that was checked.

    Raises FactoryError where there is none, ValueError when it is damaged.
    """
    names = echo_names(file)
    if not names:
        raise FactoryError("has no echoes; make the dataset with echoes in dataset.layers")
    first, end = file[PLACE][row].tolist()
    fields: dict[str, Values] = {}
    sums = all_picture_sums(file)
    for name in names:
        values = file[name][first:end]
        if crc32(values) != sums[name][row]:
            raise ValueError(f"/{name}: its checksum differs")
        fields[name.removeprefix(ECHO_FOLDER)] = values
    return EchoList(_grid(file), fields)


def echo_problem(echoes: EchoList) -> str | None:
    """What is wrong with the values of a list."""
    bins = echoes["bin"]
    if bins.size and not (
        bins[0] >= 0
        and bins[-1] < echoes.grid[0] * echoes.grid[1]
        and (np.diff(bins.astype(np.int64)) >= 0).all()
    ):
        return "bin is not ascending, or beyond the grid"
    for name, values in echoes.fields.items():
        problem = _value_problem(values, _FIELDS[name])
        if problem:
            return f"{name} {problem}"
    return None


def _value_problem(values: Values, field: Layer) -> str | None:
    if not values.size:
        return None
    most = len(field.classes) - 1 if field.classes else field.most
    # Also false for NaN.
    good = values.min() >= field.least and values.max() <= np.float32(most)
    return None if good else f"has values outside {field.least:g}..{most:g}, or NaN"


def _grid(file: h5py.File) -> tuple[int, int]:
    grid: Any = file[f"{ECHO_FOLDER}bin"].attrs.get(_GRID)
    if not isinstance(grid, np.ndarray) or grid.shape != (2,) or grid.dtype.kind != "i":
        raise FactoryError("/echoes/bin does not say its range bins and beams")
    rows, beams = grid.tolist()
    if not 0 < rows * beams <= MAX_PIXELS or rows < 1:
        raise FactoryError(f"/echoes/bin claims {rows} x {beams} bins; generate it again")
    return rows, beams
