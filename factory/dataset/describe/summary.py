"""What is in a dataset or in one of its files: for `simnfnd inspect`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

from ...errors import FactoryError
from ..format.manifest import INDEX_NAME
from ..read.image_stack import ImageStack
from ..read.reader import check_in_isolation, reading
from ..read.source import Source, open_shards, open_source, read_image
from .quality import psnr_db, ssim


@dataclass(frozen=True, eq=False)
class DatasetSummary:
    """Figures about a dataset.

    schema, generator: as the first shard states them.
    table: (samples,) structured array, the rows of /meta of all shards.
    splits: (samples,) the split of each row.
    stored_bytes: of all files.  image_bytes: of the images without compression.
    psnr_db, ssim: noisy against clean, of `measured` samples spread evenly.
    """

    source: Source
    schema: str
    generator: str
    compression: str
    table: npt.NDArray[np.void]
    splits: npt.NDArray[np.str_]
    stored_bytes: int
    image_bytes: int
    psnr_db: npt.NDArray[np.float64]
    ssim: npt.NDArray[np.float64]

    def numbers(self, name: str) -> npt.NDArray[np.float64]:
        """The finite values of one numeric column."""
        values = self.table[name].astype(np.float64)
        return np.asarray(values[np.isfinite(values)])


def summarize(path: Path, pairs: int = 200) -> DatasetSummary:
    """Read a dataset folder, its index.h5 or one shard; `pairs` images at most are decoded.

    Raises FactoryError when there is nothing of the kind, or a file is damaged.
    """
    if pairs < 1:
        raise FactoryError(f"--pairs must be at least 1, got {pairs}")
    if path.is_file() and path.name != INDEX_NAME:
        check_in_isolation((path,))
        source = open_shards(path.parent, (path,))
    elif not path.exists():
        raise FactoryError(f"{path}: no such file or folder; give a dataset or one of its shards")
    else:
        source = open_source(path.parent if path.is_file() else path, "all")
    tables = list(source.tables())
    with reading(source.shards[0][1]) as file:
        schema, generator = str(file.attrs["schema"]), str(file.attrs["generator"])
        compression = compression_of(file["noisy"])
    a_sample = sum(
        int(np.prod(source.sizes[name])) * dtype.itemsize for name, dtype in source.layers.items()
    )
    psnr, similarity = _quality(source, pairs)
    return DatasetSummary(
        source,
        schema,
        generator,
        compression,
        np.concatenate([rows for _, _, rows in tables]),
        np.concatenate([np.full(len(rows), split) for split, _, rows in tables]),
        sum(shard.stat().st_size for _, shard, _ in source.shards),
        a_sample * sum(source.splits.values()),
        psnr,
        similarity,
    )


def compression_of(stack: h5py.Dataset) -> str:
    """The filters of a dataset in words, for example `gzip 1, fletcher32`."""
    filters = stack.id.get_create_plist()
    names = []
    for number in range(filters.get_nfilters()):
        code, _, values, name = filters.get_filter(number)
        known = {
            h5py.h5z.FILTER_DEFLATE: f"gzip {values[0] if values else ''}".strip(),
            h5py.h5z.FILTER_FLETCHER32: "fletcher32",
            h5py.h5z.FILTER_SHUFFLE: "shuffle",
            32000: "lzf",
            32015: "zstd",
        }
        names.append(known.get(code) or name.decode() or f"filter {code}")
    return ", ".join(names) or "none"


def _quality(source: Source, pairs: int) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """PSNR and SSIM of at most `pairs` samples, as evenly over all of them as can be."""
    total = sum(samples for _, _, samples in source.shards)
    count = min(pairs, total)
    chosen = {(2 * k + 1) * total // (2 * count) for k in range(count)}
    psnr: list[float] = []
    similarity: list[float] = []
    first = 0
    for _, shard, samples in source.shards:
        with reading(shard) as file:
            stacks = {name: ImageStack(file[name]) for name in ("noisy", "clean")}
            for row in sorted(number - first for number in chosen if 0 <= number - first < samples):
                noisy, clean = (read_image(stack, name, row) for name, stack in stacks.items())
                psnr.append(psnr_db(clean, noisy))
                similarity.append(ssim(clean, noisy))
        first += samples
    return np.asarray(psnr), np.asarray(similarity)
