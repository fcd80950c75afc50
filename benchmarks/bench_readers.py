"""Shuffled reading of 512x512 pairs: `PairDataset` beside bare h5py on the same files.

The files are in the page cache.  Bare h5py keeps files and datasets open and indexes them.  Both
read in turns and the best round counts: other work on the machine can only slow a round down.
"""

from __future__ import annotations

import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from benchmarks.bench_command import IMAGE_SETTINGS
from benchmarks.shared import Cell, Options, Section, Table, run_command
from simnfnd.factory.common.isolated import LASTING
from simnfnd.factory.dataset import PairDataset

ROUNDS = 7
# Pairs a second that the project asks for on two cores.
WANTED = {"gzip": 350, "none": 5000}


def measure(options: Options) -> Section:
    """Pairs a second for each compression, and for torch's DataLoader."""
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as folder:
        for compression in WANTED:
            root = Path(folder) / compression
            run_command(
                "make", "scenes=seabed", "render=analytic", *IMAGE_SETTINGS, "scheduler=serial",
                "scenes.locations=2", f"frames.variants={options.amount(8, 1)}",
                f"scenes.frames_per_location={options.amount(15, 1)}", "split.test_fraction=0",
                f"dataset.compression={compression}", f"dataset.dir={root}",
                f"cache.dir={folder}/cache", "dataset.preview_pairs=0",
            )  # fmt: skip
            rows.append(_compare(root, compression, options.amount(ROUNDS)))
        opening = _opening(Path(folder) / "gzip", options.amount(ROUNDS))
        one_worker, two_workers = (
            _loader(Path(folder) / "gzip", n, options.amount(5, 2)) for n in (1, 2)
        )
    columns = ("compression", "of bare h5py", "PairDataset, pairs/s", "bare h5py", "wanted")
    loaders = Table(
        ("DataLoader, gzip, batches of 8", "times one worker", "pairs/s"),
        (("1 worker", 1.0, one_worker), ("2 workers", two_workers / one_worker, two_workers)),
    )
    return Section((Table(columns, rows), loaders, opening))


Row = tuple[Cell, ...]


def _opening(root: Path, rounds: int) -> Table:
    """CPU seconds of the separate process in which an untrusted dataset is opened first."""
    opened = []
    imported = []
    for _ in range(rounds):
        LASTING.close()
        began = _cpu_seconds_of_children()
        PairDataset(root, "train").close()
        LASTING.close()
        opened.append(_cpu_seconds_of_children() - began)
        began = _cpu_seconds_of_children()
        subprocess.run([sys.executable, "-c", "import h5py"], check=True)
        imported.append(_cpu_seconds_of_children() - began)
    row = (statistics.median(opened), statistics.median(imported))
    columns = ("opening an untrusted dataset, CPU s", "of it Python, numpy and h5py")
    return Table(columns, (row,))


def _cpu_seconds_of_children() -> float:
    times = os.times()
    return times.children_user + times.children_system


def _compare(root: Path, compression: str, rounds: int) -> Row:
    # HDF5 opens a file once in a process, with the settings of whoever came first.
    copy = Path(shutil.copytree(root, root.with_name(f"{root.name}-copy")))
    files = [h5py.File(path) for path in sorted(copy.glob("train/*.h5"))]
    places = [(file, row) for file in files for row in range(len(file["noisy"]))]
    order = np.random.default_rng(0).permutation(len(places)).tolist()
    stacks = {file: (file["noisy"], file["clean"]) for file in files}

    def bare() -> None:
        for number in order:
            file, row = places[number]
            noisy, clean = stacks[file]
            noisy[row], clean[row]

    with PairDataset(root, "train") as pairs:

        def ours() -> None:
            for number in order:
                pairs[number]

        bare_rate, our_rate = _best([bare, ours], len(order), rounds)
    for file in files:
        file.close()
    return compression, our_rate / bare_rate, our_rate, bare_rate, WANTED[compression]


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

    with PairDataset(root, "train") as pairs:
        dataset: Any = pairs
        loader: Any = DataLoader(
            dataset, 8, shuffle=True, num_workers=workers, persistent_workers=True
        )
        best = 0.0
        for epoch in range(epochs):
            start = time.perf_counter()
            count = sum(len(batch["noisy"]) for batch in loader)
            if epoch:
                best = max(best, count / (time.perf_counter() - start))
    return best
