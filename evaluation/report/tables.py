"""Metrics and figures as readers see them, and the tables of a report."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ..judging.methods import shown

if TYPE_CHECKING:
    import pandas as pd

Content = Mapping[str, Any]

_SHORT = ("ssim", "gmsd", "psnr_fan", "shadow_iou")

_RULES = {"l": "---", "r": "---:", "c": ":---:"}

TABLE_METRICS = ("psnr", "ssim", "gmsd")
"""Metrics of the paper's tables."""


@dataclass(frozen=True)
class Metric:
    """How tables show a metric.

    label: name with the unit.  digits: digits after the point.
    better: 1 where high values are better, -1 where low ones are, 0 where neither is.
    """

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
    "ratio_variance": Metric("ratio variance", 3, 0),
    "ratio_correlation": Metric("ratio correlation", 3, 0),
}
"""Metrics in the order of the tables.

ENL rewards blur, and doing nothing leaves a perfect ratio image: neither ranks methods alone."""


def plain(value: float | None) -> float | None:
    """JSON has no NaN and no infinity."""
    return float(value) if value is not None and math.isfinite(value) else None


def written(value: float | None, digits: int, sign: bool = False) -> str:
    """A figure with this many digits; `-` for none."""
    if value is None or not math.isfinite(value):
        return "-"
    return f"{value:{'+' if sign else ''}.{digits}f}"


def written_p(p: float | None) -> str:
    """A p value: two digits, or a bound."""
    if p is None or not math.isfinite(p):
        return "-"
    return "< 0.001" if p < 0.001 else f"{p:.3f}"


def interval(item: Mapping[str, Any], digits: int, sign: bool = False) -> str:
    """Low .. high; `-` where there is none."""
    if plain(item["low"]) is None:
        return "-"
    return f"{written(item['low'], digits, sign)} .. {written(item['high'], digits, sign)}"


def with_interval(item: Mapping[str, Any], digits: int, sign: bool = False) -> str:
    """A mean, and its interval in brackets where there is one."""
    mean = written(item["mean"], digits, sign)
    if plain(item["low"]) is None:
        return mean
    return f"{mean} ({interval(item, digits, sign)})"


def percent(share: float | None) -> str:
    """A share in per cent."""
    return "-" if share is None else f"{100 * share:.0f}\u00a0%"


def as_markdown(table: pd.DataFrame, align: str = "lr") -> str:
    """A table of text in Markdown, without its index.

    align: a letter a column, l, r or c; the last one counts for all further columns.  In cells a
    vertical bar is escaped and a line end becomes a space.
    """
    rules = [_RULES[letter] for letter in align.ljust(table.shape[1], align[-1])]
    cells = [
        [str(cell).replace("\n", " ").replace("|", "\\|") for cell in row]
        for row in (table.columns, *table.to_numpy().tolist())
    ]
    head, *rows = (f"| {' | '.join(row)} |" for row in cells)
    return "\n".join([head, f"|{'|'.join(rules[: table.shape[1]])}|", *rows])


def as_table(head: Sequence[str], rows: Sequence[Sequence[Any]]) -> pd.DataFrame:
    """Rows of text under a head, in which a name may come twice."""
    import pandas as pd

    return pd.DataFrame(list(rows), columns=list(head))


def leaderboard(rows: Sequence[Content]) -> pd.DataFrame:
    """PSNR with its interval, the paired gain and its test, other metrics, the cost."""
    names = [name for name in _SHORT if has(rows, name) and not _is_blind(rows, name)]
    head = ["method", "PSNR, dB", "95 % interval", "against noisy, dB", "p (Holm)", "wins"]
    head += [METRIC_NAMES[name].label for name in names] + ["ms"]
    lines: list[list[str]] = []
    for row in rows:
        title = f"{row['label']}{shown(row['parameters'])}"
        if row["lost"] is not None:
            lines.append([title, f"lost: {row['lost']}", *[""] * (len(head) - 2)])
            continue
        psnr = row["metrics"]["psnr"]
        gain = row["against_noisy"].get("psnr")
        cells = [title, written(psnr["mean"], 2), interval(psnr, 2), "", "", ""]
        if gain is not None:
            both = with_interval(gain, 2, True)
            cells[3:] = [both, written_p(gain["p_holm"]), percent(gain["wins"])]
        cells += [written(row["metrics"][n]["mean"], METRIC_NAMES[n].digits) for n in names]
        lines.append([*cells, written(row["milliseconds"], 1)])
    return as_table(head, lines)


def more_metrics(rows: Sequence[Content]) -> pd.DataFrame:
    """The means of the metrics that the leaderboard leaves out."""
    kept_rows = [row for row in rows if row["lost"] is None]
    own_names = {name for row in kept_rows for name in row["metrics"] if name not in METRIC_NAMES}
    metrics = {name: Metric(name, 3, 0) for name in sorted(own_names)}  # of other packages
    metrics = {
        name: metric
        for name, metric in {**METRIC_NAMES, **metrics}.items()
        if name not in ("psnr", *_SHORT) and has(rows, name)
    }
    lines = [
        [
            row["label"],
            *(written(row["metrics"][n]["mean"], metric.digits) for n, metric in metrics.items()),
        ]
        for row in kept_rows
    ]
    return as_table(["method", *(metric.label for metric in metrics.values())], lines)


def beside_paper(table: Sequence[Content]) -> pd.DataFrame:
    """PSNR, SSIM and GMSD of the paper and ours."""
    lines = [
        [
            line["title"],
            _three(line["paper"]),
            "-" if line["ours"] is None else _three(line["ours"]),
            line["row"] or "not given",
        ]
        for line in table
    ]
    return as_table(["row", "paper PSNR / SSIM / GMSD", "ours", "which row here"], lines)


def has(rows: Sequence[Content], name: str) -> bool:
    """Whether any row has figures of a metric."""
    return any(row["metrics"].get(name, {}).get("count") for row in rows)


def _is_blind(rows: Sequence[Content], name: str) -> bool:
    """Whether a metric of shadow tells no rows apart, because no image is dark anywhere.

    A shadow pixel lies at or below 2 % of full scale; under a floor of noise there is none.
    """
    if name != "shadow_iou":
        return False
    means = [row["metrics"][name]["mean"] for row in rows if row["metrics"].get(name)]
    smallest = 0.5 * 10 ** -METRIC_NAMES[name].digits
    return all(mean is None or not mean >= smallest for mean in means)


def _three(figures: Content) -> str:
    psnr, ssim, gmsd = (figures[name] for name in TABLE_METRICS)
    return f"{psnr:.2f} / {ssim:.3f} / {gmsd:.3f}"
