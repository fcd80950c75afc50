"""Small settings and calls of the evaluation, for its tests."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from simnfnd.evaluation.settings import EvaluationSettings
from simnfnd.factory.settings import build

_DEFAULTS: dict[str, Any] = {
    "split": "test",
    "workers": 1,
    "limit": None,
    "shadow_threshold": 0.02,
    "bootstrap": 200,
    "seed": 0,
    "image_timeout_s": 60,
    "baselines": ["median"],
    "models": [],
    "pictures": [],
    "ablation": {"olddata_l1": None, "simnfnd_l1": None, "simnfnd_newloss": None},
    "device": "cpu",
    "texture": False,
    "page": {"examples": 2, "methods": 4},
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
