"""Small settings, calls and images of the evaluation, for its tests."""

from __future__ import annotations

import os
import signal
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from scipy import ndimage

from simnfnd.evaluation.filters import Baseline
from simnfnd.evaluation.judging.methods import NOISY, Method
from simnfnd.evaluation.judging.pairs import items_of
from simnfnd.evaluation.judging.runner import JudgingTask, Measured, measure_task
from simnfnd.evaluation.judging.settings import EvaluationSettings
from simnfnd.evaluation.report.build import measure
from simnfnd.factory.common.array_types import Float32s, Float64s
from simnfnd.factory.common.settings import build
from simnfnd.factory.common.workers.tasks import TaskPool

_DEFAULTS: dict[str, Any] = {
    "split": "test",
    "workers": 1,
    "limit": None,
    "bootstrap": 200,
    "seed": 0,
    "image_timeout_s": 60,
    "baselines": ["median"],
    "models": [],
    "pictures": [],
    "ablation": {"olddata_l1": None, "simnfnd_l1": None, "simnfnd_newloss": None},
    "device": "cpu",
    "examples": 2,
    "debug": False,
}


def settings_for(dataset: Path, **changes: Any) -> EvaluationSettings:
    """Settings that write beside the dataset; `tuning` is merged, the rest replaced."""
    tuning = {
        "auto": False,
        "file": str(dataset.parent / f"{dataset.name}-tuned.json"),
        "validation": 0.3,
        "pairs": 3,
        **changes.pop("tuning", {}),
    }
    out = {"out": str(dataset.parent / f"{dataset.name}-report")}
    values = {"dataset": {"dir": str(dataset)}, **_DEFAULTS, **out, "tuning": tuning, **changes}
    settings: EvaluationSettings = build(EvaluationSettings, values)
    return settings


def measured(dataset: Path, methods: list[Method], **changes: Any) -> Measured:
    """What the engine measures of the noisy images and these methods."""
    settings = settings_for(dataset, **changes)
    with TaskPool(settings.workers) as pool:
        items = items_of(dataset, settings.split, settings.limit)
        return measure(settings, items, [NOISY, *methods], pool)


def _broken(image: Any) -> Any:
    if image.mean() > 0:
        raise ZeroDivisionError("no such\nluck")
    return image


BROKEN = Baseline("broken", _broken, {}, {}, "here")
"""A filter that crashes."""


def killed_by_median(task: JudgingTask) -> Any:
    """A worker that dies of one method."""
    if any(method.name == "median" for method in task.methods):
        os.kill(os.getpid(), signal.SIGKILL)
    return measure_task(task)


def speckle(
    rng: np.random.Generator,
    shape: tuple[int, int] = (192, 96),
    grain: tuple[float, float] = (0.0, 0.0),
) -> Float64s:
    """Rayleigh amplitude of mean power 1; grain: Gaussian standard deviations in cells."""
    field = rng.standard_normal((2, *shape))
    if any(grain):
        field = np.stack([ndimage.gaussian_filter(part, grain, mode="wrap") for part in field])
    power = (field**2).sum(axis=0)
    return np.asarray(np.sqrt(power / power.mean()))


def sonar_image(rng: np.random.Generator, level: float = 0.3, looks: int = 3) -> Float32s:
    """(192, 96) polar image in 0..1: log-compressed speckle on a sloping bottom, one object."""
    power = np.mean([speckle(rng, grain=(0.6, 0.6)) ** 2 for _ in range(looks)], axis=0)
    rows, columns = np.mgrid[0:192, 0:96]
    bottom_db = -6 * rows / 192 + 4 * np.sin(columns / 30 + rng.uniform(0, 6))
    bottom_db[60:70, 20:34] += 20
    bottom_db[70:100, 20:34] -= 15
    grey = level + (10 * np.log10(power) + bottom_db) / 80
    return np.asarray(np.clip(grey, 0, 1), np.float32)


def polar_folder(root: Path, seed: int, count: int = 16, **changes: float) -> Path:
    """A folder of polar images with geometry.csv."""
    root.mkdir(parents=True)
    rng = np.random.default_rng(seed)
    for number in range(count):
        image = np.rint(255 * sonar_image(rng, **changes)).astype(np.uint8)  # type: ignore[arg-type]
        Image.fromarray(image).save(root / f"{number:03d}.png")
    (root / "geometry.csv").write_text(
        "file,layout,hfov_deg,range_min_m,range_max_m\n*,polar,30,1,5\n"
    )
    return root
