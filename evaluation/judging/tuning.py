"""The best parameters of filters on images with references, and the file that keeps them.

A line search changes one parameter after the other along its grid, then by half a step.

`simnfnd evaluate tune` works on validation pairs: those scenes of the train split that training,
too, holds out.  The test split is never read.  `simnfnd evaluate real` works on frames with
references, on the middle of each, half as high and half as wide; the best points are compared on
whole frames.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
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
from ..metrics.measure import Grey, Levels, fit_levels
from .methods import reason, shown
from .pairs import JudgedPair, items_of, pair_images
from .settings import EvaluationSettings

SCHEMA = "simnfnd-tuned/1"

_SLOW = ("bm3d",)  # filters that are tuned on fewer frames
_SLOWER = 4  # of which they see one in this many
_BEST = 2  # points that are compared on whole frames
_LEAST_SIDE = 96  # pixels of the middle of a frame


@dataclass(frozen=True, eq=False)
class TuningImage:
    """An image to tune on.

    noisy, reference: (H, W) in 0..1.  mask: (H, W) bool, what counts; None: all.
    """

    noisy: Grey
    reference: Grey
    mask: Bools | None = None


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
    lost: dict[str, str] = {}
    keys = {baseline.name: _key(baseline, items) for baseline in baselines}
    pairs = [pair_images(item.place) for item in items]
    samples = tuple(TuningImage(pair.noisy, pair.clean) for pair in pairs)
    tasks = [
        TuningTask(name, samples)
        for name, key in keys.items()
        if known.get(name, {}).get("key") != key
    ]

    def limit_s(task: TuningTask) -> float:
        points = len(method_of(task.baseline).points()) + 1
        return settings.image_timeout_s * len(items) * points

    for task, outcome in run_tasks(on_pairs, tasks, pool, limit_s):
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
    limit_s: Callable[[TuningTask], float],
) -> Iterator[tuple[TuningTask, dict[str, Any] | str]]:
    """Each task with what `function` found, or why it failed, as they are done."""
    if not tasks:
        return
    with Bar(total=len(tasks), unit="filter", desc="tuning") as bar:
        for task, outcome in pool.run(function, deque(tasks), limit_s):
            bar.update()
            yield task, outcome.reason if isinstance(outcome, TaskLost) else outcome


def on_pairs(task: TuningTask) -> dict[str, Any] | str:
    """The default, the best, and the best after levels, as in the file; or why not."""
    baseline = method_of(task.baseline)
    known = dict[tuple[float, ...], Point]()

    def measured(point: Parameters) -> Point:
        key = tuple(point.values())
        if key not in known:
            known[key] = _measured(baseline, point, task.samples)
        return known[key]

    try:
        plain, *_ = line_search(baseline, lambda point: measured(point).psnr)
        fitted, *_ = line_search(baseline, lambda point: measured(point).psnr_levels)
        best = {"default": dict(baseline.default), "tuned": plain, "tuned_levels": fitted}
        return {name: asdict(measured(point)) for name, point in best.items()}
    except Exception as error:  # a method's own defect must not take the others along
        return reason(error)


def on_frames(task: TuningTask) -> Parameters | str:
    """The best parameters after one gain and offset an image; or why not."""
    baseline = method_of(task.baseline)
    try:
        frames = task.samples[:: _SLOWER if baseline.name in _SLOW else 1]
        middles = tuple(_middle(frame) for frame in frames)
        points = line_search(baseline, lambda point: _score(baseline, point, middles))
        return max(points[:_BEST], key=lambda point: _score(baseline, point, frames))
    except Exception as error:  # as above
        return reason(error)


def _mean_psnr(images: Sequence[Grey], samples: Sequence[TuningImage]) -> float:
    return float(np.mean([
        finite_psnr(psnr(sample.reference, image, data_range=1.0, mask=sample.mask))
        for image, sample in zip(images, samples, strict=True)
    ]))  # fmt: skip


def _measured(baseline: Baseline, point: Parameters, samples: Sequence[TuningImage]) -> Point:
    images = [baseline(sample.noisy, point) for sample in samples]
    levels = fit_levels((i, s.reference) for i, s in zip(images, samples, strict=True))
    corrected = [levels(image) for image in images]
    return Point(point, _mean_psnr(images, samples), _mean_psnr(corrected, samples), levels)


def _score(baseline: Baseline, point: Parameters, samples: Sequence[TuningImage]) -> float:
    images = [baseline(sample.noisy, point) for sample in samples]
    fitted = [
        fit_levels([(image[sample.mask], sample.reference[sample.mask])])(image)
        for image, sample in zip(images, samples, strict=True)
    ]
    return _mean_psnr(fitted, samples)


def _middle(frame: TuningImage) -> TuningImage:
    """The middle of what is judged of a frame, half as high and half as wide."""
    cut = []
    assert frame.mask is not None
    for places, size in zip(np.nonzero(frame.mask), frame.mask.shape, strict=True):
        side = min(max(size // 2, _LEAST_SIDE), size)
        first = min(max(int(places.mean()) - side // 2, 0), size - side)
        cut.append(slice(first, first + side))
    part = tuple(cut)
    if not frame.mask[part].any():
        return frame
    planes = {n: np.ascontiguousarray(getattr(frame, n)[part]) for n in ("noisy", "reference")}
    return replace(frame, **planes, mask=np.ascontiguousarray(frame.mask[part]))


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


def line_search(baseline: Baseline, measured: Callable[[Parameters], float]) -> list[Parameters]:
    """The points that were tried, the best first.  measured: the score of one, high is good."""
    known: dict[tuple[float, ...], tuple[float, Parameters]] = {}

    def value(point: Parameters) -> float:
        key = tuple(point.values())
        if key not in known:
            known[key] = measured(point), point
        return known[key][0]

    best = dict(baseline.default)
    value(best)
    for turn in range(_ROUNDS):
        before = best
        for name, axis in baseline.grid.items():
            best = _along(best, name, axis, value)
        if best == before or (turn == 0 and len(baseline.grid) == 1):
            break
    for name, axis in baseline.grid.items():
        best = _finer(best, name, axis, value)
    # Among equal points the first one counts, which is nearer to the default.
    tried = sorted(
        known.values(), key=lambda point_score: (point_score[1] != best, -point_score[0])
    )
    return [point for _, point in tried]


def _along(
    start: Parameters, name: str, axis: Sequence[float], value: Callable[[Parameters], float]
) -> Parameters:
    """The best value of one parameter, from the present one outwards until two falls."""
    best = start
    top = value(start)
    above = [step_value for step_value in axis if step_value > start[name]]
    below = [step_value for step_value in reversed(axis) if step_value < start[name]]
    for outwards in (above, below):
        last = value(start)
        falls = 0
        for step_value in outwards:
            point = {**start, name: step_value}
            now = value(point)
            if now > top + _LEAST:
                best = point
                top = now
            falls = falls + 1 if now < last else 0
            last = now
            if falls == 2:
                break
    return best


def _finer(
    start: Parameters, name: str, axis: Sequence[float], value: Callable[[Parameters], float]
) -> Parameters:
    """The best of the present value and those half way, in ratio, to its neighbours on the grid."""
    if not all(isinstance(step_value, float) for step_value in axis) or start[name] not in axis:
        return start
    place = axis.index(start[name])
    best = start
    top = value(start)
    for neighbour in (*axis[max(place - 1, 0) : place], *axis[place + 1 : place + 2]):
        point = {**start, name: float(f"{math.sqrt(start[name] * neighbour):.3g}")}
        if (now := value(point)) > top + _LEAST:
            best = point
            top = now
    return best
