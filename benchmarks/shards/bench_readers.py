"""Shuffled reading of 512 x 512 pairs: `PairDataset` beside bare h5py on the same files.

The pairs are the factory's own (procedural scenes, the noise of experiment=simnfnd); the files are
in the page cache.  Bare h5py holds file and datasets open and indexes them; rounds of both take
turns, and the best of each counts, because other work on the machine can only slow them down.
"""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Literal

import h5py
import numpy as np

from benchmarks.report import Cell, Options, Section, Table
from benchmarks.shared import PROVENANCE
from simnfnd.factory.config import FactoryConfig, from_mapping
from simnfnd.factory.dataset import PairDataset
from simnfnd.factory.dataset.format.manifest import Manifest, save_manifest
from simnfnd.factory.dataset.format.sample import Pair
from simnfnd.factory.dataset.format.settings import DatasetSettings
from simnfnd.factory.dataset.write.index import write_index
from simnfnd.factory.dataset.write.writer import write_shard
from simnfnd.factory.pairs import make_pair, observe
from simnfnd.factory.sample_table.record import columns, image_axes

SHARDS, PER_SHARD, ROUNDS = 4, 60, 7
Compression = Literal["gzip", "zstd", "none"]
# Pairs a second that the project asks for on two cores.
WANTED = {"gzip": 350, "zstd": 1100, "none": 5000}


def measure(options: Options) -> Section:
    """Pairs a second for each compression, and for torch DataLoaders."""
    config = picture_config()
    pairs = list(procedural_pairs(config))
    amounts = options.amount(PER_SHARD, 3), options.amount(ROUNDS)
    rows: list[tuple[Cell, ...]] = []
    with tempfile.TemporaryDirectory() as folder:
        for compression in ("gzip", "zstd", "none"):
            root = _dataset(Path(folder) / compression, pairs, config, compression, amounts[0])
            rows.append(_compare(root, compression, *amounts))
        one, two = (
            _loader(Path(folder) / "gzip", workers, options.amount(5, 2)) for workers in (1, 2)
        )
    columns = ("compression", "of bare h5py", "PairDataset, pairs/s", "bare h5py", "index.h5")
    table = Table((*columns, "wanted", "MB a pair"), tuple(rows), bars=columns[2])
    loaders = Table(
        ("DataLoader, gzip, batches of 8", "times one worker", "pairs/s"),
        (("1 worker", 1.0, one), ("2 workers", two / one, two)),
    )
    return Section((table, loaders))


def picture_config() -> FactoryConfig:
    """Pictures of 512x512 of procedural scenes."""
    picture = {"width_px": 512, "height_px": 512}
    return from_mapping(
        {
            "scenes": {"kind": "seabed"},
            "render": {"kind": "analytic"},
            "sonar": {"beams": 512, "range_bins": 512, "image": picture},
        }
    )


def procedural_pairs(config: FactoryConfig) -> Iterator[Pair]:
    """Thirty pairs: five variants of each of six frames."""
    from simnfnd.factory.render import open_renderer
    from simnfnd.factory.scenes import open_reader

    reader, renderer = open_reader(config.scenes), open_renderer(config.render)
    for ref in reader.discover().frames[::6][:6]:
        frame = reader.load(ref)
        scene = observe(frame, renderer.render(frame, config.sonar.mount), config)
        yield from (make_pair(scene, variant, config) for variant in range(5))


def _dataset(
    root: Path,
    pairs: list[Pair],
    config: FactoryConfig,
    compression: Compression,
    per_shard: int,
) -> Path:
    manifest = Manifest("0" * 16, "benchmark")
    for shard in range(SHARDS):
        info = write_shard(
            root,
            f"train/shard-{shard:05d}.h5",
            (pairs[(shard + number) % len(pairs)] for number in range(per_shard)),
            image_axes(config.sonar),
            columns(config.noise, config.acoustics.formation),
            PROVENANCE,
            DatasetSettings(compression=compression),
        )
        assert info is not None
        manifest = manifest.with_shard(info)
    save_manifest(root, manifest)
    write_index(root, manifest)
    return root


def _compare(root: Path, compression: Compression, per_shard: int, rounds: int) -> tuple[Cell, ...]:
    order = np.random.default_rng(0).permutation(SHARDS * per_shard).tolist()
    # HDF5 opens a file once in a process, with the settings of whoever came first.
    copy = Path(shutil.copytree(root, root.with_name(f"{root.name}-copy")))
    files = [h5py.File(path) for path in sorted(copy.glob("train/*.h5"))]
    stacks = [(file["noisy"], file["clean"]) for file in files]
    index = h5py.File(copy / "index.h5")
    virtual = index["train/noisy"], index["train/clean"]

    def bare() -> None:
        for number in order:
            shard, row = divmod(number, per_shard)
            noisy, clean = stacks[shard]
            noisy[row], clean[row]

    def through_index() -> None:
        noisy, clean = virtual
        for number in order:
            noisy[number], clean[number]

    with PairDataset(root) as pairs:

        def ours() -> None:
            for number in order:
                pairs[number]

        best = _best([bare, ours, through_index], len(order), rounds)
    for file in (*files, index):
        file.close()
    size = sum(path.stat().st_size for path in root.glob("train/*.h5")) / len(order)
    bare_rate, our_rate, index_rate = best
    wanted = WANTED[compression]
    return (compression, our_rate / bare_rate, our_rate, bare_rate, index_rate, wanted, size / 1e6)


def _best(readers: list[Callable[[], None]], count: int, rounds: int) -> list[float]:
    """Most pairs a second of each reader; they take turns."""
    best = [0.0] * len(readers)
    for _ in range(rounds):
        for number, read in enumerate(readers):
            start = time.perf_counter()
            read()
            best[number] = max(best[number], count / (time.perf_counter() - start))
    return best


def _loader(root: Path, workers: int, epochs: int) -> float:
    """Pairs a second of whole epochs after the first, in which the workers start."""
    from torch.utils.data import DataLoader

    from simnfnd.models.data.pairs import Pairs

    loader = DataLoader(
        Pairs(root), 8, shuffle=True, num_workers=workers, persistent_workers=True, drop_last=True
    )
    best = 0.0
    for epoch in range(epochs):
        start = time.perf_counter()
        count = sum(len(batch["noisy"]) for batch in loader)
        if epoch:
            best = max(best, count / (time.perf_counter() - start))
    return best
