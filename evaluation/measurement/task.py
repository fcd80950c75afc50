"""What a worker of the report does: methods on a few pictures, measured."""

from __future__ import annotations

import math
import time
from dataclasses import asdict, dataclass
from functools import lru_cache

from ...factory.errors import FactoryError
from ..data.pairs import Item, input_of, picture
from ..filters.base import Gray
from ..methods.apply import denoised
from ..methods.given import read_given
from ..methods.method import Method, reason
from ..methods.networks import network
from ..metrics.checks import MetricError, checked_pair
from ..metrics.fidelity import SSIM_SMALLEST
from ..metrics.measure import score_pair
from ..metrics.reference import Compared
from ..metrics.texture import Scene
from .store import Figures


@dataclass(frozen=True)
class Task:
    """Some methods on some pictures; the unit that travels to a worker."""

    methods: tuple[Method, ...]
    items: tuple[Item, ...]
    shadow_threshold: float
    texture: bool
    device: str
    tries: int = 0


Found = list[tuple[str | None, list[Figures]]]
"""One entry a method: why it failed, or the figures of each picture."""


def measure_task(task: Task) -> Found:
    """Run the methods and measure what they give.  FactoryError for a damaged picture."""
    found: Found = []
    outputs: dict[str, tuple[str | None, list[Gray], list[float]]] = {}
    for method in task.methods:
        if method.output not in outputs:
            outputs[method.output] = filtered(method, task.items, task.device)
        error, images, times = outputs[method.output]
        if error is not None:
            found.append((error, []))
            continue
        figures = []
        for item, image, milliseconds in zip(task.items, images, times, strict=True):
            corrected = image if method.levels is None else method.levels(image)
            measured = _figures(corrected, item, task)
            figures.append({**measured, "milliseconds": milliseconds})
        found.append((None, figures))
    return found


def filtered(
    method: Method, items: tuple[Item, ...], device: str
) -> tuple[str | None, list[Gray], list[float]]:
    """(why it failed or None, the method's pictures without levels, milliseconds of each)."""
    looks = method.looks
    # A network sees a single picture several times where there are no others.
    if looks and method.weights is None and any(len(item.looks) < 2 for item in items):
        return "needs several noise variants a frame", [], []
    images, times = [], []
    clock = time.process_time  # what other processes take does not count
    if method.weights is not None:
        try:
            # Loaded before the clock runs.  A processor that waits for a GPU seems idle.
            if network(method.weights, device).on_gpu:
                clock = time.perf_counter
        except FactoryError as error:
            return reason(error), [], []
    for item in items:
        image = input_of(item, looks)
        start = clock()
        try:
            if method.folder is not None:
                images.append(read_given(method.folder, item))
            else:
                images.append(denoised(method, image, device, item.place))
        except Exception as error:  # a method that crashes loses its row, not the report
            return reason(error), [], []
        seconds = math.nan if method.folder is not None else clock() - start
        times.append(1000 * seconds)
    return None, images, times


@lru_cache(maxsize=8)
def _scene(item: Item) -> Scene:
    """What all methods share on a pair."""
    return Scene(picture(item.place))


def _figures(image: Gray, item: Item, task: Task) -> Figures:
    scene = _scene(item)
    pair = scene.pair
    try:
        _, checked = checked_pair(pair.clean, image, 1.0, smallest=SSIM_SMALLEST)
        compared = Compared(scene.reference, checked)
        quality = score_pair(
            image,
            pair.clean,
            pair.shadow,
            data_range=1.0,
            shadow_threshold=task.shadow_threshold,
            sector=pair.sector,
            compared=compared,
        )
        more = asdict(scene.texture(compared)) if task.texture else {}
    except MetricError as error:
        raise FactoryError(f"{item.shard}: sample {item.place[1]}: {error}") from error
    figures: Figures = {**asdict(quality), **more}
    if not pair.has_shadow:
        figures.update(
            dict.fromkeys(("shadow_iou", "shadow_residual", "false_light_rate"), math.nan)
        )
    return figures
