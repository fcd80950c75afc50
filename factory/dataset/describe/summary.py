"""What is in a dataset or in one of its files: for `simnfnd inspect`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
import numpy.typing as npt

from ...errors import FactoryError
from ..format.manifest import INDEX_NAME
from ..read.reader import check_in_isolation, reading
from ..read.source import Source, open_shards, open_source
from .preview import load, spread
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
    images = [load(one).images for one in spread(list(source.names()), pairs)]
    a_sample = sum(
        int(np.prod(source.sizes[name])) * dtype.itemsize for name, dtype in source.layers.items()
    )
    return DatasetSummary(
        source,
        schema,
        generator,
        compression,
        np.concatenate([rows for _, _, rows in tables]),
        np.concatenate([np.full(len(rows), split) for split, _, rows in tables]),
        sum(shard.stat().st_size for _, shard, _ in source.shards),
        a_sample * sum(source.splits.values()),
        np.array([psnr_db(one["clean"], one["noisy"]) for one in images]),
        np.array([ssim(one["clean"], one["noisy"]) for one in images]),
    )


def compression_of(stack: h5py.Dataset) -> str:
    """The filters of a dataset in words, for example `gzip 1, fletcher32`."""
    level = "" if stack.compression_opts is None else f" {stack.compression_opts}"
    names = [f"{stack.compression}{level}"] if stack.compression else []
    return ", ".join(names + ["fletcher32"] * bool(stack.fletcher32)) or "none"
