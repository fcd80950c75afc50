"""Pairs a second from many shards at a URL, shuffled, against the same in a folder; and memory.

The S3 server runs on this machine, on Python, and takes part of its CPU time; what is asked for
and how often is what counts on any storage.
"""

from __future__ import annotations

import os
import shutil
import tempfile
import time
from collections.abc import Iterable, Iterator, Sized
from dataclasses import replace
from itertools import islice
from pathlib import Path

import h5py
import numpy as np
import psutil

from benchmarks.report import Cell, Options, Section, Table
from benchmarks.shared import in_own_process
from simnfnd.factory.dataset import PairDataset
from simnfnd.factory.dataset.format.manifest import Manifest, ShardInfo, save_manifest
from simnfnd.factory.dataset.format.settings import DatasetSettings
from simnfnd.factory.dataset.write.writer import write_shard
from simnfnd.factory.files import sha256_of
from simnfnd.factory.storage.store import Store
from tests.cloud_storage import s3_server
from tests.factory.dataset.hostile import PROVENANCE, whole
from tests.fake_source import FakeConfig, FakeSource, refs

SHARD = "train/shard-00000.h5"
SHARDS, PAIRS, FEW = 10_000, 10_000, 300
WINDOW = 16
KEPT_SHARDS = 3 * WINDOW
# Of the resident memory between a tenth of the way and its end; more is a leak.
GROWTH = 0.1


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
        tiny = [
            (who, *in_own_process(function, str(base / "tiny"), shards))
            for who, function in (
                ("`PairDataset.shuffled`", _tiny_shuffled),
                ("`data=pairs`", _tiny_trained),
            )
        ]
    for who, *_, early_mb, _, last_mb in tiny:
        # --quick ends before as many shards are open as ever will be.
        if not options.quick and float(last_mb) > (1 + GROWTH) * float(early_mb):
            bad.append(f"{who}: {early_mb} MB became {last_mb}")
    columns = ("read from", "pairs", "pairs/s", "MB at 10 %", "at 50 %", "at 100 %")
    title = f"{shards} shards of {size / 1e3:.0f} kB, at most {KEPT_SHARDS} of them kept"
    small = f"{shards} shards of one pair at memory://, at most {KEPT_SHARDS} of them kept"
    tables = (Table(columns, tuple(rows), title), Table(columns, tuple(tiny), small))
    return Section(tables, failed="; ".join(bad))


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


def _tiny(base: Path, shards: int) -> str:
    """One shard of one pair under many names in this process's memory; its URL."""
    import fsspec

    source, name = FakeSource(FakeConfig()), "train/shard-{:05d}.h5"
    pairs = [source.pairs(ref, (0,))[0] for ref in refs(1)]
    how = source.axes(), source.columns(), PROVENANCE, DatasetSettings()
    info = write_shard(base, name.format(0), pairs, *how)
    assert info is not None
    names = [name.format(number) for number in range(shards)]
    infos = {path: replace(info, path=path) for path in names}
    save_manifest(base, Manifest(PROVENANCE.config_hash, PROVENANCE.generator, {}, infos))
    content = (base / names[0]).read_bytes()
    system = fsspec.filesystem("memory")
    system.pipe("/tiny/manifest.json", (base / "manifest.json").read_bytes())
    system.pipe(f"/tiny/{names[0]}", content)
    # One object under all names: this process's memory is what is measured.
    system.store.update(
        dict.fromkeys([f"/tiny/{path}" for path in names], system.store[f"/tiny/{names[0]}"])
    )
    os.environ["SIMNFND_CLOUD_CACHE"] = str(base / "copies")
    os.environ["SIMNFND_CLOUD_CACHE_BYTES"] = str(KEPT_SHARDS * len(content))
    return "memory://tiny"


def _tiny_shuffled(base: str, shards: int) -> tuple[Cell, ...]:
    with PairDataset(_tiny(Path(base) / "shuffled", shards)) as pairs:
        return _timed(pairs.shuffled(window=WINDOW), pairs)


def _tiny_trained(base: str, shards: int) -> tuple[Cell, ...]:
    """As `train data=pairs` visits them, without the network."""
    from simnfnd.models.data.pairs import PairSource, read_table, windows_of

    table = read_table(_tiny(Path(base) / "trained", shards), "train")
    source = PairSource(table.samples, table.sonar)
    windows = windows_of(source)
    assert windows is not None

    def visited() -> Iterator[object]:
        for position, index in enumerate(windows.order(np.random.default_rng(0))):
            windows.reach(position)
            yield source.sample(int(index), position)

    try:
        return _timed(visited(), source)
    finally:
        windows.close()


def _timed(samples: Iterable[object], sized: Sized) -> tuple[Cell, ...]:
    """(pairs, pairs a second, resident MB after 10 %, 50 % and all of them)."""
    process, count = psutil.Process(), len(sized)
    marks, memory_mb = {-(-count // 10), -(-count // 2), count}, []
    begun = time.perf_counter()
    for number, _ in enumerate(samples, start=1):
        if number in marks:
            memory_mb.append(process.memory_info().rss / 1e6)
    return count, count / (time.perf_counter() - begun), *memory_mb
