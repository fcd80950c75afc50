"""The recipe of a small training, and the network that it trains."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from simnfnd.models.settings import ModelsSettings
from simnfnd.models.training.train import train
from tests.models.data.small_renders import composed

TINY = {"kind": "nafnet", "width": 8, "encoder": [1, 1], "middle": 1, "decoder": [1, 1]}
# The recipe of every small training here, as overrides of conf/models.yaml.
SMALL = (
    *("model=nafnet", "model.width=8", "model.encoder=[1,1]", "model.decoder=[1,1]"),
    *("data.patch=32", "data.batch=4", "train.steps=45", "train.check_every=15", "train.warmup=3"),
    *("train.learning_rate=0.006", "train.ema=0.9"),
)


def config_for(dataset: Path, out: Path, *overrides: str) -> tuple[ModelsSettings, dict[str, Any]]:
    return composed(f"dataset.dir='{dataset}'", f"out='{out}'", *overrides)


def train_small(dataset: Path, out: Path, *overrides: str) -> dict[str, float | int]:
    return train(*config_for(dataset, out, *SMALL, *overrides))
