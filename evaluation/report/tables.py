"""Figures as readers see them, and the tables of a report."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from ..judging.methods import shown
from ..metrics.measure import METRICS, Metric
from ..metrics.statistics import FigureEstimate

if TYPE_CHECKING:
    import pandas as pd

Content = Mapping[str, Any]

_SHORT = ("ssim", "gmsd", "psnr_fan", "shadow_iou")

_RULES = {"l": "---", "r": "---:", "c": ":---:"}

TABLE_METRICS = ("psnr", "ssim", "gmsd")
"""Metrics of the paper's tables."""


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


def figure(estimate: FigureEstimate, sign: bool = False) -> str:
    """Three digits of a share and, in brackets, two of its interval."""
    value = written(estimate.value, 3, sign)
    limits = interval(estimate._asdict(), 2, sign)
    return value if limits == "-" else f"{value} ({limits})"


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


def table_of(
    rows: Sequence[Content], columns: Mapping[str, Callable[[Content], str]], first: str = "method"
) -> pd.DataFrame:
    """A line for each row of a report: its name, then its cells, or why it is lost.

    rows: with `label`, `parameters` and `lost`.  columns: head -> what the cell of a row says.
    """
    lines = []
    for row in rows:
        points = dict.fromkeys(shown(point).strip(" ()") for point in row["parameters"] if point)
        title = row["label"] + (f" ({' | '.join(points)})" if points else "")
        if row["lost"] is None:
            cells = [cell(row) for cell in columns.values()]
        else:
            cells = [f"lost: {row['lost']}", *[""] * (len(columns) - 1)]
        lines.append([title, *cells])
    return as_table([first, *columns], lines)


def mean_column(name: str, metric: Metric, *, bounds: bool = False) -> Callable[[Content], str]:
    """The cell of a row: its mean of a metric, with the interval if `bounds`."""

    def cell(row: Content) -> str:
        if name not in row["metrics"]:
            return "-"
        item = row["metrics"][name]
        return (
            with_interval(item, metric.digits) if bounds else written(item["mean"], metric.digits)
        )

    return cell


def difference_column(
    key: str, name: str, text: Callable[[Mapping[str, Any]], str]
) -> Callable[[Content], str]:
    """The cell of a row: what `text` says of its difference in a metric; empty without one."""
    return lambda row: text(row[key][name]) if name in row[key] else ""


def leaderboard(rows: Sequence[Content]) -> pd.DataFrame:
    """PSNR with its interval, the paired gain and its test, other metrics, the cost."""
    names = [name for name in _SHORT if has(rows, name) and not _is_blind(rows, name)]
    columns: dict[str, Callable[[Content], str]] = {
        METRICS["psnr"].label: mean_column("psnr", METRICS["psnr"]),
        "95 % interval": lambda row: interval(row["metrics"]["psnr"], 2),
        "against noisy, dB": difference_column(
            "against_noisy", "psnr", lambda gain: with_interval(gain, 2, True)
        ),
        "p (Holm)": difference_column(
            "against_noisy", "psnr", lambda gain: written_p(gain["p_holm"])
        ),
        "wins": difference_column("against_noisy", "psnr", lambda gain: percent(gain["wins"])),
        **{METRICS[name].label: mean_column(name, METRICS[name]) for name in names},
        "ms": lambda row: written(1000 * (row["cpu_s"] or math.nan), 1),
    }
    return table_of(rows, columns)


def more_metrics(rows: Sequence[Content]) -> pd.DataFrame:
    """The means of the metrics that the leaderboard leaves out, those of other packages last."""
    kept_rows = [{**row, "parameters": []} for row in rows if row["lost"] is None]
    own_names = sorted({name for row in kept_rows for name in row["metrics"]} - set(METRICS))
    metrics = {**METRICS, **{name: Metric(name) for name in own_names}}
    columns = {
        metric.label: mean_column(name, metric)
        for name, metric in metrics.items()
        if name not in ("psnr", *_SHORT) and has(rows, name)
    }
    return table_of(kept_rows, columns)


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
    smallest = 0.5 * 10 ** -METRICS[name].digits
    return all(mean is None or not mean >= smallest for mean in means)


def _three(figures: Content) -> str:
    psnr, ssim, gmsd = (figures[name] for name in TABLE_METRICS)
    return f"{psnr:.2f} / {ssim:.3f} / {gmsd:.3f}"
