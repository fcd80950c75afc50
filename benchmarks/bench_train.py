"""Steps a second of training on pairs, by the difference of a long and a short run."""

from __future__ import annotations

import tempfile

from benchmarks.shared import Options, Section, Table, run_command


def measure(options: Options) -> Section:
    """A row for each network that people train."""
    few = options.amount(20, 2)
    many = options.amount(120, 4)
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        run_command("demo", "render=analytic", f"dataset.dir={folder}/demo")
        for network in ("sonarnet", "nafnet"):
            less, more = (
                run_command(
                    "train", f"dataset={folder}/demo", f"model={network}",
                    f"train.steps={steps}", f"train.check_every={many}", "train.warmup=1",
                    f"out={folder}/{network}-{steps}", "device=cpu",
                )
                for steps in (few, many)
            )  # fmt: skip
            step = (many - few) / (more.wall - less.wall)
            rows.append((network, step, (more.cpu - less.cpu) / (many - few)))
    header = ("network, default recipe", "steps per second", "CPU s per step")
    return Section((Table(header, rows),))
