"""What reports cost: `evaluate` on a dataset with ten filters, `evaluate real` on a recording."""

from __future__ import annotations

import tempfile
from pathlib import Path

from benchmarks.shared import Options, Section, Table, run_command

FILTERS = "median,gaussian,bilateral,nlm,tv,wavelet,lee,kuan,frost,grey_opening"
LAMPREY = Path(__file__).parents[1] / "examples/didson/lamprey.avi"


def measure(options: Options) -> Section:
    """CPU and wall seconds of both reports."""
    pairs = options.amount(200, 4)
    with tempfile.TemporaryDirectory() as folder:
        run_command(
            "make", "scenes=seabed", "render=analytic", "scenes.locations=2",
            f"scenes.frames_per_location={pairs // 2}", "split.test_fraction=0.5",
            f"dataset.dir={folder}/made", "scheduler.workers=2",
        )  # fmt: skip
        report = run_command(
            "evaluate", f"dataset={folder}/made", f"baselines=[{FILTERS}]", f"out={folder}/report"
        )
        real = run_command(
            "evaluate", "real", str(LAMPREY), "baselines=[median,tv,nlm]", "models=[simnfnd]",
            f"out={folder}/real",
        )  # fmt: skip
    rows = [
        (f"evaluate, {pairs // 2} pairs, ten filters", report.cpu, report.wall),
        ("evaluate real, lamprey.avi, four methods", real.cpu, real.wall),
    ]
    return Section((Table(("report", "CPU s", "wall s"), rows),))
