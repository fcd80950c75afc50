"""The reader: a finished dataset as a sequence of samples."""

from __future__ import annotations

import operator
import sys
from bisect import bisect_right
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate
from pathlib import Path
from typing import Any, NamedTuple, SupportsIndex, cast

import numpy as np
import numpy.typing as npt

from ..common.array_types import Array, Float32s, Int64s
from ..common.errors import FactoryError
from ..common.seeds import stream
from .fan_geometry import FanGeometry, recorded_sonar
from .layout import config_of, image_axes, optional_layers
from .manifest import load_manifest
from .meaning import formation_of
from .reader import OpenShards, Split, check_in_isolation, listed_shards, reading
from .recordings import STATIC, WINDOW_FRAMES, DatasetRecordings, FrameSequence
from .schema import (
    CORE,
    EFFECT_FOLDER,
    REQUIRED_COLUMNS,
    VALUE_RANGES,
    Axis,
    Column,
    Pair,
)
from .schema import layers as known_layers
from .storage import local_folder

WINDOW = 16

Sample = dict[str, Array]


class Share(NamedTuple):
    """Every `processes`-th sample, from sample `number` on, where several processes share them."""

    number: int
    processes: int


def loader_share() -> Share:
    """The share of this worker of a torch DataLoader; all samples in any other process.

    Looks at torch where the program has loaded it, and never loads it.
    """
    torch_data = sys.modules.get("torch.utils.data")
    worker = torch_data.get_worker_info() if torch_data is not None else None
    return Share(0, 1) if worker is None else Share(worker.id, worker.num_workers)


@dataclass(frozen=True, eq=False)
class DatasetForm:
    """What all shards share, as the first one says it.

    layers, sizes: dtype and shape of the images of each layer, the core ones first.
    """

    layers: Mapping[str, np.dtype[Any]]
    sizes: Mapping[str, tuple[int, ...]]
    axes: tuple[Axis, Axis]
    columns: tuple[Column, ...]
    table: np.dtype[np.void]
    config: Mapping[str, Any]
    config_hash: str


@dataclass(frozen=True)
class SampleName:
    """One sample: row `row` of the shard at `path`, and what it is of."""

    path: Path
    row: int
    split: str
    location: str
    scene: str
    frame: str
    variant: int


