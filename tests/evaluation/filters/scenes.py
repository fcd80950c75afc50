"""Scenes with noise for the baselines, and a baseline run on one."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from simnfnd.evaluation.filters import REGISTRY, Baseline

Array = npt.NDArray[Any]


def scene(size: int = 96) -> Array:
    """Ground of two brightnesses with a bright block and a shadow, 0..1."""
    image = np.full((size, size), 0.4, np.float32)
    image[:, size // 2 :] = 0.65
    image[size // 4 : size // 2, size // 8 : size // 3] = 0.9
    image[size // 2 : -4, size // 8 : size // 3] = 0
    return image


def noisy_scene(kind: str, size: int = 96, seed: int = 0) -> Array:
    rng = np.random.default_rng(seed)
    clean = scene(size)
    if kind == "white":
        noisy = clean + rng.normal(0, 0.1, clean.shape)
    else:
        noisy = clean * rng.gamma(12, 1 / 12, clean.shape)
    return np.asarray(np.clip(noisy, 0, 1), dtype=np.float32)


def _broken(image: Array) -> Array:
    if image.mean() > 0:
        raise ZeroDivisionError("no such\nluck")
    return image


BROKEN = Baseline("broken", _broken, {}, {}, "here")
"""A method that crashes."""


def run(name: str, image: Array, **parameters: float) -> Array:
    baseline = REGISTRY[name]
    return baseline(image, {**baseline.default, **parameters})
