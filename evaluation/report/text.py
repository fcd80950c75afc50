"""Metrics and figures as readers see them: names, digits, intervals, tables of text."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ...factory.dataset.describe import markdown
from ..methods.method import shown

if TYPE_CHECKING:
    import pandas as pd


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


def plain(value: float | None) -> float | None:
    """JSON has no NaN and no infinity."""
    return float(value) if value is not None and math.isfinite(value) else None


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


def interval(item: Mapping[str, Any], digits: int, sign: bool = False) -> str:
    """Low .. high."""
    return f"{written(item['low'], digits, sign)} .. {written(item['high'], digits, sign)}"


def percent(share: float | None) -> str:
    """A share in per cent."""
    return "-" if share is None else f"{100 * share:.0f}\u00a0%"


def chosen(row: Mapping[str, Any]) -> str:
    """Parameters of a row, and its levels where it has them."""
    parts = [shown(row["parameters"]).strip(" ()")]
    if row.get("levels"):
        parts.append("gain {gain:.2f}, offset {offset:+.3f}".format(**row["levels"]))
    return "; ".join(part for part in parts if part)


def as_markdown(table: pd.DataFrame, align: str = "lr") -> str:
    """A table of text in Markdown, without its index."""
    return markdown.table(list(table.columns), table.to_numpy().tolist(), align)


def as_table(head: Sequence[str], rows: Sequence[Sequence[Any]]) -> pd.DataFrame:
    """Rows of text under a head, in which a name may come twice."""
    import pandas as pd

    return pd.DataFrame(list(rows), columns=list(head))
