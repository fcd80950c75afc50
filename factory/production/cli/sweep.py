"""One table of a sweep: what became of every point, where its dataset is, how noisy it came out.

Each point leaves its row as a file, because a launcher may make it on another machine; points
without a row were not begun.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hydra.experimental.callback import Callback

from ...common.errors import FactoryError
from ...common.extras import install_command
from ...common.progress import RunReporter, print_fact, print_warning
from . import markdown
from .sweep_curve import draw_curve

if TYPE_CHECKING:
    from omegaconf import DictConfig

_RESULT = "result.json"
# Figures of noisy against clean images: mean and spread over the pairs.
_FIGURES = ("psnr_db", "psnr_db_std", "ssim", "ssim_std", "gmsd", "gmsd_std")
_ALWAYS = ("pairs", "failed", *_FIGURES, "state", "exit_code", "dataset", "reason")
# Settings that points of one dataset may differ in.
_NO_OTHER_DATASET = ("shard.", "scheduler", "cache.", "hydra", "debug")
# Stands for all images of a point; kept out of the table.
_IMAGES = "images"
# Folder and points (the words of each) of the sweep of this process, until its table is written.
_open: list[tuple[Path, list[list[str]]]] = []
# Lines that points of this process have printed.
_said: set[str] = set()


def each_its_folder(composed: DictConfig) -> None:
    """Within a sweep, drop the folder that a recipe names: every point would write there.

    Raises FactoryError where the words themselves name one folder for points that differ.
    """
    from hydra.core.hydra_config import HydraConfig
    from omegaconf import OmegaConf

    if not in_sweep():
        return
    if "dataset.dir" in _settings(HydraConfig.get().overrides.task):
        _refuse_shared_folder()
        return
    folder = OmegaConf.to_container(composed.dataset, resolve=False)["dir"]  # type: ignore[call-overload, index]
    if folder and "${" not in folder:
        composed.dataset.dir = None


def _refuse_shared_folder() -> None:
    for _, points in _open:
        settings = [_settings(words) for words in points]
        folders = {point["dataset.dir"] for point in settings}
        differing = [
            key
            for key in settings[0]
            if not key.startswith(_NO_OTHER_DATASET)
            and len({point.get(key) for point in settings}) > 1
        ]
        if len(folders) == 1 and "${" not in min(folders) and differing:
            raise FactoryError(
                f"dataset.dir={min(folders)}: {len(points)} points of the sweep would write "
                f"there; leave it out, or give {differing[0]} one value"
            )


def reporter() -> RunReporter:
    """Where a point of a sweep reports: lines that an earlier point has printed are left out."""
    if not in_sweep():
        return RunReporter()
    return RunReporter(fact=_once(print_fact), warning=_once(print_warning))


def _once(tell: Callable[[str], None]) -> Callable[[str], None]:
    def tell_once(text: str) -> None:
        if text not in _said:
            _said.add(text)
            tell(text)

    return tell_once


def in_sweep() -> bool:
    """Whether this is a point of one."""
    from hydra.core.hydra_config import HydraConfig
    from hydra.types import RunMode

    return HydraConfig.initialized() and HydraConfig.get().mode == RunMode.MULTIRUN


def note(**row: Any) -> None:
    """Within a sweep, leave the row of a point; else do nothing."""
    from hydra.core.hydra_config import HydraConfig

    if not in_sweep():
        return
    hydra = HydraConfig.get()
    folder = Path(hydra.runtime.output_dir)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / _RESULT).write_text(json.dumps({**_settings(hydra.overrides.task), **row}))


def _settings(words: Sequence[str]) -> dict[str, str]:
    return dict(word.lstrip("+").split("=", 1) for word in words if "=" in word)


class SweepTable(Callback):
    """Hydra callback: one table tells of all points of a sweep."""

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:
        """`run_app` writes the table: after an error Hydra runs no callbacks."""
        from omegaconf import OmegaConf

        from ...simulation.config.compose import sweep_points

        # The words as typed: a job's number is known in the job alone.
        words: Any = OmegaConf.to_container(config.hydra.overrides.task, resolve=False)
        sweeper: Any = OmegaConf.to_container(config.hydra.sweeper, resolve=False)
        points = sweep_points(words, dict(sweeper.get("params") or {}))
        _open[:] = [(Path(config.hydra.sweep.dir), points)]


def write_table() -> None:
    """Write and print the table of the sweep that this process has made, if it has."""
    from ...dataset.preview import side_by_side

    if not _open:
        return
    folder, points = _open.pop()
    _said.clear()
    rows = []
    for number, words in enumerate(points):
        row: dict[str, Any] = {**_settings(words), "state": "not begun"}
        with suppress(OSError, ValueError):
            row = json.loads((folder / str(number) / _RESULT).read_text())
        rows.append(row)
    own_keys = (key for row in rows for key in row if key not in (*_ALWAYS, _IMAGES))
    names = list(dict.fromkeys(own_keys))
    # Settings that all points have in common say nothing in a table of differences.
    names = [n for n in names if len({str(row.get(n)) for row in rows}) > 1 or len(rows) == 1]
    shown = [*names, *(name for name in _ALWAYS if any(name in row for row in rows))]
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "sweep.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, shown, extrasaction="ignore")
        writer.writeheader()
        writer.writerows(rows)
    table = markdown(shown, [[str(row.get(name, "")) for name in shown] for row in rows])
    (folder / "sweep.md").write_text(table)
    print(table, end="")
    for line in equal_points(rows):
        print(line)
    labels = [", ".join(f"{name}={row.get(name, '')}" for name in names) for row in rows]
    labelled_rows = zip(labels, rows, strict=True)
    datasets = [(label, Path(row["dataset"])) for label, row in labelled_rows if "pairs" in row]
    with suppress(FactoryError, OSError):
        if len(datasets) > 1 and side_by_side(datasets, sheet := folder / "sweep.png"):
            print(f"sweep: {sheet}: the same frames of every point, clean and noisy")
    _write_curve(folder / "sweep.svg", names, rows)
    print(f"sweep: {folder / 'sweep.md'}")


def _write_curve(path: Path, names: Sequence[str], rows: Sequence[Mapping[str, Any]]) -> None:
    try:
        curve = draw_curve(names, rows)
    except ImportError:
        print(f"sweep: {path.name} needs matplotlib: {install_command('figures')}")
        return
    if curve:
        path.write_bytes(curve)
        print(f"sweep: {path}: noise against the swept values")


def equal_points(rows: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """One line for each set of points whose datasets have equal images."""
    numbers_of: dict[str, list[str]] = {}
    for number, row in enumerate(rows):
        if _IMAGES in row:
            numbers_of.setdefault(row[_IMAGES], []).append(str(number))
    for numbers in numbers_of.values():
        if len(numbers) > 1:
            yield (
                f"sweep: points {', '.join(numbers)} have equal images: their settings differ in "
                "nothing that acts on them"
            )
