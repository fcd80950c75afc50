"""A few pairs with what each method makes of them, for people to look at."""

from __future__ import annotations

import base64
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

from ...factory.errors import FactoryError
from ...factory.scheduler.workers.tasks import TaskLost, TaskPool
from ..data.image_pairs import images_in, read_gray
from ..data.pairs import Item, input_of, picture
from ..filters.base import Gray
from ..measurement.rows import Row
from ..methods.apply import denoised
from ..methods.given import read_given
from ..methods.method import Method
from ..metrics.fidelity import finite_psnr, psnr
from ..settings import EvaluationSettings


@dataclass(frozen=True)
class Example:
    """images: label -> (H, W) float32 in 0..1, `noisy` first and `clean`, where known, last.

    psnr: label -> dB against clean; empty without it.
    """

    title: str
    images: dict[str, Gray]
    psnr: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class _Task:
    number: int
    method: Method
    item: Item | None
    file: str
    device: str


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
    places = np.unique(np.linspace(0, len(items) - 1, count).round().astype(int)) if count else []
    chosen = [items[int(ranked[place])] for place in places]
    made = _made(settings, methods, pool, [(item, "") for item in chosen])
    examples = []
    for item, images in zip(chosen, made, strict=True):
        pair = picture(item.place)
        every = {"noisy": pair.noisy, **images, "clean": pair.clean}
        figures = {
            label: finite_psnr(psnr(pair.clean, image, data_range=1.0))
            for label, image in every.items()
            if label != "clean"
        }
        title = f"{item.scene} {item.frame}" + (f" #{item.variant}" if item.variant else "")
        examples.append(Example(title, every, figures))
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
            places = np.unique(np.linspace(0, len(inside) - 1, count).round().astype(int))
            files += [inside[place] for place in places]
        elif path.is_file():
            files.append(path)
        else:
            raise FactoryError(f"real: {path}: no such file or folder")
    noisy = [read_gray(file) for file in files]
    made = _made(settings, methods, pool, [(None, str(file)) for file in files])
    return [
        Example(file.stem, {"noisy": image, **images})
        for file, image, images in zip(files, noisy, made, strict=True)
    ]


def as_data_uri(image: Gray) -> str:
    """The picture in 8 bits as a lossless data: URI."""
    pixels = np.rint(np.clip(image, 0, 1) * 255).astype(np.uint8)
    _, content = cv2.imencode(".png", pixels, [cv2.IMWRITE_PNG_COMPRESSION, 9])
    return "data:image/png;base64," + base64.b64encode(content.tobytes()).decode("ascii")


def _made(
    settings: EvaluationSettings,
    methods: Sequence[Method],
    pool: TaskPool,
    sources: Sequence[tuple[Item | None, str]],
) -> list[dict[str, Gray]]:
    """What the methods make of each source; a method that fails on one is left out there."""
    waiting = deque(
        _Task(number, method, item, file, settings.device)
        for number, (item, file) in enumerate(sources)
        for method in methods
    )
    found: dict[tuple[int, str], Gray] = {}
    for task, image in pool.run(_show, waiting, lambda _: settings.image_timeout_s):
        if image is not None and not isinstance(image, TaskLost):
            found[task.number, task.method.label] = image
    return [
        {m.label: found[number, m.label] for m in methods if (number, m.label) in found}
        for number in range(len(sources))
    ]


def _show(task: _Task) -> Gray | None:
    method = task.method
    if task.item is None and method.looks and method.weights is None:
        return None
    image = read_gray(Path(task.file)) if task.item is None else input_of(task.item, method.looks)
    try:
        place = None if task.item is None else task.item.place
        if method.folder is not None:
            return None if task.item is None else read_given(method.folder, task.item)
        result = denoised(method, image, task.device, place)
    except Exception:  # it has lost its row, or this picture
        return None
    return result if method.levels is None else method.levels(result)
