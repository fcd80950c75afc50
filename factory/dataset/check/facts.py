"""What validation reads out of one shard or index; runs in an isolated process.

HDF5 is a large C library, and a damaged file can make it crash, hang or ask for all memory there
is.  So `validate` calls nothing here itself, only in a process that may die of it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import h5py
import numpy as np
import numpy.typing as npt

from ...errors import FactoryError
from ..format.axes import image_axes
from ..format.echoes import echo_names, echo_problem, read_echoes
from ..format.layers import Layer, layers, stores_grey
from ..format.layout import optional_layers
from ..format.links import object_inside
from ..format.schema import SPLITS, VALUE_RANGES
from ..read.image_stack import ImageStack
from ..read.reader import read_attributes, reading

# A table that is wrong in every row is reported a few times, not a thousand times.
_MOST_PROBLEMS = 8

SampleKey = tuple[bytes, bytes, bytes, int]


@dataclass(frozen=True)
class ShardFacts:
    """What a shard says of itself.

    form: what all shards of a dataset share, as text.  samples: (location, scene, frame, variant)
    of each row.  noisy, clean: digests of the pictures of each row, when they were read.
    """

    problems: tuple[str, ...]
    config_hash: str = ""
    split: str = ""
    form: str = ""
    samples: tuple[SampleKey, ...] = ()
    noisy: tuple[bytes, ...] = ()
    clean: tuple[bytes, ...] = ()
    notes: tuple[str, ...] = field(default=())


def shard_facts(path: Path, deep: bool) -> ShardFacts:
    """Check one shard; `deep` reads every picture."""
    try:
        with reading(path) as file:
            return _facts(file, deep)
    except FactoryError as error:
        return ShardFacts((str(error).removeprefix(f"{path}: "),))


def _facts(file: h5py.File, deep: bool) -> ShardFacts:
    noisy = file["noisy"]
    known = layers(str(noisy.dtype), optional_layers(file))
    sizes = [f"{layer.name} {file[layer.name].shape[1:]}" for layer in known if layer.of_camera]
    table = file["meta"][()]
    axes = [(axis.name, axis.units) for axis in image_axes(noisy)]
    read_attributes(file)
    problems = _table_problems(table)
    listed = echo_names(file)
    digests: dict[str, list[bytes]] = {"noisy": [], "clean": []}
    empty = 0
    if deep:
        stacks = {layer: ImageStack(file[layer.name]) for layer in known}
        for row in range(len(table)):
            for layer, stack in stacks.items():
                try:
                    picture = stack[row]
                except (OSError, RuntimeError, ValueError) as error:
                    problems.append(f"sample {row}: /{layer.name} is damaged ({_short(error)})")
                    continue
                problem = _picture_problem(picture, layer)
                if problem:
                    problems.append(f"sample {row}: /{layer.name} {problem}")
                if layer.name in digests:
                    content = hashlib.blake2b(picture.tobytes(), digest_size=16).digest()
                    digests[layer.name].append(content)
                    empty += not picture.any()
            if listed and (problem := _echo_problem(file, row)):
                problems.append(f"sample {row}: /echoes: {problem}")
            if len(problems) >= _MOST_PROBLEMS:
                break
    return ShardFacts(
        problems=tuple(problems[:_MOST_PROBLEMS]),
        config_hash=str(file.attrs["config_hash"])[:200],
        split=str(file.attrs["split"]),
        form=f"{' '.join((str(noisy.shape[1:]), *sizes))} {noisy.dtype}, "
        f"layers {', '.join((*(layer.name for layer in known), *listed))}, "
        f"axes {axes}, columns {', '.join(table.dtype.names)}"[:4000],
        samples=tuple(
            (row["location"], row["scene"], row["frame"], int(row["variant"])) for row in table
        ),
        noisy=tuple(digests["noisy"]),
        clean=tuple(digests["clean"]),
        notes=(f"{empty} noisy or clean pictures without any echo",) if empty else (),
    )


def _echo_problem(file: h5py.File, row: int) -> str | None:
    try:
        return echo_problem(read_echoes(file, row))
    except (OSError, RuntimeError, ValueError) as error:
        return f"is damaged ({_short(error)})"


def _table_problems(table: npt.NDArray[np.void]) -> list[str]:
    problems = []
    for name in table.dtype.names or ():
        values = table[name]
        if values.dtype.kind == "f" and np.isinf(values).any():
            problems.append(f"/meta: column {name} has infinite values")
    return problems


def _picture_problem(picture: npt.NDArray[np.generic], layer: Layer) -> str | None:
    """What is wrong with the values of one picture."""
    if layer.classes and picture.max() >= len(layer.classes):
        return f"has class {picture.max()}; the schema knows {len(layer.classes)}"
    if picture.dtype.kind == "b" and not np.isin(picture.view(np.uint8), (0, 1)).all():
        return "has values that are neither true nor false"
    if picture.dtype.kind == "c":
        return None if np.isfinite(picture).all() else "has NaN or infinite values"
    if picture.dtype.kind != "f":
        return None
    if stores_grey(layer):
        low, high = VALUE_RANGES[str(picture.dtype)]
        # Also false for NaN, which compares as neither.
        good = picture.min() >= low and picture.max() <= high
        return None if good else f"has values outside {low:g}..{high:g}, or NaN"
    least, most = layer.least, np.float32(layer.most)
    known = picture[~np.isnan(picture)]
    if known.size and not (
        known.min() >= least and known.max() <= most and np.isfinite(known).all()
    ):
        return f"has values outside {least:g}..{most:g}"
    return None


def index_problems(
    path: Path, expected: Mapping[str, Sequence[tuple[str, int]]]
) -> tuple[str, ...]:
    """What is wrong with index.h5; its virtual datasets are never read.

    expected: split -> (path, samples) of its shards, in order.
    """
    try:
        with h5py.File(path, "r") as file:
            return tuple(_problems_of(file, expected))
    except FactoryError as error:
        return (str(error),)
    except (ArithmeticError, LookupError, OSError, RuntimeError, TypeError, ValueError) as error:
        # HDF5 reports damage of its own tables as almost any exception.
        return (f"damaged ({type(error).__name__}: {_short(error)})",)


def _problems_of(file: h5py.File, expected: Mapping[str, Sequence[tuple[str, int]]]) -> list[str]:
    wanted = {split for split in SPLITS if expected.get(split)}
    odd = sorted(set(file) ^ (wanted | {"axes"}))
    problems = [f"/{name[:60]} should not be there, or is absent" for name in odd]
    for split in sorted(wanted & set(file)):
        for name in _datasets(object_inside(file, split)):
            found = object_inside(file, f"{split}/{name}")
            if not isinstance(found, h5py.Dataset):
                problems.append(f"/{split}/{name} is no dataset")
            elif not found.is_virtual:
                problems.append(f"/{split}/{name} is no virtual dataset")
            elif _mapped(found) != _wanted(name, expected[split]):
                problems.append(
                    f"/{split}/{name} does not show the shards of the manifest, all of them, in "
                    "order and from inside the folder"
                )
    return problems


def _datasets(group: h5py.Group) -> list[str]:
    """Names of the datasets that a split has, at least those that it must have."""
    if not isinstance(group, h5py.Group):
        raise FactoryError("a split is no group")
    names = {"noisy", "clean", "shadow", "meta", *group} - {"layers"}
    if "layers" in group:
        names |= {f"layers/{name}" for name in object_inside(group, "layers")}
    return sorted(names)


def _mapped(dataset: h5py.Dataset) -> list[tuple[str, str, int, int]]:
    """(file, dataset, first row, rows) of every source; anything but whole rows is odd: -1."""
    found = []
    for source in dataset.virtual_sources():
        (first, *low), (last, *high) = source.vspace.get_select_bounds()
        rows = last - first + 1
        per_row = int(np.prod(dataset.shape[1:], dtype=np.int64))
        whole = (
            low == [0] * len(low)
            and high == [size - 1 for size in dataset.shape[1:]]
            and source.vspace.get_select_npoints() == rows * per_row
            and source.src_space.get_select_type() == h5py.h5s.SEL_ALL
        )
        found.append((source.file_name, source.dset_name, first, rows if whole else -1))
    if dataset.shape[0] != sum(rows for *_, rows in found):
        return []
    return found


def _wanted(name: str, shards: Sequence[tuple[str, int]]) -> list[tuple[str, str, int, int]]:
    wanted, first = [], 0
    for path, samples in shards:
        wanted.append((path, name, first, samples))
        first += samples
    return wanted


def _short(error: Exception) -> str:
    return " ".join(str(error).split())[:160]
