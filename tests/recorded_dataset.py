"""A small dataset of recordings, as `experiment=fish` makes them, cut into shards anywhere."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from simnfnd.factory.dataset.manifest import Manifest, save_manifest
from simnfnd.factory.dataset.schema import Axis, Column, Pair, Provenance, config_hash
from simnfnd.factory.dataset.settings import DatasetSettings
from simnfnd.factory.dataset.writer import write_shard

SIDE = 40
FRAMES = 8
SCENES = ("0", "1")
CONFIG: dict[str, Any] = {"scenes": {"kind": "seabed", "frame_rate_hz": 4.0}}
COLUMNS = (
    Column("location", "S8"),
    Column("scene", "S8"),
    Column("frame", "S8"),
    Column("variant", "i4"),
    Column("time_s", "f8"),
)


def recorded_pair(scene: str, frame: int) -> Pair:
    """A still ground under grain that is new in each frame."""
    rows, columns = np.indices((SIDE, SIDE))
    clean = (100 + 50 * np.sin(rows / (3 + int(scene))) * np.cos(columns / 5)).astype(np.uint8)
    grain = np.random.default_rng([int(scene), frame]).normal(0, 15, clean.shape)
    noisy = np.clip(clean + grain, 0, 255).astype(np.uint8)
    record: dict[str, float | int | str] = {
        "location": "sea",
        "scene": scene,
        "frame": f"{frame:04d}",
        "variant": 0,
        "time_s": frame / 4,
    }
    return Pair(noisy, clean, np.zeros((SIDE, SIDE), np.bool_), record)


def write_recordings(folder: Path, shard_size: int = FRAMES) -> Path:
    """Two recordings in shards of so many frames."""
    provenance = Provenance(CONFIG, config_hash(CONFIG), "test")
    manifest = Manifest(provenance.config_hash, provenance.generator, CONFIG)
    pairs = [recorded_pair(scene, frame) for scene in SCENES for frame in range(FRAMES)]
    axes = tuple(Axis(name, "m", np.arange(SIDE, dtype=float)) for name in ("range", "across"))
    for number in range(0, len(pairs), shard_size):
        place = f"train/shard-{number // shard_size:05d}.h5"
        some = pairs[number : number + shard_size]
        info = write_shard(
            folder, place, some, (axes[0], axes[1]), COLUMNS, provenance, DatasetSettings()
        )
        assert info is not None
        manifest = manifest.with_shard(info)
    save_manifest(folder, manifest)
    return folder
