"""Settings of training data, and the words of a small training on it."""

from __future__ import annotations

from typing import Any

from hydra import compose, initialize_config_module
from omegaconf import OmegaConf

from simnfnd.factory.settings import build
from simnfnd.models.settings import DATA, ModelsSettings

SMALL = (
    *("model.width=4", "model.encoder=[1]", "model.decoder=[1]", "data.patch=32", "data.batch=4"),
    *("train.steps=6", "train.check_every=2", "train.warmup=2", "train.ema=0.5"),
    "data.workers=0",
)


def data_settings(kind: str = "pairs", **changes: Any) -> Any:
    with initialize_config_module("simnfnd.conf", version_base="1.3"):
        values: Any = OmegaConf.to_container(compose("models", [f"data={kind}"]).data)
    return build(DATA[kind], {**values, **changes})


def composed(*words: str) -> tuple[ModelsSettings, dict[str, Any]]:
    with initialize_config_module("simnfnd.conf", version_base="1.3"):
        values: Any = OmegaConf.to_container(compose("models", list(words)), resolve=True)
    return build(ModelsSettings, values), values
