"""The best parameters of filters on images with references, and the file that keeps them.

A line search changes one parameter after the other along its grid, then by half a step.

`simnfnd evaluate tune` works on validation pairs: those scenes of the train split that training,
too, holds out.  The test split is never read.  `simnfnd evaluate real` works on frames with
references.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from ...factory.common.array_types import Bools
from ...factory.common.errors import FactoryError
from ...factory.common.files import explain_os_errors, write_atomically
from ...factory.common.progress import Bar
from ...factory.common.small_files import read_regular
from ...factory.common.workers.tasks import TaskLost, TaskPool
from ..filters import REGISTRY, Baseline, Parameters, method_of
from ..metrics.fidelity import finite_psnr, psnr
from ..metrics.measure import Grey, Levels, fit_levels, with_levels
from .methods import reason, shown
from .pairs import JudgedPair, items_of, pair_images
from .settings import EvaluationSettings

SCHEMA = "simnfnd-tuned/1"

_SLOW = ("bm3d",)  # filters that are tuned on one frame in `_SLOWER`
_SLOWER = 4


@dataclass(frozen=True, eq=False)
class TuningImage:
    """An image to tune on.

    noisy, reference: (H, W) in 0..1.  mask: (H, W) bool, what counts.
    """

    noisy: Grey
    reference: Grey
    mask: Bools


@dataclass(frozen=True, eq=False)
class TuningTask:
    """A filter to be tuned on samples.  fold: whom the result is for."""

    baseline: str
    samples: tuple[TuningImage, ...]
    fold: int = 0


@dataclass(frozen=True)
class Point:
    """Parameters, measured: mean PSNR in dB, plain and with the levels fitted to it."""

    parameters: Parameters
    psnr: float
    psnr_levels: float
    levels: Levels


def tune(settings: EvaluationSettings, baselines: Sequence[Baseline], pool: TaskPool) -> list[str]:
    """Tune the baselines and write the file after each.

    What the file already has for the same pairs and grid is kept.  Returns lines to show:
    one per baseline, and warnings.  Raises FactoryError for anything that is no readable dataset.
    """
    items = validation_items(settings)
    path = settings.tuned_file
    known = load_tuned(path)
    keys = {baseline.name: _key(baseline, items) for baseline in baselines}
    pairs = [pair_images(item.place) for item in items]
    samples = tuple(
        TuningImage(pair.noisy, pair.clean, np.ones(pair.clean.shape, bool)) for pair in pairs
    )
    tasks = [
        TuningTask(name, samples)
        for name, key in keys.items()
        if known.get(name, {}).get("key") != key
    ]
    lost: dict[str, str] = {}
    for task, outcome in run_tasks(on_pairs, tasks, pool, settings.image_timeout_s):
        if isinstance(outcome, str):
            lost[task.baseline] = outcome
        else:
            known[task.baseline] = {"key": keys[task.baseline], **outcome}
            _save(path, known, items)
    return [_line(name, known, lost) for name in keys] + [f"tuned: {path}"]


def run_tasks(
    function: Callable[[TuningTask], dict[str, Any] | str],
    tasks: Sequence[TuningTask],
    pool: TaskPool,
    image_timeout_s: float,
) -> Iterator[tuple[TuningTask, dict[str, Any] | str]]:
    """Each task with what `function` found, or why it failed, as they are done."""
    if not tasks:
        return

    def limit_s(task: TuningTask) -> float:
        points = len(method_of(task.baseline).points()) + 1
        return image_timeout_s * len(task.samples) * points

    with Bar(total=len(tasks), unit="filter", desc="tuning") as bar:
        for task, outcome in pool.run(function, deque(tasks), limit_s):
            bar.update()
            yield task, outcome.reason if isinstance(outcome, TaskLost) else outcome


def on_pairs(task: TuningTask) -> dict[str, Any] | str:
    """The default, the best, and the best after levels, as in the file; or why not."""
    baseline = method_of(task.baseline)

    @cache
    def measured(*values: float) -> Point:
        return _measured(baseline, dict(zip(baseline.default, values, strict=True)), task.samples)

    try:
        best = {
            "default": dict(baseline.default),
            "tuned": line_search(baseline, lambda *values: measured(*values).psnr),
            "tuned_levels": line_search(baseline, lambda *values: measured(*values).psnr_levels),
        }
        return {name: asdict(measured(*point.values())) for name, point in best.items()}
    except Exception as error:  # a method's own defect must not take the others along
        return reason(error)


def on_frames(task: TuningTask) -> Parameters | str:
    """The best parameters after one gain and offset an image; or why not."""
    baseline = method_of(task.baseline)
    samples = task.samples[:: _SLOWER if baseline.name in _SLOW else 1]

    @cache
    def score(*values: float) -> float:
        point = dict(zip(baseline.default, values, strict=True))
        images = [
            with_levels(baseline(sample.noisy, point), sample.reference, sample.mask)
            for sample in samples
        ]
        return _mean_psnr(images, samples)

    try:
        return line_search(baseline, score)
    except Exception as error:  # as above
        return reason(error)


def _measured(baseline: Baseline, point: Parameters, samples: Sequence[TuningImage]) -> Point:
    images = [baseline(sample.noisy, point) for sample in samples]
    levels = fit_levels((i, s.reference) for i, s in zip(images, samples, strict=True))
    psnr_levels = _mean_psnr([levels(image) for image in images], samples)
    return Point(point, _mean_psnr(images, samples), psnr_levels, levels)


def _mean_psnr(images: Sequence[Grey], samples: Sequence[TuningImage]) -> float:
    return float(np.mean([
        finite_psnr(psnr(sample.reference, image, data_range=1.0, mask=sample.mask))
        for image, sample in zip(images, samples, strict=True)
    ]))  # fmt: skip


def validation_items(settings: EvaluationSettings) -> list[JudgedPair]:
    """The pairs to tune on: those that `simnfnd train` validates on, with the same seed."""
    try:
        # torch takes seconds to import; the split must be the very one of training.
        from ...models.data.pairs import hold_out, read_table, spread
    except ImportError as error:
        raise FactoryError(
            'tune shares the validation split of models: pip install "simnfnd[train]"'
        ) from error
    root = Path(settings.dataset.dir)
    tuning = settings.tuning
    _, held = hold_out(read_table(root, "train").samples, tuning.validation, settings.seed)
    places = {(str(sample.path), sample.row) for sample in spread(held, tuning.pairs)}
    return [item for item in items_of(root, "train") if item.place in places]


def load_tuned(path: Path) -> dict[str, Any]:
    """Baseline name -> entry of a tuned file; empty when there is none.

    Raises FactoryError when the file is not one of ours.
    """
    try:
        content = json.loads(read_regular(path))
        if content["schema"] != SCHEMA:
            raise ValueError(f"schema {content['schema']!r}")
        baselines: dict[str, Any] = content["baselines"]
        return {name: entry for name, entry in baselines.items() if name in REGISTRY}
    except (FileNotFoundError, NotADirectoryError):
        return {}
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise FactoryError(
            f"tuning.file={path}: not a file that `evaluate tune` wrote; remove it"
        ) from error


def _key(baseline: Baseline, items: list[JudgedPair]) -> str:
    """Changes with the pairs, the grid and the default."""
    pairs = [item.key for item in items]
    parts = [baseline.name, dict(baseline.default), dict(baseline.grid), pairs]
    return hashlib.blake2b(json.dumps(parts).encode(), digest_size=12).hexdigest()


def _save(path: Path, known: dict[str, Any], items: list[JudgedPair]) -> None:
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
    best = entry["tuned"]
    levels = entry["tuned_levels"]
    return (
        f"{name}: {entry['default']['psnr']:.2f} dB by default, {best['psnr']:.2f} tuned"
        f"{shown(best['parameters'])}, {levels['psnr_levels']:.2f} with levels"
        f"{shown(levels['parameters'])}"
    )


_ROUNDS = 2
_LEAST = 1e-3  # of the score; less is no gain


def line_search(baseline: Baseline, score: Callable[..., float]) -> Parameters:
    """The best point.  score: of parameters in the order of the defaults, high is good; cached."""
    best = dict(baseline.default)
    for turn in range(_ROUNDS):
        before = best
        for name, axis in baseline.grid.items():
            above = [value for value in axis if value > best[name]]
            below = [value for value in reversed(axis) if value < best[name]]
            start = best
            for outwards in (above, below):
                best = _along(start, best, name, outwards, score)
        if best == before or (turn == 0 and len(baseline.grid) == 1):
            break
    for name, axis in baseline.grid.items():
        # Half way, in ratio, to the neighbours on the grid.
        if all(isinstance(value, float) for value in axis) and best[name] in axis:
            place = axis.index(best[name])
            neighbours = (*axis[max(place - 1, 0) : place], *axis[place + 1 : place + 2])
            halves = [float(f"{math.sqrt(best[name] * value):.3g}") for value in neighbours]
            best = _along(best, best, name, halves, score)
    return best


def _along(
    start: Parameters,
    best: Parameters,
    name: str,
    values: Sequence[float],
    score: Callable[..., float],
) -> Parameters:
    """The best of a point and of `start` with values of one parameter, until two fall in a row."""
    last = score(*start.values())
    falls = 0
    for value in values:
        point = {**start, name: value}
        now = score(*point.values())
        if now > score(*best.values()) + _LEAST:
            best = point
        falls = falls + 1 if now < last else 0
        last = now
        if falls == 2:
            break
    return best