class PairDataset:
    """Random access to the samples of one split, without a copy of the dataset in memory.

    `pairs[i]` is a dict of the asked layers, each (H, W).  `pairs[a:b]`, `pairs[[i, j, ...]]` and
    `pairs[mask]`, a mask being (len(pairs),) bool, have (N, H, W); N may be 0.  `pairs.pair(i)` is
    a `Pair` with its record.  Values are as stored: `value_range` is (0, 255) for uint8 and
    (0.0, 1.0) for float32 datasets; with `scaled=True` noisy and clean (and `layers/...`) are
    float32 in 0..1.

    Nothing is open until the first read, and then separately in each process, so the object can go
    through fork, spawn and pickling and into a torch DataLoader as it is.  `close()`, or leaving a
    `with` block, closes what this process has open.

    folder: of the dataset, or its URL on a storage (s3://bucket/folder), from where shards are
    fetched when they are needed (`factory.storage.copies`).
    layers: as `factory.dataset.schema` names them; None: all that the first shard has.
    manifest.json decides which shards count, at the moment of opening.
    trusted: False has another process open every shard first (a quarter of a second, and
    some milliseconds a shard), because a damaged file can make HDF5 crash or hang.

    Raises FactoryError: no dataset, an empty split, a shard that is absent or damaged.
    """

    def __init__(
        self,
        folder: str | Path,
        split: Split = "train",
        *,
        layers: Sequence[str] | None = ("noisy", "clean"),
        scaled: bool = False,
        trusted: bool = False,
    ) -> None:
        self.folder = local_folder(folder)
        self.split = split
        self.scaled = scaled
        known_layers("uint8", layers or ())
        if layers is not None and not 0 < len(set(layers)) == len(layers):
            raise FactoryError(f"layers={list(layers)}: name at least one, and none twice")
        manifest = load_manifest(self.folder)
        shard_infos = listed_shards(self.folder, split, manifest, follow_links=trusted)
        self.paths = tuple(shard_infos)
        if not trusted:
            check_in_isolation(self.paths)
        # The hash of the settings that made it, the last ones if it was extended.
        self.config_hash = manifest.config_hash if manifest else self.form.config_hash
        self._counts = [
            info.samples if info else _count(path) for path, info in shard_infos.items()
        ]
        self._ends = list(accumulate(self._counts))
        self._shards = OpenShards()
        self.layers = tuple(self.form.layers if layers is None else layers)

    def __len__(self) -> int:
        """Number of samples."""
        return self._ends[-1]

    def __getitem__(self, item: SupportsIndex | slice | Sequence[int] | npt.ArrayLike) -> Sample:
        """One sample, or several stacked.  Raises IndexError beyond the end."""
        if isinstance(item, slice):
            return self._stacked(range(len(self))[item])
        if isinstance(item, Sequence) or getattr(item, "ndim", 0) > 0:
            return self._stacked(sample_numbers(item, len(self)))
        path, row = self.place(cast(SupportsIndex, item))
        images = dict(zip(self.layers, self._shards.read(path, self.layers, row), strict=True))
        for name in images if self.scaled else ():
            if is_grey(name):
                images[name] = in_unit_range(images[name])
        return images

    def _stacked(self, numbers: Sequence[int]) -> Sample:
        samples = [self[number] for number in numbers]
        if samples:
            return {name: np.stack([sample[name] for sample in samples]) for name in self.layers}
        empty: Sample = {}
        for name in self.layers:
            dtype = self.form.layers.get(name)
            if dtype is None:
                raise FactoryError(f"{self.paths[0]}: has no layer {name}")
            dtype = np.dtype(np.float32) if self.scaled and is_grey(name) else dtype
            empty[name] = np.empty((0, *self.form.sizes[name]), dtype)
        return empty

    def pair(self, index: SupportsIndex) -> Pair:
        """One sample with its record, all as stored; `denoise` takes it as it is."""
        path, row = self.place(index)
        names = tuple(dict.fromkeys((*CORE, *self.layers)))
        images = dict(zip(names, self._shards.read(path, names, row), strict=True))
        with reading(path) as file:
            meta = file["meta"][row]
            config = config_of(file)
        record = {name: _plain(meta[name]) for name in meta.dtype.names}
        return Pair(
            **{name: images.pop(name) for name in CORE},
            record=record,
            layers=images,
            formation=formation_of(config),
            geometry=_geometry(config, record),
        )

    def __iter__(self) -> Iterator[Sample]:
        """All samples in order."""
        return (self[index] for index in range(len(self)))

    def shuffled(
        self,
        seed: int = 0,
        epoch: int = 0,
        *,
        window: int = WINDOW,
        share: Share | None = None,
    ) -> Iterator[Sample]:
        """All samples once, in a random order that `seed` and `epoch` give, for training.

        Shards come in random order, `window` of them at a time, and the samples of a window in
        random order, so that one at a URL is fetched once.
        share: (number, processes): every `processes`-th sample from that number on.  None: inside a
            worker of a torch DataLoader the share of that worker, so that no sample comes twice;
            elsewhere all.
        """
        places = [self.place(index)[0] for index in range(len(self))]
        number, processes = loader_share() if share is None else share
        order = mixed_order(places, stream(seed, "shuffled", epoch), window)
        for index in order[number::processes]:
            yield self[index]

    def place(self, index: SupportsIndex) -> tuple[Path, int]:
        """The shard that holds a sample, and its row there."""
        number = operator.index(index)
        if isinstance(index, bool | np.bool_) or not -len(self) <= number < len(self):
            raise IndexError(f"sample {index} of {len(self)}")
        number %= len(self)
        shard = bisect_right(self._ends, number)
        return self.paths[shard], number - self._ends[shard] + self._counts[shard]

    @cached_property
    def form(self) -> DatasetForm:
        """The form of the dataset, read from its first shard."""
        with reading(self.paths[0]) as file:
            table = file["meta"]
            columns = []
            about = {key: str(value) for key, value in table.attrs.items()}
            for name in table.dtype.names:
                texts = (
                    about.get(f"{name}.{attribute}", "") for attribute in ("units", "description")
                )
                columns.append(Column(name, table.dtype[name].str, *texts))
            names = (*CORE, *optional_layers(file))
            return DatasetForm(
                {name: file[name].dtype for name in names},
                {name: file[name].shape[1:] for name in names},
                image_axes(file["noisy"]),
                tuple(columns),
                table.dtype,
                config_of(file),
                str(file.attrs["config_hash"]),
            )

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W) of the images, those of the first shard."""
        rows, columns = self.axes
        return len(rows.values), len(columns.values)

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of noisy and clean as they are given out."""
        return np.dtype(np.float32) if self.scaled else self.form.layers["noisy"]

    @property
    def value_range(self) -> tuple[float, float]:
        """Values of noisy and clean, as given out, that stand for no echo and for full scale."""
        return VALUE_RANGES[str(self.dtype)]

    @property
    def axes(self) -> tuple[Axis, Axis]:
        """Row and column axes of the images."""
        return self.form.axes

    @property
    def layout(self) -> str:
        """Polar (range x azimuth) or fan."""
        return "polar" if self.axes[1].name == "azimuth" else "fan"

    @property
    def splits(self) -> dict[str, int]:
        """Split -> number of samples, of the splits that have any."""
        counts = Counter[str]()
        for path, count in zip(self.paths, self._counts, strict=True):
            counts[path.parent.name] += count
        return dict(counts)

    def meta(self) -> npt.NDArray[np.void]:
        """The sample table, one row per sample in the order of the samples; text is bytes (UTF-8).

        Reads the tables of all shards, never their images.
        """
        # Those at a URL are fetched on the way.
        with ThreadPoolExecutor() as pool:
            return np.concatenate(list(pool.map(self.table, self.paths)))

    def table(self, path: Path) -> npt.NDArray[np.void]:
        """The sample table of one shard.  Raises FactoryError when its form is not the first's."""
        with reading(path) as file:
            shape = file["noisy"].shape[1:]
            rows = np.asarray(file["meta"][()])
        if (shape, rows.dtype) != (self.shape, self.form.table):
            raise FactoryError(f"{path}: its sizes or columns differ from {self.paths[0]}'s")
        return rows

    def names(self) -> Iterator[SampleName]:
        """What every sample is of, in order."""
        for path in self.paths:
            for row, record in enumerate(self.table(path)):
                location, scene, frame, variant = (record[key] for key in REQUIRED_COLUMNS)
                texts = location.decode(), scene.decode(), frame.decode()
                yield SampleName(path, row, path.parent.name, *texts, int(variant))

    @cached_property
    def recordings(self) -> DatasetRecordings:
        """Its recordings: the frames of each scene in the order of time."""
        return DatasetRecordings(self)

    def sequence(self, recording: str) -> FrameSequence:
        """All frames of one recording, `location/scene`: (T, H, W) noisy, clean, static and more.

        Of the layers that this object was opened with, which must have noisy and clean.
        Raises FactoryError for a recording that is not there.
        """
        return self.recordings.sequence(recording)

    def windows(self, frames: int = WINDOW_FRAMES, step: int = 1) -> Iterator[FrameSequence]:
        """Every `step`-th window of this many frames of all recordings, none over a gap."""
        return self.recordings.windows(frames, step)

    def close(self) -> None:
        """Close the files that this process has open; reading again opens them again."""
        self._shards.close()

    def __enter__(self) -> PairDataset:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()


