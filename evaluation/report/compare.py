"""`simnfnd evaluate compare A B`: is one run really better than another?

A and B are folders of reports on the same pairs, or twice the same folder.  The rows are paired
image by image: mean difference with its interval, Wilcoxon test, wins.  Folders of `simnfnd
evaluate real`, any number of them, are tabulated beside each other.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from ...factory.common.command_line import Parser
from ...factory.common.errors import FactoryError
from ..metrics.measure import METRICS
from ..metrics.statistics import LEAST_FRAMES
from .build import RESULTS_NAME
from .content import Estimator, add_holm_p
from .tables import as_markdown, as_table, interval, percent, written, written_p

REAL_NAME = "real.json"
_ALPHA = 0.05


def main(words: Sequence[str]) -> int:
    """Print the comparison."""
    parser = Parser(prog="simnfnd evaluate compare")
    parser.add_argument(
        "folders",
        nargs="+",
        metavar="FOLDER",
        help="two reports, which may be the same; or any number of reports on real images",
    )
    parser.add_argument("--row-a", help="row of A (default: the one of highest PSNR, noisy aside)")
    parser.add_argument("--row-b", help="row of B (default: chosen as that of A)")
    options = parser.parse_args(list(words))
    folders = [Path(name) for name in options.folders]
    if all((folder / REAL_NAME).is_file() for folder in folders):
        print(tabulate(folders))
        return 0
    if len(folders) != 2:
        raise FactoryError(
            f"evaluate compare: {len(folders)} folders; give two reports of `simnfnd evaluate`, or "
            "reports of `simnfnd evaluate real` alone"
        )
    print(text_of(compare(folders[0], folders[1], options.row_a, options.row_b)))
    return 0


def compare(a: Path, b: Path, row_a: str | None, row_b: str | None) -> dict[str, Any]:
    """The comparison of two rows as plain data.

    Raises FactoryError when a folder is no report, has no such row, or the pairs are not the same.
    """
    name_a, row_values_a = _row(a, row_a)
    name_b, row_values_b = _row(b, row_b)
    common = row_values_a.index.intersection(row_values_b.index, sort=True)
    if common.empty:
        raise FactoryError(
            f"{a} and {b}: reports on different pairs, none in common; give two on one dataset"
        )
    groups = ["/".join(key[1:]) for key in common]
    figures = {
        name: pd.DataFrame(
            {"a": row_values_a.loc[common, name], "b": row_values_b.loc[common, name]}
        )
        for name in METRICS
        if name in row_values_a and name in row_values_b
    }
    estimator = Estimator(figures, groups, resamples=2000, seed=0)
    differences = {name: estimator.difference(name, "a", "b") for name in figures}
    add_holm_p([item for name, item in differences.items() if METRICS[name].better])
    for name, item in differences.items():
        item["verdict"] = _verdict(item, METRICS[name].better)
    return {
        "a": {"folder": a.name, "row": name_a},
        "b": {"folder": b.name, "row": name_b},
        "pairs": len(common),
        "frames": len(set(groups)),
        "left_out": len(row_values_a.index.symmetric_difference(row_values_b.index)),
        "metrics": differences,
    }


def _verdict(item: Mapping[str, Any], better: int) -> str:
    """Whether A is better: only where the interval excludes zero and Holm's p is below 0.05."""
    if not item["count"]:
        return "no figures"
    if not better:
        return "not ranked"
    if (item["p_holm"] or 1.0) < _ALPHA and item["low"] * item["high"] > 0:
        return "better" if item["mean"] * better > 0 else "worse"
    return "no difference shown"


