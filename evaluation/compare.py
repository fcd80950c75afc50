"""`simnfnd evaluate compare A B`: is one run really better than another?

A and B are folders of reports on the same pairs, or twice the same folder.  The rows are paired
picture by picture: mean difference with its interval, Wilcoxon test, wins, and a verdict in words.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ..factory.cli import Parser
from ..factory.errors import FactoryError
from ..factory.files import check_writable
from .metrics.statistics import Paired, holm, paired
from .report import tables as texts
from .report.build import RESULTS_NAME
from .report.document import as_json, write_files
from .report.tables import (
    METRIC_NAMES,
    as_table,
    interval,
    percent,
    plain,
    written,
    written_p,
)

_ALPHA = 0.05


def main(words: Sequence[str]) -> int:
    """Print the comparison; with --out also write it as Markdown and JSON."""
    parser = Parser(prog="simnfnd evaluate compare")
    parser.add_argument("a", metavar="A", help="folder of a report")
    parser.add_argument("b", metavar="B", help="folder of another, or the same")
    parser.add_argument("--row-a", help="row of A (default: its best but noisy, by PSNR)")
    parser.add_argument("--row-b", help="row of B (default: as A)")
    parser.add_argument("--out", help="folder for compare.md and compare.json")
    chosen = parser.parse_args(list(words))
    if chosen.out is not None:
        check_writable(Path(chosen.out), "--out")
    result = compare(Path(chosen.a), Path(chosen.b), chosen.row_a, chosen.row_b)
    text = as_markdown(result)
    print(text)
    if chosen.out is not None:
        write_files(Path(chosen.out), {"compare.md": text + "\n", "compare.json": as_json(result)})
    return 0


def compare(a: Path, b: Path, row_a: str | None, row_b: str | None) -> dict[str, Any]:
    """The comparison of two rows as plain data.

    Raises FactoryError when a folder is no report, has no such row, or the pairs are not the same.
    """
    results = read_results(a), read_results(b)
    names = [row_a or _best(results[0]), row_b or _best(results[1])]
    one, other = (
        _row(table, name, folder)
        for table, name, folder in zip(results, names, (a, b), strict=True)
    )
    common = one.index.intersection(other.index, sort=True)
    if common.empty:
        raise FactoryError(
            f"{a} and {b}: reports on different pairs, none in common; give two on one dataset"
        )
    groups = ["/".join(key[1:]) for key in common]
    metrics = [name for name in METRIC_NAMES if name in one and name in other]
    found = {}
    for name in metrics:
        first, second = (row.loc[common, name].to_numpy(float) for row in (one, other))
        better = METRIC_NAMES[name].better
        found[name] = paired(first, second, groups, better=better, resamples=2000, seed=0)
    judged = [name for name in metrics if METRIC_NAMES[name].better]
    adjusted = dict(zip(judged, holm([found[name].p for name in judged]), strict=True))
    return {
        "a": {"folder": a.name, "row": names[0]},
        "b": {"folder": b.name, "row": names[1]},
        "pairs": len(common),
        "frames": len(set(groups)),
        "left_out": len(one.index.symmetric_difference(other.index)),
        "metrics": {
            name: _entry(name, found[name], adjusted.get(name, float("nan"))) for name in metrics
        },
    }


def as_markdown(result: dict[str, Any]) -> str:
    """The comparison for people, verdict first."""
    a, b = (f"{result[side]['row']} ({result[side]['folder']})" for side in "ab")
    left_out = f", {result['left_out']} in one report only" if result["left_out"] else ""
    rows = []
    for name, one in result["metrics"].items():
        metric = METRIC_NAMES[name]
        digits = metric.digits + 1
        rows.append(
            [
                metric.label,
                written(one["difference"], digits, True),
                interval(one, digits, True),
                written_p(one["p_holm"]),
                percent(one["wins"]) if metric.better else "-",
                one["verdict"],
            ]
        )
    head = ["metric", "A minus B", "95 % interval", "p (Holm)", "A is better in", "A"]
    about = f"A = {a}, B = {b}: {result['pairs']} pairs of {result['frames']} frames{left_out}"
    table = texts.as_markdown(as_table(head, rows), "lrcrrl")
    return "\n\n".join([about, _verdict(result), table])


def _entry(name: str, result: Paired, p_holm: float) -> dict[str, Any]:
    better = METRIC_NAMES[name].better
    item = result.difference
    if not better or not item.count:
        verdict = "not ranked" if item.count else "no figures"
    elif np.isfinite(p_holm) and p_holm < _ALPHA and item.low * item.high > 0:
        verdict = "better" if item.mean * better > 0 else "worse"
    else:
        verdict = "no difference shown"
    values = {"difference": item.mean, "low": item.low, "high": item.high, "p": result.p}
    values |= {"p_holm": p_holm, "wins": result.wins}
    known = {key: plain(value) for key, value in values.items()}
    return {**known, "count": item.count, "verdict": verdict}


def _verdict(result: dict[str, Any]) -> str:
    """In words; better only where the interval excludes zero and Holm's p is below 0.05."""
    better, worse = (
        ", ".join(
            METRIC_NAMES[name].label.split(",")[0]
            for name, one in result["metrics"].items()
            if one["verdict"] == verdict
        )
        for verdict in ("better", "worse")
    )
    if better and worse:
        return f"Mixed: A is better in {better} and worse in {worse}."
    if better or worse:
        how, other = ("better", "worse") if better else ("worse", "better")
        return f"A is really {how} than B in {better or worse}, and {other} in nothing."
    few = " (with fewer than 6 frames the test cannot show any)" if result["frames"] < 6 else ""
    return f"No difference is shown: it could be chance with {result['frames']} frames{few}."


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


def _best(results: pd.DataFrame) -> str:
    means = results.groupby("method", sort=False)["psnr"].mean()
    others = means.drop("noisy", errors="ignore")
    return str((means if others.empty else others).idxmax())


def _row(results: pd.DataFrame, name: str, folder: Path) -> pd.DataFrame:
    """The pairs of a row, by their content and, for the bootstrap, their frame."""
    found = results[results["method"] == name]
    if found.empty:
        known = ", ".join(results["method"].unique())
        raise FactoryError(f"{folder}: no row {name!r}; it has {known}")
    return found.set_index(["pair", "location", "scene", "frame"])
