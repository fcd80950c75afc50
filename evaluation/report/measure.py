"""The pairs of a dataset through the engine: rows to report, and examples to look at."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from ...factory.errors import FactoryError
from ...factory.progress import progress_bar
from ...factory.scheduler.workers.tasks import TaskPool
from ..filters.base import Gray
from ..image_files import images_in, read_gray
from ..methods.method import NOISY, Method
from ..metrics.measure import Figures
from ..pairs import Item, Pair, picture
from ..runner import FigureStore, Subject, run
from ..settings import EvaluationSettings
from .content import Row, rows_of

if TYPE_CHECKING:
    from ...factory.sonar.geometry import FanGeometry

_CHUNK = 4


def measured_rows(
    settings: EvaluationSettings,
    items: Sequence[Item],
    methods: Sequence[Method],
    store: FigureStore,
    pool: TaskPool,
    *,
    title: str = "measuring",
) -> list[Row]:
    """The rows of the methods, the noisy images' first; what the store has is not done again.

    Raises FactoryError for a dataset that cannot be read.
    """
    every = list({method.label: method for method in (NOISY, *methods)}.values())
    picture.cache_clear()  # files may have changed since the last report of this process
    total = len(every) * len(items)
    with progress_bar(total=total, unit="image", desc=title) as bar:
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
    """images: label -> (H, W) float32 in 0..1, `noisy` first and `clean`, where known, last.

    psnr: label -> dB against clean; empty without it.
    """

    title: str
    images: dict[str, Gray]
    psnr: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Alone:
    """An image file without a clean one; a `simnfnd.evaluation.runner.Subject`."""

    file: str

    def key(self, method: Method) -> str:
        """See `Subject`."""
        return self.file

    def seen(self, method: Method) -> Gray | None:
        """See `Subject`; there are no further looks at it."""
        return None if method.looks else read_gray(Path(self.file))

    def geometry(self) -> FanGeometry | None:
        """See `Subject`."""
        return None

    def given(self, method: Method) -> Gray | None:
        """See `Subject`."""
        return None

    def measure(self, image: Gray, method: Method) -> Figures:
        """Nothing, without a truth."""
        return {}


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
    chosen = [items[int(ranked[place])] for place in _evenly(len(items), count)]
    made = _shown(settings, _pairs(settings, chosen), methods, pool)
    examples = []
    for item, (images, psnr) in zip(chosen, made, strict=True):
        title = f"{item.scene} {item.frame}" + (f" #{item.variant}" if item.variant else "")
        examples.append(Example(title, {**images, "clean": picture(item.place).clean}, psnr))
    return examples


def real_examples(
    settings: EvaluationSettings, methods: Sequence[Method], pool: TaskPool
) -> list[Example]:
    """The images of `real=[...]`, at most `page.examples` of each folder, evenly over its names.

    FactoryError when a file is no gray image or a folder has none.
    """
    files: list[Path] = []
    for text in settings.real:
        path = Path(text).expanduser()
        if path.is_dir():
            inside = images_in(path)
            if not inside:
                raise FactoryError(f"real: {path}: holds no images")
            count = min(max(1, settings.page.examples), len(inside))
            files += [inside[place] for place in _evenly(len(inside), count)]
        elif path.is_file():
            files.append(path)
        else:
            raise FactoryError(f"real: {path}: no such file or folder")
    for file in files:
        read_gray(file)
    subjects = {number: Alone(str(file)) for number, file in enumerate(files)}
    made = _shown(settings, subjects, methods, pool)
    return [Example(file.stem, images) for file, (images, _) in zip(files, made, strict=True)]


def as_data_uri(image: Gray) -> str:
    """The picture in 8 bits as a lossless data: URI."""
    pixels = np.rint(np.clip(image, 0, 1) * 255).astype(np.uint8)
    _, content = cv2.imencode(".png", pixels, [cv2.IMWRITE_PNG_COMPRESSION, 9])
    return "data:image/png;base64," + base64.b64encode(content.tobytes()).decode("ascii")


def _shown(
    settings: EvaluationSettings,
    subjects: Mapping[int, Subject],
    methods: Sequence[Method],
    pool: TaskPool,
) -> list[tuple[dict[str, Gray], dict[str, float]]]:
    """(label -> image, label -> PSNR) of each; a method that fails is left out."""
    every = [NOISY, *methods]
    made = run(
        every,
        [subjects],
        pool,
        device=settings.device,
        timeout_s=settings.image_timeout_s,
        keep=lambda _: True,
    )
    found = []
    for number in subjects:
        labels = [one.label for one in every if (one.label, number) in made.images]
        figures = {label: made.figures[label][number] for label in labels}
        psnr = {label: figures[label]["psnr"] for label in labels if "psnr" in figures[label]}
        found.append(({label: made.images[label, number] for label in labels}, psnr))
    return found


def _pairs(settings: EvaluationSettings, items: Sequence[Item]) -> dict[int, Subject]:
    threshold, texture = settings.shadow_threshold, settings.texture
    return {number: Pair(item, threshold, texture) for number, item in enumerate(items)}


def _evenly(length: int, count: int) -> list[int]:
    """`count` of the places 0 .. length - 1, both ends included."""
    places = np.linspace(0, length - 1, count).round().astype(int)
    return [int(place) for place in np.unique(places)]
