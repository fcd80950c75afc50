"""The device of a training, and its arithmetic: as asked, or the fastest it is made for."""

from __future__ import annotations

import sys
from pathlib import Path

import torch

from ...factory.errors import FactoryError


def device_of(asked: str, key: str = "device=") -> torch.device:
    """The device that `auto`, `cpu` or `gpu` means here.  Raises FactoryError without a GPU."""
    has_gpu = torch.cuda.is_available()
    if asked == "gpu" and not has_gpu:
        raise FactoryError(f"{key}gpu: no usable GPU here; use {key}cpu")
    return torch.device("cuda" if has_gpu and asked != "cpu" else "cpu")


def precision_of(asked: str, device: torch.device) -> str:
    """`32-true` or `bf16-mixed`; says what `auto` became."""
    if asked != "auto":
        return asked
    chosen = "bf16-mixed" if has_bf16(device) else "32-true"
    print(f"train.precision=auto: {chosen}", file=sys.stderr, flush=True)
    return chosen


def has_bf16(device: torch.device) -> bool:
    """Whether the device has instructions for bfloat16; False where that is not known.

    Emulated it is slower than float32.
    """
    if device.type != "cpu":
        return bool(torch.cuda.is_bf16_supported(including_emulation=False))
    try:
        words = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").split()
    except OSError:
        return False
    return "avx512_bf16" in words or "amx_bf16" in words
