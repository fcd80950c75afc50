"""`simnfnd evaluate tune`: the best parameters of every baseline on validation pairs.

Validation pairs are the scenes of the train split that training, too, holds out; the test split is
never looked at.  The result is a file that the report reads.
"""

from __future__ import annotations

import hashlib
import json
from collections import deque
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..factory.errors import FactoryError
from ..factory.files import explain_os_errors, write_atomically
from ..factory.progress import progress_bar
from ..factory.scheduler.workers.tasks import TaskLost, TaskPool
from .filters import REGISTRY
from .filters.base import Baseline, Gray, Parameters
from .methods import Method, shown
from .metrics.fidelity import finite_psnr, psnr
from .metrics.measure import Levels, fit_levels
from .pairs import Item, Pair, items_of, picture
from .runner import MethodFailed, denoised
from .settings import EvaluationSettings
from .store import sources_digest

SCHEMA = "simnfnd-tuned/1"


@dataclass(frozen=True)
class Point:
    """One point of a grid, measured: mean PSNR in dB, plain and with the levels fitted to it."""

    parameters: Parameters
    psnr: float
    psnr_levels: float
    levels: Levels


_Task = tuple[str, int, Parameters, tuple[Item, ...]]
"""Name of a baseline, number of the point in its grid, the point, and the pairs."""


def tune(settings: EvaluationSettings, baselines: Sequence[Baseline], pool: TaskPool) -> list[str]:
    """Tune the baselines and write the file after each.

    What the file already has for the same pairs, grid and program is kept.  Returns lines to show:
    one a baseline, and warnings.  Raises FactoryError for anything that is no readable dataset.
    """
    items = validation_items(settings)
    path = settings.tuned_file
    known = load_tuned(path)
    lost: dict[str, str] = {}
    todo: dict[str, tuple[str, list[Parameters], dict[int, Point]]] = {}
    for baseline in baselines:
        key = _key(baseline, items)
        if known.get(baseline.name, {}).get("key") == key:
            continue
        default = dict(baseline.default)
        grid = [default, *(point for point in baseline.points() if point != default)]
        todo[baseline.name] = key, grid, {}
    waiting = deque(
        (name, number, point, tuple(items))
        for name, (_, grid, _) in todo.items()
        for number, point in enumerate(grid)
    )
    limit_s = settings.image_timeout_s * len(items)
    with progress_bar(total=len(waiting), unit="point", desc="tuning") as bar:
        for (name, number, *_), found in pool.run(_measure_point, waiting, lambda _: limit_s):
            bar.update()
            if not isinstance(found, Point):
                lost.setdefault(name, found.reason if isinstance(found, TaskLost) else found)
                continue
            key, grid, points = todo[name]
            points[number] = found
            if len(points) == len(grid) and name not in lost:
                # In the order of the grid, whichever came first.
                whole = [point for _, point in sorted(points.items())]
                known[name] = {"key": key, **_entry(REGISTRY[name], whole)}
                _save(path, known, items)
    return [_line(b.name, known, lost) for b in baselines] + [f"tuned: {path}"]


def validation_items(settings: EvaluationSettings) -> list[Item]:
    """The pairs to tune on: those that `simnfnd train` validates on, with the same seed."""
    try:
        # torch takes seconds to import; the split must be the very one of training.
        from ..models.data.pairs import hold_out, read_table, spread
    except ImportError as error:
        raise FactoryError(
            'tune shares the validation split of models: pip install "simnfnd[train]"'
        ) from error
    root, tuning = Path(settings.dataset.dir), settings.tuning
    _, held = hold_out(read_table(root, "train").samples, tuning.validation, settings.seed)
    places = {(str(sample.path), sample.row) for sample in spread(held, tuning.pairs)}
    return [item for item in items_of(root, "train") if item.place in places]


def load_tuned(path: Path) -> dict[str, Any]:
    """Baseline name -> entry of a tuned file; empty when there is none.

    Raises FactoryError when the file is not one of ours.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if content["schema"] != SCHEMA:
            raise ValueError(f"schema {content['schema']!r}")
        baselines: dict[str, Any] = content["baselines"]
        return {name: entry for name, entry in baselines.items() if name in REGISTRY}
    except (FileNotFoundError, NotADirectoryError):
        return {}
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise FactoryError(
            f"tuning.file={path}: not a file that `evaluation tune` wrote; remove it"
        ) from error


def _measure_point(task: _Task) -> Point | str:
    """One point on all pairs, or why it failed."""
    name, _, parameters, items = task
    method = Method(name, "", parameters)
    try:
        outputs = [denoised(method, Pair(item, 0.0, texture=False), "cpu")[0] for item in items]
    except MethodFailed as error:
        return str(error)
    cleans = [picture(item.place).clean for item in items]
    levels = fit_levels(zip(outputs, cleans, strict=True))
    corrected = [levels(output) for output in outputs]
    return Point(parameters, _mean_psnr(outputs, cleans), _mean_psnr(corrected, cleans), levels)


def _mean_psnr(images: list[Gray], cleans: list[Gray]) -> float:
    pairs = zip(cleans, images, strict=True)
    return float(np.mean([finite_psnr(psnr(*pair, data_range=1.0)) for pair in pairs]))


def _entry(baseline: Baseline, points: list[Point]) -> dict[str, Any]:
    """The file's content for one baseline; of equal points the first (the default) wins."""
    grid = baseline.points()
    inside = [p for p in points if p.parameters in grid] or points
    plain = max(inside, key=lambda point: point.psnr)
    level = max(inside, key=lambda point: point.psnr_levels)
    return {
        "default": asdict(points[0]),
        "tuned": asdict(plain),
        "tuned_levels": asdict(level),
        "points": [asdict(point) for point in points],
    }


def _key(baseline: Baseline, items: list[Item]) -> str:
    """Changes with the pairs, the grid, the default and the program of the method."""
    pairs = [[item.shard, item.place[1], item.group, item.variant] for item in items]
    files = sorted({item.place[0] for item in items})
    sizes = [Path(file).stat().st_size for file in files]
    program = sources_digest(Path(__file__).parent / "filters")
    parts = [baseline.name, dict(baseline.default), dict(baseline.grid), program, pairs, sizes]
    return hashlib.blake2b(json.dumps(parts).encode(), digest_size=12).hexdigest()


def _save(path: Path, known: dict[str, Any], items: list[Item]) -> None:
    content = {
        "schema": SCHEMA,
        "validation": [f"{item.shard}#{item.place[1]}" for item in items],
        "baselines": {name: known[name] for name in REGISTRY if name in known},
    }
    text = json.dumps(content, indent=1, allow_nan=False) + "\n"
    with explain_os_errors(path, "tuning.file"):
        path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, text.encode(), durable=False, key="tuning.file")


def _line(name: str, known: dict[str, Any], lost: dict[str, str]) -> str:
    if name in lost:
        return f"{name}: lost ({lost[name]})"
    entry = known[name]
    best, levels = entry["tuned"], entry["tuned_levels"]
    return (
        f"{name}: {entry['default']['psnr']:.2f} dB by default, {best['psnr']:.2f} tuned"
        f"{shown(best['parameters'])}, {levels['psnr_levels']:.2f} with levels"
        f"{shown(levels['parameters'])}"
    )