def text_of(result: Mapping[str, Any]) -> str:
    """The comparison in Markdown."""
    a, b = (f"{result[side]['row']} ({result[side]['folder']})" for side in "ab")
    left_out = f", {result['left_out']} in one report only" if result["left_out"] else ""
    rows = []
    for name, item in result["metrics"].items():
        metric = METRICS[name]
        digits = metric.digits + 1
        cells = written(item["mean"], digits, True), interval(item, digits, True)
        wins = percent(item["wins"]) if metric.better else "-"
        rows.append([metric.label, *cells, written_p(item.get("p_holm")), wins, item["verdict"]])
    head = ["metric", "A minus B", "95 % interval", "p (Holm)", "A is better in", "A"]
    about = f"A = {a}, B = {b}: {result['pairs']} pairs of {result['frames']} frames{left_out}"
    if result["frames"] < LEAST_FRAMES:
        about += f". There are no p values: a difference takes {LEAST_FRAMES} frames to show."
    return "\n\n".join([about, as_markdown(as_table(head, rows), "lrcrrl")])


def read_results(folder: Path) -> pd.DataFrame:
    """The table of a report's results.csv.  FactoryError when there is none."""
    path = folder / RESULTS_NAME
    if not path.is_file():
        raise FactoryError(
            f"{folder}: no report here (no {RESULTS_NAME}); make one with "
            "`simnfnd evaluate dataset=DIR`"
        )
    words = dict.fromkeys(("method", "shard", "pair", "location", "scene", "frame"), str)
    try:
        table = pd.read_csv(path, float_precision="round_trip", dtype=words, low_memory=False)
        table[[*words, "psnr"]].astype({"psnr": float})
    except (OSError, ValueError, KeyError) as error:
        reason = " ".join(str(error).split())[:80]
        raise FactoryError(
            f"{path}: damaged or of another version ({reason}); make it again"
        ) from error
    return table.fillna(dict.fromkeys(words, ""))


def _row(folder: Path, name: str | None) -> tuple[str, pd.DataFrame]:
    """A row, the best by PSNR without a name: its pairs by their content and, last, their frame."""
    results = read_results(folder)
    if name is None:
        means = results.groupby("method", sort=False)["psnr"].mean()
        others = means.drop("noisy", errors="ignore")
        name = str((means if others.empty else others).idxmax())
    rows = results[results["method"] == name]
    if rows.empty:
        known = ", ".join(results["method"].unique())
        raise FactoryError(f"{folder}: no row {name!r}; it has {known}")
    return name, rows.set_index(["pair", "location", "scene", "frame"])


def tabulate(folders: Sequence[Path]) -> str:
    """PSNR and SSIM of noisy images, the best filter and each network, a column a report.

    A network counts by the last part of its label, so folders of one name are one row.
    Raises FactoryError for a folder without a report that can be read.
    """
    names = []
    columns = []
    for folder in folders:
        path = folder / REAL_NAME
        try:
            report = json.loads(path.read_text(encoding="utf-8"))
            columns.append(_column(report))
            names.append(report["name"])
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise FactoryError(
                f"{path}: damaged or of another version; make it again by `simnfnd evaluate real`"
            ) from error
    labels = dict.fromkeys(label for column in columns for label in column)
    lines = [[label, *(column.get(label, "-") for column in columns)] for label in labels]
    table = as_markdown(as_table(["PSNR, dB / SSIM", *names], lines), "lr")
    return f"{table}\n\nThe best filter is the one of the highest PSNR in each report."


def _column(report: Mapping[str, Any]) -> dict[str, str]:
    """Label -> its figures in a report."""
    rows = {row["label"]: row for row in report["rows"] if row["lost"] is None}
    figures = {
        label: " / ".join(
            written(row["metrics"].get(name, {}).get("mean"), METRICS[name].digits)
            for name in ("psnr", "ssim")
        )
        for label, row in rows.items()
    }
    best = report["best_filter"].get("psnr")
    networks = [label for label, row in rows.items() if row["kind"] == "network"]
    return {
        "noisy": figures["noisy"],
        "best filter": "-" if best is None else f"{figures[best]} ({best.split()[0]})",
        **{Path(label).name: figures[label] for label in networks},
    }