def in_unit_range(grey: Array) -> Float32s:
    """Stored grey values (uint8 in 0..255 or float32 in 0..1) as float32 in 0..1."""
    if grey.dtype == np.uint8:
        return grey.astype(np.float32) * np.float32(1 / 255)
    return grey.astype(np.float32, copy=False)


def sample_numbers(item: Any, count: int) -> list[int]:
    """The sample numbers that a list, array or mask means, as numpy's indices do.

    Raises IndexError for another shape or type, and for a mask of another length.
    """
    index = np.asarray(item)
    if index.ndim != 1:
        raise IndexError(f"an index of samples has one dimension, not {index.ndim}")
    if index.dtype == np.bool_:
        if len(index) != count:
            raise IndexError(f"a mask of {len(index)} for {count} samples")
        return [int(number) for number in np.flatnonzero(index)]
    if index.size and index.dtype.kind not in "iu":
        raise IndexError(f"samples are indexed by integers or booleans, not {index.dtype}")
    return [int(number) for number in index]


def is_grey(layer: str) -> bool:
    """Whether a layer holds grey values, which `scaled` turns into 0..1."""
    return layer in ("noisy", "clean", STATIC, "mean") or layer.startswith(EFFECT_FOLDER)


def _plain(value: Any) -> float | int | str:
    plain = value.item() if isinstance(value, np.generic) else value
    return plain.decode() if isinstance(plain, bytes) else plain


def _geometry(config: Mapping[str, Any], record: Mapping[str, Any]) -> FanGeometry | None:
    """Geometry of one image; None where another program wrote the dataset."""
    try:
        sonar = recorded_sonar(config)
        return None if sonar is None else FanGeometry.from_record(sonar, record)
    except (KeyError, ValueError):
        return None


def _count(path: Path) -> int:
    with reading(path) as file:
        return len(file["noisy"])


def mixed_order(places: Sequence[Path], rng: np.random.Generator, window: int = WINDOW) -> Int64s:
    """(N,) every sample once: shards in random order, the samples of `window` of them mixed.

    places: the shard of each sample.
    """
    numbers = {path: number for number, path in enumerate(dict.fromkeys(places))}
    rank = np.argsort(rng.permutation(len(numbers)))
    windows = rank[[numbers[path] for path in places]] // window
    # Random within each window: a key of its own for every sample.
    return np.asarray(np.lexsort((rng.random(len(windows)), windows)), np.int64)
