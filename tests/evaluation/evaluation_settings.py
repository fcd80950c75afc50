"""Small settings and calls of the evaluation, for its tests."""

from __future__ import annotations

import os
import signal
from contextlib import closing
from pathlib import Path
from typing import Any

from simnfnd.evaluation.filters import Baseline
from simnfnd.evaluation.methods import NOISY, Method
from simnfnd.evaluation.pairs import items_of
from simnfnd.evaluation.report.build import measure
from simnfnd.evaluation.runner import FigureStore, Measured, Task, measure_task
from simnfnd.evaluation.settings import EvaluationSettings
from simnfnd.factory.scheduler.workers.tasks import TaskPool
from simnfnd.factory.settings import build

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


def measured(dataset: Path, methods: list[Method], out: Path, **changes: Any) -> Measured:
    """What the engine measures of the noisy images and these methods; figures are kept in `out`."""
    settings = settings_for(dataset, **changes)
    with closing(FigureStore(out)) as store, TaskPool(settings.workers) as pool:
        items = items_of(dataset, settings.split, settings.limit)
        return measure(settings, items, [NOISY, *methods], pool, store)


def _broken(image: Any) -> Any:
    if image.mean() > 0:
        raise ZeroDivisionError("no such\nluck")
    return image


BROKEN = Baseline("broken", _broken, {}, {}, "here")
"""A filter that crashes."""


def killed_by_median(task: Task) -> Any:
    """A worker that dies of one method."""
    if any(method.name == "median" for method in task.methods):
        os.kill(os.getpid(), signal.SIGKILL)
    return measure_task(task)
