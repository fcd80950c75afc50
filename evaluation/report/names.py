"""How metrics are written in tables: label, digits, and which direction is good."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Metric:
    """label: with the unit.  digits: after the point.  better: 1 high, -1 low, 0 neither."""

    label: str
    digits: int
    better: int


METRIC_NAMES = {
    "psnr": Metric("PSNR, dB", 2, 1),
    "ssim": Metric("SSIM", 3, 1),
    "gmsd": Metric("GMSD", 3, -1),
    "psnr_fan": Metric("PSNR fan only, dB", 2, 1),
    "ssim_fan": Metric("SSIM fan only", 3, 1),
    "gmsd_fan": Metric("GMSD fan only", 3, -1),
    "shadow_iou": Metric("shadow IoU", 3, 1),
    "shadow_residual": Metric("shadow residual", 4, -1),
    "false_light_rate": Metric("false-light rate", 3, -1),
    "gmsd_unpooled": Metric("GMSD as printed", 3, -1),
    "ms_ssim": Metric("MS-SSIM", 3, 1),
    "edge_preservation": Metric("edges", 3, 1),
    "enl": Metric("ENL", 2, 0),
    "cnr": Metric("CNR", 2, 1),
    "ratio_mean": Metric("ratio mean", 3, 0),
    "m_index": Metric("M-index", 2, 0),
}
"""In the order of the tables.  ENL rewards blur, a ratio mean of 1 is best, and doing nothing has a
low M-index: none of these three ranks methods alone."""


def written(value: float | None, digits: int, sign: bool = False) -> str:
    """A figure with so many digits; `-` for none."""
    if value is None or not math.isfinite(value):
        return "-"
    return f"{value:{'+' if sign else ''}.{digits}f}"


def written_p(p: float | None) -> str:
    """A p value: two digits, or a bound."""
    if p is None or not math.isfinite(p):
        return "-"
    return "< 0.001" if p < 0.001 else f"{p:.3f}"
