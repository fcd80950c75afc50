"""Pairs a second from many shards at a URL, shuffled, against the same in a folder; and memory.

The S3 server runs on this machine, on Python, and takes part of its CPU time: its part is told, and
what it gives when it is asked for shards alone.
"""

from __future__ import annotations

import os
import shutil
import statistics
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Sized
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import islice
from pathlib import Path
from unittest import mock

import numpy as np
import psutil

from benchmarks.report import Cell, Options, Section, Table
from benchmarks.shared import in_own_process
from simnfnd.factory.dataset import PairDataset
from simnfnd.factory.dataset.format.manifest import Manifest, save_manifest
from simnfnd.factory.dataset.format.settings import DatasetSettings
from simnfnd.factory.dataset.write.writer import write_shard
from simnfnd.factory.storage.store import Store
from tests.cloud_storage import s3_server
from tests.factory.dataset.hostile import PROVENANCE
from tests.fake_source import FakeConfig, FakeSource, refs

SHARD = "train/shard-{:05d}.h5"
PAIRS_A_SHARD = 4
ANY_ORDER, SERVED = 300, 300
WINDOW = 16
KEPT_SHARDS = 3 * WINDOW
# Of resident memory, from the first quarter of the way to the last; more is a leak.
GROWTH = 0.1
# As many shards are open as ever will be long before the first quarter ends.
_ENOUGH_SHARDS = 1000
_LOOKS = 100


def measure(options: Options) -> Section:
    """One shard under many names: what is read differs in nothing but its place."""
    shards = options.amount(options.shards, 12)
    bad: list[str] = []
    with tempfile.TemporaryDirectory(prefix="streams-") as name:
        base = Path(name)
        folder, size = many_shards(base / "many", shards)
        os.environ["SIMNFND_CLOUD_CACHE_BYTES"] = str(KEPT_SHARDS * size)
        with s3_server(base / "copies") as bucket:
            url = f"{bucket}/many"
            _upload(folder, url)
            few = options.amount(ANY_ORDER, 20)
            # The server runs in this process, and nothing else does meanwhile.
            rows = [
                _row("URL", "`shuffled`", _shuffled, url),
                _row("folder", "`shuffled`", _shuffled, str(folder)),
                _row("URL", "any order", _any, url, few),
                _row("folder", "any order", _any, str(folder), few),
                _row("URL", "`data=pairs`", _trained, url),
                _row("folder", "`data=pairs`", _trained, str(folder)),
            ]
            served = _server(url, options.amount(SERVED, 12))
            kept = sum(path.stat().st_size for path in (base / "copies").glob("*/t*/*.h5"))
        del os.environ["SIMNFND_CLOUD_CACHE_BYTES"]
    if kept > KEPT_SHARDS * size:
        bad.append(f"{kept} bytes are kept, {KEPT_SHARDS * size} are allowed")
    for place, how, *_, first_mb, last_mb, _ in rows:
        if shards >= _ENOUGH_SHARDS and float(last_mb) > (1 + GROWTH) * float(first_mb):
            bad.append(f"{place}, {how}: {first_mb} MB became {last_mb}")
    columns = (
        *("read from", "how", "pairs", "pairs/s", "CPU ms a pair", "server's"),
        *("fetched", "MB, first quarter", "MB, last quarter", "files open"),
    )
    title = (
        f"{shards} shards of {PAIRS_A_SHARD} pairs and {size / 1e3:.0f} kB, at most {KEPT_SHARDS} "
        "of them kept"
    )
    note = (
        "CPU: of the reader and of the process that looks at shards first; the server's beside it. "
        "MB: of both, the mean of what was looked at in that quarter of the pairs.  `data=pairs`: "
        "the table of all shards is read before, and fetched counts that; the rest does not."
    )
    columns_2 = ("asked for", "threads", "objects/s", "server's CPU ms", "client's CPU ms")
    tables = (
        Table(columns, tuple(rows), title, note),
        Table(columns_2, served, "the server alone, by fsspec"),
    )
    return Section(tables, failed="; ".join(bad))


def many_shards(folder: Path, shards: int) -> tuple[Path, int]:
    """A dataset of one shard under many names, by hard links; and the bytes of that shard."""
    source = FakeSource(FakeConfig())
    pairs = [source.pairs(ref, (0,))[0] for ref in refs(PAIRS_A_SHARD)]
    how = source.axes(), source.columns(), PROVENANCE, DatasetSettings()
    info = write_shard(folder, SHARD.format(0), pairs, *how)
    assert info is not None
    names = [SHARD.format(number) for number in range(shards)]
    for name in names[1:]:
        os.link(folder / names[0], folder / name)
    infos = {name: replace(info, path=name) for name in names}
    save_manifest(folder, Manifest(PROVENANCE.config_hash, "simnfnd streams", {}, infos))
    return folder, info.bytes


