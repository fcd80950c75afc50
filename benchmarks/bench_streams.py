"""Pairs a second from many shards at a URL, shuffled, against the same in a folder; and memory.

The S3 server runs on this machine, on Python, and takes part of its CPU time; what is asked for
and how often is what counts on any storage.
"""

from __future__ import annotations

import os
import shutil
import tempfile
import time
from collections.abc import Iterable, Sized
from itertools import islice
from pathlib import Path

import h5py
import numpy as np
import psutil

from benchmarks.report import Cell, Options, Section, Table
from benchmarks.shared import in_own_process
from simnfnd.factory.dataset import PairDataset
from simnfnd.factory.dataset.format.manifest import Manifest, ShardInfo, save_manifest
from simnfnd.factory.files import sha256_of
from simnfnd.factory.storage.store import Store
from tests.cloud_storage import s3_server
from tests.factory.dataset.hostile import whole

SHARD = "train/shard-00000.h5"
SHARDS, PAIRS, FEW = 10_000, 10_000, 300
WINDOW = 16
KEPT_SHARDS = 3 * WINDOW


def measure(options: Options) -> Section:
    """One shard under many names: what is read differs in nothing but its place."""
    shards, most = options.amount(SHARDS, 20), options.amount(PAIRS, 60)
    rows: list[tuple[Cell, ...]] = []
    bad: list[str] = []
    with tempfile.TemporaryDirectory(prefix="streams-") as name:
        base = Path(name)
        folder = _many(base, shards)
        rows.append(("folder, any order", *in_own_process(_any, str(folder), most)))
        rows.append(("folder, windows", *in_own_process(_windows, str(folder), most)))
        with s3_server(base / "copies") as bucket:
            url = f"{bucket}/many"
            _upload(folder, url)
            size = (folder / SHARD).stat().st_size
            os.environ["SIMNFND_CLOUD_CACHE_BYTES"] = str(KEPT_SHARDS * size)
            few = min(most, options.amount(FEW, 20))
            rows.append(("URL, any order", *in_own_process(_any, url, few)))
            shutil.rmtree(base / "copies", ignore_errors=True)
            rows.append(("URL, windows", *in_own_process(_windows, url, most)))
            del os.environ["SIMNFND_CLOUD_CACHE_BYTES"]
            kept = sum(path.stat().st_size for path in (base / "copies").glob("*/t*/*.h5"))
        if kept > KEPT_SHARDS * size:
            bad.append(f"{kept} bytes are kept, {KEPT_SHARDS * size} are allowed")
    columns = ("read from", "pairs", "pairs/s", "MB at a tenth", "MB at the end")
    title = f"{shards} shards of {size / 1e3:.0f} kB, at most {KEPT_SHARDS} of them kept"
    return Section((Table(columns, tuple(rows), title),), failed="; ".join(bad))


def _many(base: Path, shards: int) -> Path:
    """A dataset of one shard under many names, by hard links."""
    folder = whole(base / "many", compression="gzip")
    first = folder / SHARD
    for path in folder.glob("t*/*.h5"):
        if path != first:
            path.unlink()
    with h5py.File(first) as file:
        samples, config_hash = len(file["noisy"]), str(file.attrs["config_hash"])
    digest, size = sha256_of(first), first.stat().st_size
    infos = {}
    for number in range(shards):
        name = f"train/shard-{number:05d}.h5"
        if number:
            os.link(first, folder / name)
        infos[name] = ShardInfo(name, "train", samples, size, digest)
    save_manifest(folder, Manifest(config_hash, "simnfnd streams", {}, infos))
    return folder


def _upload(folder: Path, url: str) -> None:
    import fsspec

    store = Store(url)
    store.put("manifest.json", (folder / "manifest.json").read_bytes())
    system = fsspec.filesystem("s3")
    content = (folder / SHARD).read_bytes()
    names = [f"{url}/train/{path.name}" for path in sorted((folder / "train").iterdir())]
    for k in range(0, len(names), 500):
        system.pipe(dict.fromkeys(names[k : k + 500], content))


def _any(dataset: str, most: int) -> tuple[Cell, ...]:
    with PairDataset(dataset, trusted=True) as pairs:
        order = np.random.default_rng(0).permutation(len(pairs))[:most]
        return _timed((pairs[int(index)] for index in order), order)


def _windows(dataset: str, most: int) -> tuple[Cell, ...]:
    with PairDataset(dataset, trusted=True) as pairs:
        count = min(most, len(pairs))
        return _timed(islice(pairs.shuffled(window=WINDOW), count), range(count))


def _timed(samples: Iterable[object], sized: Sized) -> tuple[Cell, ...]:
    """(pairs, pairs a second, memory after a tenth of them, at the end)."""
    process, count, early = psutil.Process(), len(sized), 0.0
    begun = time.perf_counter()
    for number, _ in enumerate(samples):
        if number == count // 10:
            early = process.memory_info().rss / 1e6
    seconds = time.perf_counter() - begun
    return count, count / seconds, early, process.memory_info().rss / 1e6
