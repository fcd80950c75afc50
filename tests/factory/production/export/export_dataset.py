"""Little datasets of random images, of every form that an export must carry."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from simnfnd.factory.dataset.manifest import Manifest, save_manifest
from simnfnd.factory.dataset.schema import Axis, Column, Pair, Provenance, config_hash
from simnfnd.factory.dataset.settings import DatasetSettings
from simnfnd.factory.dataset.writer import write_shard

SHAPE = (20, 16)
COUNTS = {"train": (5, 4), "test": (3,)}
CONFIG: Mapping[str, Any] = {
    "seed": 3,
    "scenes": {"kind": "seabed", "locations": 4},
    "sonar": {"frequency_khz": 1200.0, "projection": "slant_range"},
    "noise": {"background": {"density": {"uniform": [0.1, 0.5]}}},
}
COLUMNS = (
    Column("location", "S24"),
    Column("scene", "S24"),
    Column("frame", "S24"),
    Column("variant", "i4", "1", "number of the noise draw"),
    Column("range_min_m", "f8", "m"),
    Column("range_max_m", "f8", "m"),
    Column("noise.background.density", "f8", "1", "fraction of the scene points"),
    Column("noise.range_spreading.mode", "S16"),
)


ROWS, COLUMNS_PX = (np.arange(size) + 0.5 for size in SHAPE)
AXES = Axis("ahead", "px", ROWS), Axis("right", "px", COLUMNS_PX - SHAPE[1] / 2)


def pair(rng: np.random.Generator, names: tuple[str, str, str], dtype: str, labels: bool) -> Pair:
    noisy, clean = (
        rng.integers(0, 256, SHAPE, dtype=np.uint8)
        if dtype == "uint8"
        else rng.random(SHAPE, dtype=np.float32)
        for _ in range(2)
    )
    record: dict[str, Any] = dict(zip(("location", "scene", "frame"), names, strict=True)) | {
        "variant": 0,
        "range_min_m": 1.5,
        "range_max_m": float(rng.uniform(4, 9)),
        "noise.background.density": float(rng.uniform(0.1, 0.5)),
        "noise.range_spreading.mode": "",
    }
    if rng.random() < 0.3:
        record["noise.background.density"] = float("nan")
    layers: dict[str, Any] = {}
    if labels:
        range_m = rng.random(SHAPE, dtype=np.float32)
        range_m[0, 0] = np.nan
        layers = {
            "range": range_m,
            "segmentation": rng.integers(0, 21, SHAPE, dtype=np.uint8),
            "instance": rng.integers(0, 2000, SHAPE, dtype=np.uint16),
        }
    return Pair(noisy, clean, rng.random(SHAPE) < 0.3, record, layers)


def write(
    root: Path,
    *,
    dtype: str = "uint8",
    labels: bool = False,
    seed: int = 3,
    place: str = "reef",
    licence: str | None = "CC-BY-4.0",
    config: Mapping[str, Any] = CONFIG,
) -> Path:
    """A dataset folder: nine train samples in two shards and three test samples, scenes apart."""
    rng = np.random.default_rng(seed)
    config = {**config, "seed": seed}
    provenance = Provenance(config, config_hash(config), "simnfnd 0.1.0")
    settings = DatasetSettings(
        name="little", licence=licence, dtype="float32" if dtype == "float32" else "uint8"
    )
    manifest = Manifest(provenance.config_hash, provenance.generator, config)
    for split, counts in COUNTS.items():
        for number, count in enumerate(counts):
            pairs = [
                pair(rng, (place, f"{place}-{split}", f"{number}.{k:03d}"), dtype, labels)
                for k in range(count)
            ]
            path = f"{split}/shard-{number:05d}.h5"
            info = write_shard(root, path, pairs, AXES, COLUMNS, provenance, settings)
            assert info is not None
            manifest = manifest.with_shard(info)
    save_manifest(root, manifest)
    block = {"name": settings.name, "licence": licence, "dtype": dtype}
    (root / "config.yaml").write_text(yaml.safe_dump({**config, "dataset": block}))
    return root
