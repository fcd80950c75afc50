"""What the benchmarks share: the default configuration, a clock for CPU time, a pair on disk."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
from hydra import compose, initialize_config_module
from omegaconf import OmegaConf

from factory.config import FactoryConfig, from_mapping
from factory.sample import Pair


def composed_config(*overrides: str) -> FactoryConfig:
    """What `python -m factory OVERRIDES` would compose."""
    with initialize_config_module("conf", version_base="1.3"):
        values = OmegaConf.to_container(compose("factory", list(overrides)), resolve=True)
    assert isinstance(values, dict)
    return from_mapping({str(key): value for key, value in values.items() if key != "experiment"})


def cpu_seconds(action: Callable[[], Any], repeats: int) -> float:
    """Median CPU time of `action`, all threads, after one run that is not counted."""
    action()
    spent = []
    for _ in range(repeats):
        start = time.process_time()
        action()
        spent.append(time.process_time() - start)
    return statistics.median(spent)


def write_pair(pair: Pair, folder: Path) -> None:
    """Both pictures and the mask as a gzip-1 chunk each, as a shard has them."""
    with h5py.File(folder / "pair.h5", "w") as file:
        for name in ("noisy", "clean", "shadow"):
            picture = getattr(pair, name)
            file.create_dataset(
                name,
                data=picture[None],
                chunks=(1, *picture.shape),
                compression="gzip",
                compression_opts=1,
                fletcher32=True,
            )
