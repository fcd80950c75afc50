"""Which arithmetic a training uses: as asked, or the fastest that the device is made for."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from ...factory.errors import FactoryError
from ..settings import ModelsSettings


def with_precision(settings: ModelsSettings, accelerator: str) -> ModelsSettings:
    """The settings with `train.precision` decided; says what `auto` became.

    accelerator: "cpu" or "gpu".  Raises FactoryError for 16-mixed on a CPU.
    """
    chosen: str = settings.train.precision
    if chosen == "auto":
        chosen = "bf16-mixed" if has_bf16(accelerator) else "32-true"
        print(f"train.precision=auto: {chosen}", file=sys.stderr, flush=True)
    if accelerator == "cpu" and chosen == "16-mixed":
        raise FactoryError("train.precision=16-mixed needs a GPU; on a CPU use 32-true")
    changes: dict[str, Any] = {"precision": chosen}
    return replace(settings, train=replace(settings.train, **changes))


def has_bf16(accelerator: str) -> bool:
    """Whether the device has instructions for bfloat16; False where that is not known.

    Emulated it is slower than float32.
    """
    if accelerator != "cpu":
        return bool(torch.cuda.is_bf16_supported(including_emulation=False))
    try:
        words = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").split()
    except OSError:
        return False
    return "avx512_bf16" in words or "amx_bf16" in words
