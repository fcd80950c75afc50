"""How cost grows with the number of shards: planning, indexing, validating.

Tiny shards (one 64x64 pair each, one render for all), so that what is measured is the bookkeeping.
"""

from __future__ import annotations

import tempfile

from benchmarks.shared import Cell, Options, Section, Table, run_command


def measure(options: Options) -> Section:
    """A row for each amount, and the slope between the last two."""
    amounts = [
        options.amount(amount, 10 * (number + 1)) for number, amount in enumerate((200, 2000))
    ]
    rows: list[tuple[Cell, ...]] = []
    with tempfile.TemporaryDirectory() as folder:
        for shards in amounts:
            words = (
                "render=analytic", "scenes=seabed", "scenes.locations=1",
                "scenes.frames_per_location=1", "scenes.width=120", "scenes.height=80",
                "sonar.beams=64", "sonar.range_bins=64", "sonar.image.width_px=64",
                "sonar.image.height_px=64", "scheduler.shard_size=1",
                f"frames.variants={shards}", "split.test_fraction=0", "dataset.preview_pairs=0",
                f"dataset.dir={folder}/{shards}", f"cache.dir={folder}/cache",
            )  # fmt: skip
            plan = run_command("plan", *words)
            making = run_command("make", *words, "scheduler.workers=2")
            again = run_command("make", *words)
            validated = run_command("validate", f"{folder}/{shards}")
            rows.append((shards, plan.cpu, making.cpu, again.cpu, validated.cpu))
    columns = ("shards", "plan, CPU s", "make", "make again (resume)", "validate")
    slopes = [
        1e3 * (float(last) - float(first)) / (amounts[1] - amounts[0])
        for first, last in zip(rows[0][1:], rows[1][1:], strict=True)
    ]
    slope = Table(("CPU ms a shard", *columns[1:]), (("slope", *slopes),))
    return Section((Table(columns, rows), slope))
