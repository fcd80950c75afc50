"""The storm in full: at least 100 workers killed, the run killed twice, local and on Dask."""

from __future__ import annotations

import tempfile
from pathlib import Path

from benchmarks.growth.storm import HANGS, KILLS, storm, undisturbed
from benchmarks.report import Cell, Options, Section, Table

SHARDS = 44


def measure(options: Options) -> Section:
    """What happened, and whether all came out as without it."""
    rows: list[tuple[Cell, ...]] = []
    shards, kills = options.amount(44, 8), options.amount(110, 6)
    with tempfile.TemporaryDirectory() as folder:
        expected = undisturbed(Path(folder, "calm", "dataset"), shards)
        for backend in ("local",) if options.quick else ("local", "dask"):
            directory = Path(folder, backend, "dataset")
            done = storm(
                directory,
                backend,
                shards=shards,
                kills=kills,
                run_kills=options.amount(2),
                delay_s=0.6,
            )
            good = done.shards == expected and done.named == (KILLS, HANGS)
            outcome = "byte-identical, both bad frames named" if good else f"BAD: {done.named}"
            rows.append(
                (
                    backend,
                    len(done.shards),
                    done.worker_kills,
                    done.run_kills,
                    done.runs,
                    done.seconds,
                    outcome,
                )
            )
    columns = ("backend", "shards", "workers killed", "run killed", "commands", "s", "outcome")
    bad = [str(row[0]) for row in rows if str(row[-1]).startswith("BAD")]
    return Section((Table(columns, tuple(rows)),), failed=", ".join(bad))
