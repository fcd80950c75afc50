"""Cost as work grows: warm pairs through the real scheduler, and every part that grows with shards.

The pictures are small (128x128 of frames of 240x160), so that 10^4 pairs take a minute: what is
looked at is whether time is linear and memory flat, not what a pair costs (`python -m benchmarks
pair`).  Parts are measured with shards that are as small as they can be.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import h5py
import psutil

from benchmarks.memory import workers_of
from benchmarks.report import Cell, Options, Section, Table
from benchmarks.shared import in_own_process, peak_memory_mb
from simnfnd.factory.dataset.format.manifest import (
    Additions,
    Manifest,
    ShardInfo,
    load_manifest,
    save_manifest,
)
from simnfnd.factory.dataset.format.schema import Provenance
from simnfnd.factory.dataset.format.settings import DatasetSettings
from simnfnd.factory.dataset.write.failures import Failure, add_failures, save_failures
from simnfnd.factory.dataset.write.index import write_index
from simnfnd.factory.files import sha256_of
from simnfnd.factory.frame import FrameRef
from simnfnd.factory.scheduler.plan import plan_shards

PAIRS = (100, 1_000, 10_000)
SHARDS = (1_000, 10_000, 100_000)
INDEXED = (100, 1_000, 10_000)
TASKS = (100, 1_000, 2_000)
FAILED = (250, 500, 1_000)
FRAMES = 20


def measure(options: Options) -> Section:
    """Five tables."""
    pairs, shards, indexed, tasks, failed = (
        (tuple(amount // 100 for amount in amounts) if options.quick else amounts)
        for amounts in (PAIRS, SHARDS, INDEXED, TASKS, FAILED)
    )
    return Section(
        (
            _warm_pairs([max(n, FRAMES) for n in pairs]),
            Table(
                (
                    *("shards", "plan them, s", "manifest, MB", "write it, s", "read it, s"),
                    *("a line, ms", "check on resume, s", "peak memory, MB"),
                ),
                tuple(in_own_process(manifest_row, count) for count in shards),
                "manifest and resume",
                "CPU seconds.  A line: adding a finished shard to manifest.jsonl.  Check: size and "
                "SHA-256 of every shard; files of a kilobyte, from memory.",
                lines=("shards", "plan them, s", "write it, s", "read it, s", "check on resume, s"),
            ),
            Table(
                (
                    "shards",
                    "index.h5, MB",
                    "write it, s",
                    "open and read one, s",
                    "PairDataset, s",
                    "peak memory, MB",
                ),
                tuple(in_own_process(index_row, count) for count in indexed),
                "index.h5",
                "CPU seconds.  PairDataset: to open the dataset, trusted, and read one pair.",
                lines=("shards", "write it, s", "open and read one, s", "PairDataset, s"),
            ),
            Table(
                ("failures", "ms a failure", "ms to write them all"),
                tuple(in_own_process(failures_row, count) for count in failed),
                "failed.jsonl",
                "CPU ms; a failure: adding it during a run.",
                lines=("failures", "ms a failure", "ms to write them all"),
            ),
            Table(
                ("shards", "loop alone, CPU ms a shard", "serial, CPU ms", "local, wall ms"),
                tuple(_task_row(count) for count in tasks),
                "scheduler",
                "Shards of one tiny pair that costs next to nothing; serial: with the work itself; "
                "local: two workers, from the first task to the end, their start included.",
                lines=("shards", "loop alone, CPU ms a shard", "serial, CPU ms", "local, wall ms"),
            ),
        )
    )


class Laps:
    """CPU seconds of this process, all threads, from one call of `lap` to the next."""

    def __init__(self) -> None:
        self._last = time.process_time()

    def lap(self) -> float:
        """Since the last call, or since the beginning."""
        before, self._last = self._last, time.process_time()
        return self._last - before


def _warm_pairs(amounts: list[int]) -> Table:
    rows: list[tuple[Cell, ...]] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _run(folder, 1)  # renders
        for amount in amounts:
            cpu, wall, peak, parent, files = _run(folder, amount // FRAMES)
            pairs = amount // FRAMES * FRAMES
            rows.append((pairs, 1e3 * wall / pairs, 1e3 * cpu / pairs, wall, peak, parent, files))
    columns = (
        "pairs",
        "wall ms a pair",
        "CPU ms a pair",
        "s",
        "peak memory, MB",
        "of the parent, MB",
    )
    note = (
        f"128x128 pictures, {FRAMES} frames whose renders are at hand, shards of 32; peak memory "
        "(PSS) of all processes together, looked at twice a second."
    )
    lines = ("pairs", "wall ms a pair", "peak memory, MB")
    return Table((*columns, "files"), tuple(rows), "warm pairs", note, lines=lines)


def _run(folder: Path, variants: int) -> tuple[float, float, float, float, int]:
    """CPU s, wall s, peak MB of all and of the parent, files made, of one command."""
    command = [
        *(
            sys.executable,
            "-m",
            "simnfnd.factory",
            "render=analytic",
            f"cache.dir={folder / 'cache'}",
        ),
        *("scenes.locations=2", f"scenes.frames_per_location={FRAMES // 2}"),
        *("scenes.width=240", "scenes.height=160", "sonar.beams=128", "sonar.range_bins=128"),
        *("sonar.image.width_px=128", "sonar.image.height_px=128", "dataset.preview_pairs=0"),
        *(f"frames.variants={variants}", "scheduler.workers=2", "dataset.on_existing=overwrite"),
        f"dataset.dir={folder / 'dataset'}",
    ]
    began, peak, parent, cpu = time.monotonic(), 0.0, 0.0, 0.0
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    spent: dict[int, float] = {}
    while process.poll() is None:
        memory = []
        try:
            for one in (psutil.Process(process.pid), *workers_of(process.pid)):
                memory.append(one.memory_full_info().pss / 1e6)
                times = one.cpu_times()
                spent[one.pid] = times.user + times.system
        except psutil.Error:
            continue
        peak, parent = max(peak, sum(memory)), max(parent, memory[0])
        time.sleep(0.5)
    if process.returncode:
        raise SystemExit(f"a run of {variants} variants ended with {process.returncode}")
    cpu = sum(spent.values())
    files = sum(1 for _ in (folder / "dataset").rglob("*"))
    return cpu, time.monotonic() - began, peak, parent, files


def manifest_row(shards: int) -> tuple[Cell, ...]:
    """Manifest and resume of a dataset of that many shards."""
    from simnfnd.factory.scheduler.results import take_up

    clock = Laps()
    tasks = plan_shards({"train": [FrameRef("reef", "a", f"{n:07d}") for n in range(shards)]}, 1, 1)
    assert all(task.digest for task in tasks)
    planned = clock.lap()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "train").mkdir()
        content = bytes(1024)
        for task in tasks:
            (folder / task.path).write_bytes(content)
        sha256 = sha256_of(folder / tasks[0].path)
        infos = {
            task.path: ShardInfo(task.path, "train", 1, 1024, sha256, task.digest, (), "0" * 16)
            for task in tasks
        }
        manifest = Manifest("0" * 16, "benchmark", {}, infos)
        clock.lap()
        save_manifest(folder, manifest)
        written = clock.lap()
        size = (folder / "manifest.json").stat().st_size
        loaded = load_manifest(folder)
        read = clock.lap()
        assert loaded is not None
        resumed = take_up(folder, tasks, loaded)
        checked = clock.lap()
        assert not resumed.todo
        added, lines = Additions(folder), min(200, shards)
        for task in tasks[:lines]:
            added.note(task.path, infos[task.path])
        a_line = 1e3 * clock.lap() / lines
    return (shards, planned, size / 1e6, written, read, a_line, checked, round(peak_memory_mb()))


def failures_row(count: int) -> tuple[Cell, ...]:
    """failed.jsonl while so many frames fail, one after another."""
    found = [
        Failure(FrameRef("reef", "a", f"{n:07d}"), "frame", "no depth", f"train/shard-{n:05d}.h5")
        for n in range(count)
    ]
    with tempfile.TemporaryDirectory() as name:
        clock = Laps()
        for failure in found:
            add_failures(Path(name), [failure], lambda ref: ref.name)
        each = 1e3 * clock.lap() / count
        save_failures(Path(name), found, lambda ref: ref.name)
        return (count, each, 1e3 * clock.lap())


def index_row(shards: int) -> tuple[Cell, ...]:
    """index.h5 over that many shards, all the same tiny one."""
    from simnfnd.factory.dataset import PairDataset
    from simnfnd.factory.dataset.write.writer import write_shard
    from tests.fake_source import FakeConfig, FakeSource, refs

    source = FakeSource(FakeConfig())
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        first = "train/shard-00000.h5"
        pair = source.pairs(refs(1)[0], (0,))
        info = write_shard(
            folder,
            first,
            pair,
            source.axes(),
            source.columns(),
            Provenance({}, "0" * 16, "benchmark"),
            DatasetSettings(),
        )
        assert info is not None
        infos = {first: info}
        for number in range(1, shards):
            path = f"train/shard-{number:05d}.h5"
            shutil.copyfile(folder / first, folder / path)
            infos[path] = replace(info, path=path)
        manifest = Manifest("0" * 16, "benchmark", {}, infos)
        save_manifest(folder, manifest)
        clock = Laps()
        path_ = write_index(folder, manifest)
        written = clock.lap()
        with h5py.File(path_) as index:
            stack = index["train/noisy"]
            stack[len(stack) // 2]
        read = clock.lap()
        with PairDataset(folder, trusted=True) as pairs:
            pairs[len(pairs) // 2]
        opened = clock.lap()
        size = path_.stat().st_size / 1e6
    return (shards, size, written, read, opened, round(peak_memory_mb()))


def _task_row(shards: int) -> tuple[Cell, ...]:
    _, serial = in_own_process(run_shards, shards, "serial")
    local, own_cpu = in_own_process(run_shards, shards, "local")
    return (shards, 1e3 * own_cpu / shards, 1e3 * serial / shards, 1e3 * local / shards)


def run_shards(shards: int, backend: str) -> tuple[float, float]:
    """Wall seconds of the run loop over so many shards, and CPU seconds of its own process."""
    from simnfnd.factory.dataset.write.folder import open_folder
    from simnfnd.factory.scheduler.job import Job
    from simnfnd.factory.scheduler.lock import Lock
    from simnfnd.factory.scheduler.run import make_shards
    from simnfnd.factory.scheduler.settings import SchedulerSettings
    from tests.fake_source import FakeConfig, FakeSource, refs, rerun

    tasks = plan_shards({"train": refs(shards)}, 1, 1)
    settings = SchedulerSettings(
        backend=backend,  # type: ignore[arg-type]
        workers=2,
        recycle_frames=10**6,
        frame_timeout_s=60.0,
    )
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name, "dataset")
        provenance = Provenance({}, "0" * 16, "benchmark")
        with Lock(folder) as lock:
            manifest = open_folder(folder, {}, provenance)
            job = Job(
                folder,
                tasks,
                FakeSource,
                FakeConfig(),
                provenance,
                config_values={},
                dataset=DatasetSettings(),
                scheduler=settings,
                rerun_command=rerun,
            )
            begun, cpu = time.monotonic(), time.process_time()
            report = make_shards(job, manifest, lock)
            spent = time.monotonic() - begun, time.process_time() - cpu
        assert report.shards == shards
    return spent
