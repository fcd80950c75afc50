"""Which arithmetic a training uses: as asked, or the fastest that the device is made for."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from ...factory.errors import FactoryError
from ..networks import build_network
from ..settings import ModelsSettings
from .results import CHECKPOINT_NAME, read_checkpoint

_CPU_FLAGS = ("avx512_bf16", "amx_bf16")
_CPU_FACTS = Path("/proc/cpuinfo")


def with_precision(settings: ModelsSettings, accelerator: str, out: Path) -> ModelsSettings:
    """`decided`, by the training in the folder `out` if that is continued."""
    path = out / CHECKPOINT_NAME
    stored = None
    if settings.train.precision == "auto" and settings.resume and path.exists():
        stored = read_checkpoint(path)["recipe"].get("train.precision")
    return decided(settings, accelerator, stored)


def decided(
    settings: ModelsSettings, accelerator: str, stored: str | None = None
) -> ModelsSettings:
    """The settings with `train.precision` decided, and one line where something is to be told.

    accelerator: "cpu" or "gpu".  stored: the precision of a training that is continued, kept for
    `auto` whatever the device has, so that no training changes its arithmetic half way.
    Raises FactoryError for 16-mixed on a CPU.
    """
    asked = settings.train.precision
    chosen: str = asked
    if asked == "auto":
        chosen, why = (stored, "as before") if stored else _fastest(settings, accelerator)
        _tell(f"train.precision=auto: {chosen} ({why})")
    if accelerator == "cpu" and chosen == "16-mixed":
        raise FactoryError("train.precision=16-mixed needs a GPU; on a CPU use 32-true")
    if accelerator == "cpu" and chosen == "bf16-mixed" and not cpu_has_bf16():
        _tell(
            "train.precision=bf16-mixed: this CPU has no instructions for it (avx512_bf16, "
            "amx_bf16): 32-true is faster here, twice with AVX-512 and ten times and more without"
        )
    changes: dict[str, Any] = {"precision": chosen}
    return replace(settings, train=replace(settings.train, **changes))


def cpu_has_bf16() -> bool:
    """Whether the CPU multiplies bfloat16 by instructions of its own; False where unknown."""
    try:
        text = _CPU_FACTS.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return False
    flags = next((line for line in text.splitlines() if line.startswith("flags")), "")
    return not set(_CPU_FLAGS).isdisjoint(flags.split())


def gpu_has_bf16() -> bool:
    """Whether the GPU has bfloat16 in hardware; emulated it is slower than float32."""
    return bool(torch.cuda.is_bf16_supported(including_emulation=False))


def _fastest(settings: ModelsSettings, accelerator: str) -> tuple[str, str]:
    """The precision, and why."""
    if accelerator == "cpu":
        if cpu_has_bf16():
            return "bf16-mixed", "the CPU has instructions for it"
        return "32-true", "the CPU has no bf16 instructions"
    if gpu_has_bf16():
        return "bf16-mixed", "the GPU has it in hardware"
    if build_network(settings.model).adversarial:
        return "32-true", "the GPU has no bf16, and adversarial training goes without float16"
    return "16-mixed", "the GPU has no bf16"


def _tell(text: str) -> None:
    print(text, file=sys.stderr, flush=True)
