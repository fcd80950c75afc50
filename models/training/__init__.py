"""Trains a denoiser: `simnfnd train dataset=DIR [KEY=VALUE ...]`."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from typing import Any

from hydra.core.config_store import ConfigStore
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf

from ...factory.common import extensions
from ...factory.common.settings import build
from ...factory.simulation.config.application import run_app
from .. import WEIGHTS_NAME
from ..networks import default_values


def main(words: Sequence[str]) -> int:
    """Train as the configuration says; returns the exit code."""
    from ..settings import ModelsSettings

    for kind in extensions.names("network"):
        # Makes `model=KIND` a choice of Hydra.
        ConfigStore.instance().store(name=kind, group="model", node=default_values(kind))
    return run_app(run, "models", words, ModelsSettings)


def run(config: DictConfig) -> None:
    """Train as the configuration says."""
    from ..settings import ModelsSettings

    command = shlex.join(["simnfnd", "train", *HydraConfig.get().overrides.task])
    # Hydra composes one configuration at a time, and data may compose that of a dataset.
    GlobalHydra.instance().clear()
    values: Any = OmegaConf.to_container(config, resolve=True, throw_on_missing=True)
    settings: ModelsSettings = build(ModelsSettings, values)
    # torch takes seconds to import: only when there is something to train.
    from .train import output_folder, train

    best = train(settings, values, command)
    print(
        f"validation: {best['psnr_noisy']:.2f} -> {best['psnr']:.2f} dB "
        f"({best['gain_db']:+.2f}), SSIM {best['ssim_noisy']:.3f} -> {best['ssim']:.3f}, "
        f"step {best['step']}"
    )
    print(f"weights: {output_folder(settings) / WEIGHTS_NAME}")
