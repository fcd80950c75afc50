"""The pairs of a dataset through the engine: rows to report, and examples to look at."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from ...factory.progress import progress_bar
from ...factory.scheduler.workers.tasks import TaskPool
from ..filters.base import Gray
from ..methods import NOISY, Method
from ..pairs import Item, Pair, picture
from ..runner import SECONDS, Measured, Subject, run
from ..settings import EvaluationSettings
from ..store import FigureStore

_CHUNK = 4


@dataclass(frozen=True)
class Row:
    """A measured method.  lost: why there are no figures.

    values: metric -> (N,) figures in the order of the pairs, NaN where it does not exist.
    """

    method: Method
    values: dict[str, npt.NDArray[np.float64]] = field(default_factory=dict)
    milliseconds: float = math.nan
    lost: str | None = None


def rows_of(measured: Measured, methods: Sequence[Method]) -> list[Row]:
    """What the engine measured, a row a method, in their order."""
    found = []
    for method in methods:
        if method.label in measured.lost:
            found.append(Row(method, lost=measured.lost[method.label]))
            continue
        figures = [one for _, one in sorted(measured.figures[method.label].items())]
        values = {name: np.array([one[name] for one in figures], float) for name in figures[0]}
        seconds = values.pop(SECONDS)
        found.append(Row(method, values, 1000 * float(np.median(seconds))))
    return found


def measured_rows(
    settings: EvaluationSettings,
    items: Sequence[Item],
    methods: Sequence[Method],
    store: FigureStore,
    pool: TaskPool,
) -> list[Row]:
    """The rows of the methods, the noisy images' first; what the store has is not done again.

    Raises FactoryError for a dataset that cannot be read.
    """
    every = list({method.label: method for method in (NOISY, *methods)}.values())
    picture.cache_clear()  # files may have changed since the last report of this process
    total = len(every) * len(items)
    with progress_bar(total=total, unit="image", desc="measuring") as bar:
        measured = run(
            every,
            [_pairs(settings, items)],
            pool,
            device=settings.device,
            timeout_s=settings.image_timeout_s,
            store=store,
            chunk=_CHUNK,
            tick=bar.update,
        )
    return rows_of(measured, every)


@dataclass(frozen=True)
class Example:
    """images: label -> (H, W) float32 in 0..1, `noisy` first and `clean` last.

    psnr: label -> dB against clean.
    """

    title: str
    images: dict[str, Gray]
    psnr: dict[str, float]


def examples_of(
    settings: EvaluationSettings,
    items: Sequence[Item],
    noisy: Row,
    methods: Sequence[Method],
    pool: TaskPool,
) -> list[Example]:
    """Pairs from the worst to the best by the PSNR of the noisy image, evenly between."""
    count = min(settings.page.examples, len(items))
    ranked = np.argsort(noisy.values["psnr"], kind="stable")
    places = np.unique(np.linspace(0, len(items) - 1, count).round().astype(int))
    chosen = [items[number] for number in ranked[places]]
    every = [NOISY, *methods]
    made = run(
        every,
        [_pairs(settings, chosen)],
        pool,
        device=settings.device,
        timeout_s=settings.image_timeout_s,
        keep=lambda _: True,
    )
    examples = []
    for number, item in enumerate(chosen):
        # A method that fails is left out.
        labels = [one.label for one in every if (one.label, number) in made.images]
        images = {label: made.images[label, number] for label in labels}
        psnr = {label: made.figures[label][number]["psnr"] for label in labels}
        title = f"{item.scene} {item.frame}" + (f" #{item.variant}" if item.variant else "")
        examples.append(Example(title, {**images, "clean": picture(item.place).clean}, psnr))
    return examples


def _pairs(settings: EvaluationSettings, items: Sequence[Item]) -> dict[int, Subject]:
    threshold, texture = settings.shadow_threshold, settings.texture
    return {number: Pair(item, threshold, texture) for number, item in enumerate(items)}
