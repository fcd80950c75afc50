"""Finding and opening the shards of a finished dataset."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import h5py
import numpy as np

from factory.errors import FactoryError
from factory.shards.manifest import Manifest, load_manifest
from factory.shards.schema import SCHEMA, SPLITS

Split = Literal["train", "test", "all"]


def shard_paths(dataset: str | Path, split: Split) -> tuple[Path, ...]:
    """The shard files of one split, in the order of their names.

    `manifest.json` says which shards belong to the dataset; without one, every `*.h5` in the
    folders train/ and test/ does.  Raises FactoryError when the folder is no dataset, a listed
    shard is absent or the split is empty.
    """
    root = Path(dataset)
    if not root.is_dir():
        raise FactoryError(
            f"dataset={root}: no such folder; give one that `python -m factory` made"
        )
    manifest = load_manifest(root)
    found = {name: _of_split(root, name, manifest) for name in SPLITS}
    if not any(found.values()):
        raise FactoryError(f"dataset={root}: no shards in train/ or test/; is it a dataset folder?")
    wanted = SPLITS if split == "all" else (split,)
    paths = tuple(path for name in wanted for path in found[name])
    if not paths:
        other = next(name for name in SPLITS if found[name])
        raise FactoryError(
            f"dataset={root}: the {split} split is empty; it has {len(found[other])} shard(s) in "
            f"{other} (split={other})"
        )
    return paths


def open_shard(path: Path) -> h5py.File:
    """Open one shard for reading, after a look at whether it is one of ours.

    Raises FactoryError when the file is absent, damaged or of another schema.
    """
    try:
        file = h5py.File(path, "r")
    except FileNotFoundError as error:
        raise FactoryError(
            f"{path}: listed in the manifest but absent; generate it again"
        ) from error
    except OSError as error:
        raise FactoryError(f"{path}: not a readable HDF5 file; generate it again") from error
    problem = _problem(file)
    if problem:
        file.close()
        raise FactoryError(f"{path}: {problem}")
    return file


def value_range(file: h5py.File) -> float:
    """The value of full scale: 255 for uint8 shards, 1 for float32 ones."""
    return 255.0 if file["noisy"].dtype == np.uint8 else 1.0


def _of_split(root: Path, split: str, manifest: Manifest | None) -> list[Path]:
    if manifest is None:
        return sorted((root / split).glob("*.h5"))
    return [root / path for path, s in sorted(manifest.shards.items()) if s.split == split]


def _problem(file: h5py.File) -> str | None:
    """What keeps the shard from being used, or None."""
    schema = file.attrs.get("schema")
    if schema is None:
        return "no schema attribute; not a SimNFND shard"
    if schema != SCHEMA:
        return f"schema {schema!r}, but this program reads {SCHEMA!r}; use a matching release"
    for name in ("noisy", "clean", "shadow"):
        if not isinstance(file.get(name), h5py.Dataset):
            return f"dataset /{name} is absent; generate the shard again"
        if file[name].ndim != 3 or file[name].shape != file["noisy"].shape:
            return f"/{name} is {file[name].shape}, /noisy {file['noisy'].shape}; generate it again"
        if not _can_decompress(file[name]):
            return "compressed by a filter that is not installed: pip install 'simnfnd[zstd]'"
    if file["noisy"].dtype not in (np.uint8, np.float32):
        return f"/noisy is {file['noisy'].dtype}; expected uint8 or float32"
    return None


def _can_decompress(dataset: h5py.Dataset) -> bool:
    filters = dataset.id.get_create_plist()
    codes = [filters.get_filter(index)[0] for index in range(filters.get_nfilters())]
    if all(h5py.h5z.filter_avail(code) for code in codes):
        return True
    try:
        import hdf5plugin  # noqa: F401  (registers its filters; 186 MB, so only when needed)
    except ImportError:
        return False
    return all(h5py.h5z.filter_avail(code) for code in codes)
