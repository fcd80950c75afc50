"""One table of a sweep: what every point was, where its dataset is, how noisy it came out."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hydra.experimental.callback import Callback

if TYPE_CHECKING:
    from omegaconf import DictConfig

    from ..config import FactoryConfig
    from ..scheduler.results import RunReport

_RESULT = "result.json"


def note_result(directory: Path, config: FactoryConfig, report: RunReport, exit_code: int) -> None:
    """Within a sweep, leave this point's row where the table is made from; else do nothing.

    A file and not a variable, because a launcher may run the point on another machine.
    """
    from hydra.core.hydra_config import HydraConfig
    from hydra.types import RunMode

    from ..dataset.describe.quality import mean_psnr_db

    if not HydraConfig.initialized() or HydraConfig.get().mode != RunMode.MULTIRUN:
        return
    hydra = HydraConfig.get()
    row: dict[str, Any] = dict(
        word.lstrip("+").split("=", 1) for word in hydra.overrides.task if "=" in word
    )
    row |= {
        "pairs": report.samples,
        "failed": len(report.failures),
        "noisy_psnr_db": round(mean_psnr_db(directory), 2),
        "exit_code": exit_code,
        "dataset": str(directory),
    }
    folder = Path(hydra.runtime.output_dir)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / _RESULT).write_text(json.dumps(row))


class SweepTable(Callback):
    """Hydra callback: the points of a sweep share workers; after the last, print its table."""

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Points that this process makes one after another need not start workers each.

        `run_app` stops them: after an error Hydra calls nobody back.
        """
        from ..scheduler.workers.kept import keep_workers

        keep_workers()

    def on_multirun_end(self, config: DictConfig, **kwargs: Any) -> None:
        """Collect the rows that the points left under the sweep's folder."""
        folder = Path(config.hydra.sweep.dir)
        points = sorted(
            (path.parent.name for path in folder.glob(f"*/{_RESULT}")),
            key=lambda name: (len(name), name),
        )
        rows = [json.loads((folder / name / _RESULT).read_text()) for name in points]
        if not rows:
            return
        names = list(dict.fromkeys(key for row in rows for key in row))
        # Settings that all points have in common say nothing in a table of differences.
        always = {"pairs", "failed", "noisy_psnr_db", "exit_code", "dataset"}
        names = [
            name
            for name in names
            if name in always or len({str(row.get(name)) for row in rows}) > 1 or len(rows) == 1
        ]
        with (folder / "sweep.csv").open("w", newline="") as file:
            writer = csv.DictWriter(file, names, extrasaction="ignore")
            writer.writeheader()
            writer.writerows(rows)
        table = markdown(names, [[str(row.get(name, "")) for name in names] for row in rows])
        (folder / "sweep.md").write_text(table)
        print(table, end="")
        print(f"sweep: {folder / 'sweep.md'}")


def markdown(names: list[str], rows: list[list[str]]) -> str:
    """A Markdown table with aligned columns."""
    widths = [max(len(cell) for cell in column) for column in zip(names, *rows, strict=True)]
    lines = [names, ["-" * width for width in widths], *rows]
    return "".join(
        "| "
        + " | ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True))
        + " |\n"
        for line in lines
    )
