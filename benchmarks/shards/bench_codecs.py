"""Shards per codec: CPU to write a pair of 512x512, its size, and CPU to read it back."""

from __future__ import annotations

import tempfile
from itertools import islice
from pathlib import Path

from benchmarks.report import Cell, Options, Section, Table
from benchmarks.shards.bench_readers import picture_config, procedural_pairs
from benchmarks.shared import PROVENANCE, clock
from simnfnd.factory.dataset import PairDataset
from simnfnd.factory.dataset.format.settings import DatasetSettings
from simnfnd.factory.dataset.write.writer import write_shard
from simnfnd.factory.sample_table.record import columns, image_axes

REPEATS = 5
CODECS = {
    "none": DatasetSettings(compression="none"),
    "gzip-1 (default)": DatasetSettings(),
    "gzip-6": DatasetSettings(compression_level=6),
    "lzf": DatasetSettings(compression="lzf"),
    "zstd-1": DatasetSettings(compression="zstd"),
}


def measure(options: Options) -> Section:
    """A row for each codec; the factory's own pairs, a shard of all of them."""
    config = picture_config()
    pairs = list(islice(procedural_pairs(config), options.amount(30, 3)))
    axes, names = image_axes(config.sonar), columns(config.noise, config.acoustics.formation)
    found: dict[str, tuple[float, float, float, float]] = {}
    for codec, settings in CODECS.items():
        with tempfile.TemporaryDirectory() as folder:
            root = Path(folder)

            def write(root: Path = root, settings: DatasetSettings = settings) -> None:
                write_shard(root, "train/shard-00000.h5", pairs, axes, names, PROVENANCE, settings)

            spent = clock(write, options.amount(REPEATS), len(pairs))
            with PairDataset(root, trusted=True) as dataset:

                def read(dataset: PairDataset = dataset) -> None:
                    for number in range(len(dataset)):
                        dataset[number]

                reading = clock(read, options.amount(REPEATS), len(pairs))
            size = (root / "train/shard-00000.h5").stat().st_size / len(pairs)
            found[codec] = (spent.cpu, spent.wall, size, reading.cpu)
    plain = found["none"]
    rows: tuple[tuple[Cell, ...], ...] = tuple(
        (
            codec,
            cpu / plain[0],
            size / plain[2],
            reading / plain[3],
            1e3 * cpu,
            1e3 * wall,
            size / 1e3,
            1e3 * reading,
        )
        for codec, (cpu, wall, size, reading) in found.items()
    )
    columns_ = (
        *("codec", "times the CPU of none", "of its size", "times its CPU to read"),
        *("write, CPU ms a pair", "write, wall ms", "kB a pair", "read, CPU ms"),
    )
    return Section((Table(columns_, rows, bars="write, CPU ms a pair"),))
