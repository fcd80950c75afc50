"""Damaged and malicious datasets: what reader and validator make of 1200 of them.

Every one is a copy of a sound dataset with one mutation (tests/factory/dataset/hostile.py).
An answer is pictures or one line; a crash, a hang, an exception of any other kind or a read outside
of the folder is not, and fails the benchmark.
"""

from __future__ import annotations

import tempfile
import time
from collections import Counter
from pathlib import Path

from benchmarks.report import Options, Section, Table
from simnfnd.factory.dataset.read.isolated import IsolatedProcess
from tests.factory.dataset.hostile import check, copy, mutate, whole

MUTATIONS = 1200


def measure(options: Options) -> Section:
    """How many were read, refused and found invalid."""
    counts: Counter[tuple[str, str]] = Counter()
    slowest_s, bad = 0.0, []
    mutations = options.amount(MUTATIONS, 3)
    with (
        tempfile.TemporaryDirectory() as folder,
        IsolatedProcess() as reader,
        IsolatedProcess() as validator,
    ):
        sound = whole(Path(folder) / "sound")
        for number in range(mutations):
            root = copy(sound, Path(folder) / "mutated")
            said = mutate(root, number)
            start = time.monotonic()
            try:
                read, found = check(root, reader, validator)
            except Exception as error:
                bad.append(f"{said}: {type(error).__name__}: {str(error)[-200:]}")
                continue
            slowest_s = max(slowest_s, time.monotonic() - start)
            verdict = "valid" if found == "valid" else "refused or invalid"
            counts[(read.split(":")[0], verdict)] += 1
    rows = [(read, verdict, count) for (read, verdict), count in sorted(counts.items())]
    rows.append(("no clear answer", "", len(bad)))
    columns = ("reader", "validate --deep", f"datasets of {mutations}")
    note = f"Slowest answer of both together: {slowest_s:.1f} s (the limit is 2 s a shard here)."
    return Section((Table(columns, tuple(rows), note=note),), failed="; ".join(bad)[:2000])
