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
from typing import Any
from unittest import mock

import numpy as np
import psutil

from benchmarks.report import Cell, Options, Section, Table
from benchmarks.shared import in_own_process
from simnfnd.factory.dataset import PairDataset
from simnfnd.factory.dataset.format.manifest import Manifest, save_manifest
from simnfnd.factory.dataset.format.settings import DatasetSettings
from simnfnd.factory.dataset.write.writer import write_shard
from simnfnd.factory.progress import progress_bar, stage_if_slow
from simnfnd.factory.storage.store import Store
from tests.cloud_storage import s3_server
from tests.factory.dataset.hostile import PROVENANCE
from tests.fake_source import FakeConfig, FakeSource, refs

SHARD = "train/shard-{:05d}.h5"
PAIRS_A_SHARD = 4
ANY_ORDER, SERVED = 1000, 300
ANY = "any order"
WINDOW = 16
KEPT_SHARDS = 3 * WINDOW
# Of resident memory, from the first quarter of the way to the last; more is a leak.
GROWTH = 0.1
# Twice as many as a reader keeps open: until then it takes more with every shard, and no longer.
WARM_SHARDS = 128
# The way is long enough after that.
_ENOUGH_SHARDS = 4 * WARM_SHARDS
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
                _row("URL", ANY, _any, url, few),
                _row("folder", ANY, _any, str(folder), few),
                _row("URL", "`data=pairs`", _trained, url),
                _row("folder", "`data=pairs`", _trained, str(folder)),
            ]
            served = _server(url, options.amount(SERVED, 12))
            kept = sum(path.stat().st_size for path in (base / "copies").glob("*/t*/*.h5"))
        del os.environ["SIMNFND_CLOUD_CACHE_BYTES"]
    if kept > KEPT_SHARDS * size:
        bad.append(f"{kept} bytes are kept, {KEPT_SHARDS * size} are allowed")
    for place, how, *_, fetched, again, first_mb, last_mb, _ in rows:
        if shards >= _ENOUGH_SHARDS and has_grown(float(first_mb), float(last_mb)):
            bad.append(f"{place}, {how}: {first_mb} MB became {last_mb}")
        if again and how != ANY:
            bad.append(f"{place}, {how}: {again} of {fetched} fetches were of a shard once more")
    columns = (
        *("read from", "how", "pairs", "pairs/s", "CPU ms a pair", "server's"),
        *("for the table", "fetched", "of these again"),
        *("MB, first quarter", "MB, last quarter", "files open"),
    )
    title = (
        f"{shards} shards of {PAIRS_A_SHARD} pairs and {size / 1e3:.0f} kB, at most {KEPT_SHARDS} "
        "of them kept"
    )
    note = (
        "CPU: of the reader and of the process that looks at shards first; the server's beside it. "
        "MB: of both, the mean of what was looked at in that quarter of the pairs, after those of "
        f"{WARM_SHARDS} shards, for 64 stay open.  `data=pairs`: the table of all shards is read "
        "before, and counted by itself alone."
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
    with progress_bar(total=len(names), unit="shard", desc="to the server") as bar:
        for k in range(0, len(names), 500):
            system.pipe(dict.fromkeys(names[k : k + 500], content))
            bar.update(len(names[k : k + 500]))


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
    pairs, rate, reader_ms, *more = in_own_process(function, f"{place}, {how}", *arguments)
    server_ms = 1e3 * (time.process_time() - spent) / int(pairs)
    return (place, how, pairs, rate, reader_ms, server_ms, *more)


def _any(what: str, dataset: str, most: int) -> tuple[Cell, ...]:
    gets = _counted()
    with PairDataset(dataset, trusted=True) as pairs:
        order = np.random.default_rng(0).permutation(len(pairs))[: most + WARM_SHARDS]
        read = (pairs[int(index)] for index in order)
        return timed(what, read, order, gets, warm=min(WARM_SHARDS, len(order) // 4))


def _shuffled(what: str, dataset: str) -> tuple[Cell, ...]:
    gets = _counted()
    with PairDataset(dataset, trusted=True) as pairs:
        return timed(what, pairs.shuffled(window=WINDOW), pairs, gets, warm=_warm(pairs))


def _trained(what: str, dataset: str) -> tuple[Cell, ...]:
    """As `train data=pairs` visits them, without the network."""
    from simnfnd.factory.dataset.read import pair_dataset
    from simnfnd.models.data.pairs import PairSource, read_table, windows_of

    gets = _counted()
    # `read_table` trusts no folder; the rows above do.
    with mock.patch.object(pair_dataset, "check_in_isolation"), stage_if_slow(f"{what}: table"):
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
        return timed(what, visited(), source, gets, warm=_warm(source))
    finally:
        if windows is not None:
            windows.close()


def _warm(sized: Sized) -> int:
    return min(WARM_SHARDS * PAIRS_A_SHARD, len(sized) // 4)


def _counted() -> list[str]:
    """Names that this process asks a storage for, from now on."""
    gets: list[str] = []
    plain = Store.get

    def get(self: Store, name: str, start: int | None = None, end: int | None = None) -> Any:
        gets.append(name)
        return plain(self, name, start, end)

    Store.get = get  # type: ignore[method-assign]
    return gets


def timed(
    what: str, samples: Iterable[object], sized: Sized, gets: list[str], *, warm: int
) -> tuple[Cell, ...]:
    """Read them all, the first `warm` before anything is measured.

    Returns pairs, pairs a second, CPU ms a pair; shards fetched before, since, and more than once;
    MB of the first and the last quarter; files open.
    """
    process, count = psutil.Process(), len(sized) - warm
    memory_mb: list[float] = []
    before = _shards(gets)
    gets.clear()
    read = iter(progress_bar(islice(samples, len(sized)), total=len(sized), unit="pair", desc=what))
    for _ in islice(read, warm):
        pass
    begun, spent = time.perf_counter(), _cpu_s(process)
    for number, _ in enumerate(read):
        if number % max(1, count // _LOOKS) == 0:
            both = (process, *process.children())
            memory_mb.append(sum(one.memory_info().rss for one in both) / 1e6)
    wall, quarter = time.perf_counter() - begun, max(1, len(memory_mb) // 4)
    fetched = _shards(gets)
    return (
        count,
        count / wall,
        1e3 * (_cpu_s(process) - spent) / count,
        len(before),
        len(fetched),
        len(fetched) - len(set(fetched)),
        statistics.mean(memory_mb[:quarter]),
        statistics.mean(memory_mb[-quarter:]),
        process.num_fds(),
    )


def has_grown(first_mb: float, last_mb: float) -> bool:
    """Whether a reader takes so much more at its end that it does not give back what it takes."""
    return last_mb > (1 + GROWTH) * first_mb


def _shards(names: list[str]) -> list[str]:
    return [name for name in names if "/" in name]


def _cpu_s(process: psutil.Process) -> float:
    """Of a process and of those that it started."""
    return sum(sum(one.cpu_times()[:2]) for one in (process, *process.children()))
