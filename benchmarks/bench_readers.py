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

from factory.config import FactoryConfig, from_mapping
from factory.pairs import make_pair, observe
from factory.record import columns, image_axes
from factory.sample import Pair
from factory.shards import PairDataset
from factory.shards.index import write_index
from factory.shards.manifest import Manifest, save_manifest
from factory.shards.schema import Provenance
from factory.shards.settings import DatasetSettings
from factory.shards.writer import write_shard

SHARDS, PER_SHARD, ROUNDS = 4, 60, 7
Compression = Literal["gzip", "zstd", "none"]
# Pairs a second that the project asks for on two cores.
WANTED = {"gzip": 350, "zstd": 1100, "none": 5000}


def main() -> None:
    """Print pairs a second for each compression, and for torch DataLoaders."""
    config = _config()
    pairs = list(_pairs(config))
    with tempfile.TemporaryDirectory() as folder:
        print("| compression | MB a pair | bare h5py | PairDataset | of bare | index.h5 | wanted |")
        print("|---|---:|---:|---:|---:|---:|---:|")
        for compression in ("gzip", "zstd", "none"):
            root = _dataset(Path(folder) / compression, pairs, config, compression)
            _compare(root, compression)
        print("\n| DataLoader, gzip | 1 worker | 2 workers | ratio |\n|---|---:|---:|---:|")
        one, two = (_loader(Path(folder) / "gzip", workers) for workers in (1, 2))
        print(f"| pairs a second, batches of 8 | {one:.0f} | {two:.0f} | {two / one:.2f} |")


def _config() -> FactoryConfig:
    picture = {"width_px": 512, "height_px": 512}
    return from_mapping(
        {
            "scenes": {"kind": "seabed"},
            "render": {"kind": "analytic"},
            "sonar": {"beams": 512, "range_bins": 512, "image": picture},
        }
    )


def _pairs(config: FactoryConfig) -> Iterator[Pair]:
    from factory.render import open_renderer
    from factory.scenes import open_reader

    reader, renderer = open_reader(config.scenes), open_renderer(config.render)
    for ref in reader.discover().frames[::6][:6]:
        frame = reader.load(ref)
        scene = observe(frame, renderer.render(frame, config.sonar.mount), config.sonar)
        yield from (make_pair(scene, variant, config) for variant in range(5))


def _dataset(
    root: Path, pairs: list[Pair], config: FactoryConfig, compression: Compression
) -> Path:
    manifest = Manifest("0" * 16, "benchmark")
    for shard in range(SHARDS):
        info = write_shard(
            root,
            f"train/shard-{shard:05d}.h5",
            (pairs[(shard + number) % len(pairs)] for number in range(PER_SHARD)),
            image_axes(config.sonar),
            columns(config.noise),
            Provenance({}, "0" * 16, "benchmark"),
            DatasetSettings(compression=compression),
        )
        assert info is not None
        manifest = manifest.with_shard(info)
    save_manifest(root, manifest)
    write_index(root, manifest)
    return root


def _compare(root: Path, compression: Compression) -> None:
    order = np.random.default_rng(0).permutation(SHARDS * PER_SHARD).tolist()
    # HDF5 opens a file once in a process, with the settings of whoever came first.
    copy = Path(shutil.copytree(root, root.with_name(f"{root.name}-copy")))
    files = [h5py.File(path) for path in sorted(copy.glob("train/*.h5"))]
    stacks = [(file["noisy"], file["clean"]) for file in files]
    index = h5py.File(copy / "index.h5")
    virtual = index["train/noisy"], index["train/clean"]

    def bare() -> None:
        for number in order:
            shard, row = divmod(number, PER_SHARD)
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

        best = _best([bare, ours, through_index], len(order))
    for file in (*files, index):
        file.close()
    size = sum(path.stat().st_size for path in root.glob("train/*.h5")) / len(order)
    bare_rate, our_rate, index_rate = best
    print(
        f"| {compression} | {size / 1e6:.2f} | {bare_rate:.0f} | {our_rate:.0f} "
        f"| {our_rate / bare_rate:.2f} | {index_rate:.0f} | {WANTED[compression]} |"
    )


def _best(readers: list[Callable[[], None]], count: int) -> list[float]:
    """Most pairs a second of each reader; they take turns."""
    best = [0.0] * len(readers)
    for _ in range(ROUNDS):
        for number, read in enumerate(readers):
            start = time.perf_counter()
            read()
            best[number] = max(best[number], count / (time.perf_counter() - start))
    return best


def _loader(root: Path, workers: int) -> float:
    """Pairs a second of whole epochs after the first, in which the workers start."""
    from torch.utils.data import DataLoader

    from models.data import Pairs

    loader = DataLoader(
        Pairs(root), 8, shuffle=True, num_workers=workers, persistent_workers=True, drop_last=True
    )
    best = 0.0
    for epoch in range(5):
        start = time.perf_counter()
        count = sum(len(batch["noisy"]) for batch in loader)
        if epoch:
            best = max(best, count / (time.perf_counter() - start))
    return best
