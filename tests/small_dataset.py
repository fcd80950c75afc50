"""Small synthetic datasets of fan-like pairs for the tests of evaluation and models."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from scipy import ndimage

from simnfnd.factory.common.array_types import Bools, Float32s
from simnfnd.factory.common.files import sha256_of
from simnfnd.factory.dataset.manifest import Manifest, ShardInfo, save_manifest
from simnfnd.factory.dataset.schema import Axis, Column, Pair, Provenance, config_hash
from simnfnd.factory.dataset.settings import DatasetSettings
from simnfnd.factory.dataset.writer import write_shard

COLUMNS = (
    Column("location", "S16"),
    Column("scene", "S16"),
    Column("frame", "S16"),
    Column("variant", "i4"),
)
PROVENANCE = Provenance({"made": "by a test", "noise": {}}, "0123abcd", "tests")


def fan_mask(size: int) -> Bools:
    """(size, size) bool sector with its apex below the image."""
    rows, columns = np.mgrid[0:size, 0:size]
    up = size * 1.05 - rows
    right = columns - (size - 1) / 2
    inside = np.hypot(up, right) < size * 1.05
    return np.asarray(inside & (np.abs(np.arctan2(right, up)) < np.deg2rad(28)))


def fan_images(
    size: int, rng: np.random.Generator, noise: float = 0.25
) -> tuple[Float32s, Float32s, Bools]:
    """(noisy, clean, shadow): smooth seabed with black shadows, and haze plus scatter over it."""
    sector = fan_mask(size)
    ground = ndimage.gaussian_filter(rng.normal(size=(size, size)), size / 24)
    ground = 0.45 + 0.2 * ground / ground.std()
    dark = ndimage.gaussian_filter(rng.normal(size=(size, size)), size / 12)
    shadow = sector & (dark > np.quantile(dark, 0.75))
    clean = np.where(sector & ~shadow, np.clip(ground, 0.05, 1), 0)
    haze = np.abs(rng.normal(0, noise, clean.shape)) + 0.1
    noisy = np.where(sector, np.clip(clean + haze, 0, 1), 0)
    return noisy.astype(np.float32), clean.astype(np.float32), shadow


def write_dataset(
    root: Path,
    *,
    train: int = 8,
    test: int = 4,
    size: int = 64,
    per_shard: int = 4,
    noise: float = 0.25,
    dtype: str = "uint8",
) -> Path:
    """A dataset folder as the factory leaves it; two variants a frame, four frames a scene."""
    rng = np.random.default_rng(7)
    for split, count in (("train", train), ("test", test)):
        for first in range(0, count, per_shard):
            pairs = []
            for number in range(first, min(first + per_shard, count)):
                frame = number // 2
                record: dict[str, float | int | str] = {
                    "location": "test",
                    "scene": f"{split}-{frame // 4}",
                    "frame": f"{frame:04d}",
                    "variant": number % 2,
                }
                pairs.append(Pair(*fan_images(size, rng, noise), record))
            add_shard(root, f"{split}/shard-{first // per_shard:05d}.h5", pairs, dtype=dtype)
    return root


def add_shard(
    root: Path,
    relative: str,
    pairs: Iterable[Pair],
    *,
    dtype: str = "uint8",
    layers: tuple[str, ...] = (),
) -> None:
    """Write one shard and nothing else: a dataset without a manifest is a dataset, too."""
    pairs = list(pairs)
    axes = tuple(
        Axis(name, "m", np.arange(count, dtype=float))
        for name, count in zip(("range", "across"), pairs[0].noisy.shape, strict=True)
    )
    settings = DatasetSettings(dtype="float32" if dtype == "float32" else "uint8", layers=layers)
    info = write_shard(root, relative, pairs, (axes[0], axes[1]), COLUMNS, PROVENANCE, settings)
    assert info is not None


def write_manifest(root: Path, *relative: str) -> None:
    """A manifest that lists only these shards."""
    manifest = Manifest(config_hash({}), "tests")
    for path in relative:
        size = (root / path).stat().st_size
        checksum = sha256_of(root / path)
        manifest = manifest.with_shard(ShardInfo(path, path.split("/")[0], 1, size, checksum))
    save_manifest(root, manifest)