def _upload(folder: Path, url: str) -> None:
    import fsspec

    Store(url).put("manifest.json", (folder / "manifest.json").read_bytes())
    system = fsspec.filesystem("s3")
    content = (folder / SHARD.format(0)).read_bytes()
    names = [f"{url}/train/{path.name}" for path in sorted((folder / "train").iterdir())]
    for k in range(0, len(names), 500):
        system.pipe(dict.fromkeys(names[k : k + 500], content))


def _server(url: str, count: int) -> tuple[tuple[Cell, ...], ...]:
    rows = []
    for threads in (1, 4):
        spent = time.process_time()
        rate, client_ms = in_own_process(_ask, url, count, threads)
        server_ms = 1e3 * (time.process_time() - spent) / count
        rows.append((count, threads, rate, server_ms, client_ms))
    return tuple(rows)


def _ask(url: str, count: int, threads: int) -> tuple[float, float]:
    """(objects a second, CPU ms of an object) of one client that does nothing else."""
    store = Store(url)
    store.get(SHARD.format(0))
    begun, spent = time.perf_counter(), time.process_time()
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(store.get, [SHARD.format(number) for number in range(count)]))
    return count / (time.perf_counter() - begun), 1e3 * (time.process_time() - spent) / count


def _row(
    place: str, how: str, function: Callable[..., tuple[Cell, ...]], *arguments: object
) -> tuple[Cell, ...]:
    # What was fetched for the row before does not count.
    shutil.rmtree(os.environ["SIMNFND_CLOUD_CACHE"], ignore_errors=True)
    spent = time.process_time()
    pairs, rate, reader_ms, fetched, *memory = in_own_process(function, *arguments)
    server_ms = 1e3 * (time.process_time() - spent) / int(pairs)
    print(f"{place}, {how}: {pairs} pairs, {rate:.1f}/s, {memory}", flush=True)
    return (place, how, pairs, rate, reader_ms, server_ms, fetched, *memory)


def _any(dataset: str, most: int) -> tuple[Cell, ...]:
    gets = _counted()
    with PairDataset(dataset, trusted=True) as pairs:
        order = np.random.default_rng(0).permutation(len(pairs))[:most]
        return _timed((pairs[int(index)] for index in order), order, gets)


def _shuffled(dataset: str) -> tuple[Cell, ...]:
    gets = _counted()
    with PairDataset(dataset, trusted=True) as pairs:
        return _timed(pairs.shuffled(window=WINDOW), pairs, gets)


def _trained(dataset: str) -> tuple[Cell, ...]:
    """As `train data=pairs` visits them, without the network."""
    from simnfnd.factory.dataset.read import pair_dataset
    from simnfnd.models.data.pairs import PairSource, read_table, windows_of

    gets = _counted()
    # `read_table` trusts no folder; the rows above do.
    with mock.patch.object(pair_dataset, "check_in_isolation"):
        table = read_table(dataset, "train")
    source = PairSource(table.samples, table.sonar)
    windows = windows_of(source)
    order = np.random.default_rng(0).permutation(len(source))
    if windows is not None:
        order = windows.order(np.random.default_rng(0))

    def visited() -> Iterator[object]:
        for position, index in enumerate(order):
            if windows is not None:
                windows.reach(position)
            yield source.sample(int(index), position)

    try:
        return _timed(visited(), source, gets)
    finally:
        if windows is not None:
            windows.close()


def _counted() -> list[str]:
    """Names that this process asks a storage for, from now on."""
    gets: list[str] = []
    plain = Store.get

    def get(self: Store, name: str) -> bytes | None:
        gets.append(name)
        return plain(self, name)

    Store.get = get  # type: ignore[method-assign]
    return gets


def _timed(samples: Iterable[object], sized: Sized, gets: list[str]) -> tuple[Cell, ...]:
    """Pairs, pairs a second, CPU ms a pair, shards fetched, MB of the quarters, files open."""
    process, count = psutil.Process(), len(sized)
    memory_mb: list[float] = []
    begun, spent = time.perf_counter(), _cpu_s(process)
    for number, _ in enumerate(islice(samples, count)):
        if number % max(1, count // _LOOKS) == 0:
            both = (process, *process.children())
            memory_mb.append(sum(one.memory_info().rss for one in both) / 1e6)
    wall, quarter = time.perf_counter() - begun, max(1, len(memory_mb) // 4)
    return (
        count,
        count / wall,
        1e3 * (_cpu_s(process) - spent) / count,
        sum(name.endswith(".h5") for name in gets),
        statistics.mean(memory_mb[:quarter]),
        statistics.mean(memory_mb[-quarter:]),
        process.num_fds(),
    )


def _cpu_s(process: psutil.Process) -> float:
    """Of a process and of those that it started."""
    return sum(sum(one.cpu_times()[:2]) for one in (process, *process.children()))
