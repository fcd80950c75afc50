"""Figures that need no truth."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from tqdm import tqdm

from simnfnd.evaluation.baselines import REGISTRY
from simnfnd.evaluation.baselines.base import Gray
from simnfnd.evaluation.methods.apply import denoised
from simnfnd.evaluation.methods.method import Method, reason
from simnfnd.evaluation.metrics.edges import edge_preservation
from simnfnd.evaluation.metrics.speckle import contrast_to_noise, enl, m_index, ratio_mean
from simnfnd.evaluation.real.pictures import SIDE, File, Scene, geometry_of, scene
from simnfnd.factory.errors import FactoryError
from simnfnd.factory.workers.tasks import TaskLost, TaskPool

Figures = dict[str, float]


@dataclass(frozen=True)
class Task:
    """A method on a picture.  number: of the picture."""

    method: Method
    number: int
    file: File
    device: str


@dataclass
class RealRow:
    """A method on all pictures: figures and images in their order; lost: why there are none."""

    method: Method
    figures: list[Figures] = field(default_factory=list)
    images: list[Gray] = field(default_factory=list)
    lost: str | None = None


def figures_of(image: Gray, shared: Scene) -> Figures:
    """Every figure of a denoised picture, (H, W) in 0..1; NaN where one does not exist."""
    dark, bright = (float(np.mean(image[part])) for part in (shared.dark, shared.bright))
    found = {
        "enl": enl(image, shared.zones, side=SIDE),
        "cnr": contrast_to_noise(image, shared.bright, shared.dark),
        "shadow_level": dark / bright if bright > 0 else float("nan"),
        "edges_kept": edge_preservation(shared.noisy, image, data_range=1.0, mask=shared.sector),
        "ratio_mean": ratio_mean(shared.noisy, image, data_range=1.0),
        "m_index": m_index(shared.noisy, image, shared.zones, data_range=1.0, side=SIDE),
    }
    if shared.objects is not None and shared.around is not None:
        found["object_cnr"] = contrast_to_noise(image, shared.objects, shared.around)
    return found


def measure(
    files: Sequence[File], methods: Sequence[Method], pool: TaskPool, device: str, timeout_s: float
) -> list[RealRow]:
    """All methods on all pictures.  A method that fails on one loses its row.

    FactoryError when a picture cannot be read.
    """
    rows = {method.label: RealRow(method) for method in methods}
    waiting = deque(
        Task(method, number, file, device)
        for number, file in enumerate(files)
        for method in methods
    )
    results: dict[tuple[str, int], tuple[Gray, Figures]] = {}
    with tqdm(total=len(waiting), unit="picture", desc="real pictures") as bar:
        for task, found in pool.run(_measured, waiting, lambda _: timeout_s):
            bar.update()
            if isinstance(found, TaskLost | str):
                why = found.reason if isinstance(found, TaskLost) else found
                row = rows[task.method.label]
                row.lost = row.lost or f"{task.file.name}: {why}"
                bar.set_postfix(lost=sum(row.lost is not None for row in rows.values()))
            else:
                results[task.method.label, task.number] = found
    for label, row in rows.items():
        if row.lost is None:
            row.images = [results[label, number][0] for number in range(len(files))]
            row.figures = [results[label, number][1] for number in range(len(files))]
    return list(rows.values())


def _measured(task: Task) -> tuple[Gray, Figures] | str:
    shared = scene(task.file)
    method = task.method
    if method.weights is None and REGISTRY[method.name].looks:
        return "needs several looks at a scene that stands still"
    try:
        image = denoised(method, shared.noisy, task.device, None, geometry_of(task.file))
    except Exception as error:  # a method's own defect must not take the others along
        return reason(error)
    if method.levels is not None:
        image = method.levels(image)
    return image, figures_of(image, shared)


def mean_of(row: RealRow, name: str) -> float | None:
    """The mean of a figure over the pictures that have it, None without any."""
    values = np.array([figures.get(name, np.nan) for figures in row.figures], dtype=float)
    values = values[np.isfinite(values)]
    return float(values.mean()) if values.size else None


def check_masks(files: Sequence[File]) -> None:
    """FactoryError when a picture has no mask."""
    for file in files:
        if file.mask is None:
            raise FactoryError(f"downstream: {file.path} has no mask of its name in Masks/")
