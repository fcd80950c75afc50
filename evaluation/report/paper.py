"""Tables 2 and 3 of the paper (Yang, Zhang and Yao 2024, Remote Sensing 16(15), 2815) and ours."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

from .tables import TABLE_METRICS

_BETTER = {"psnr": 1, "ssim": 1, "gmsd": -1}

OURS = "simnfnd_newloss"

TABLE_2 = {
    "identity": ("Origin", (17.64, 0.68, 0.22)),
    "median": ("Median", (17.76, 0.69, 0.19)),
    "gaussian": ("Gaussian", (17.76, 0.69, 0.20)),
    "bilateral": ("Bilateral", (17.90, 0.69, 0.19)),
    "nlm": ("NLM", (17.73, 0.69, 0.21)),
    "bm3d": ("BM3D", (16.65, 0.69, 0.19)),
    OURS: ("Ours", (20.77, 0.79, 0.18)),
}
"""Row -> its name there and PSNR, SSIM, GMSD; full frame, 1000 simulated pairs."""

TABLE_3 = {
    "olddata_l1": ("OldData + L1loss", (17.897056920, 0.744666177, 0.194743096)),
    "simnfnd_l1": ("SimNFND + L1loss", (20.16920049, 0.7889269, 0.188262191)),
    OURS: ("SimNFND + Newloss", (20.775460450, 0.795312975, 0.180447812)),
}
"""The ablation, row as the keys of `ablation` in the configuration."""

Content = Mapping[str, Any]


def table_2(rows: Sequence[Content]) -> list[dict[str, Any]]:
    """The rows of Table 2: the baselines as their library has them, and the ablation's network.

    Without that network the best of the given networks stands in its row.
    """
    ours = _ablation(rows, OURS) or _best_network(rows)
    found = []
    for name, (title, paper) in TABLE_2.items():
        row = ours if name == OURS else _baseline(rows, name)
        found.append(_line(title, paper, row))
    return found


def table_3(rows: Sequence[Content]) -> list[dict[str, Any]]:
    """The rows of Table 3."""
    return [_line(title, paper, _ablation(rows, name)) for name, (title, paper) in TABLE_3.items()]


def ordering(table: Sequence[Content], name: str = "Table 2", digits: int = 2) -> list[str]:
    """Where our order of the rows is not the paper's, one line each; the first line counts them.

    digits: decimals of the paper's figures that count.  Rows that are equal in them there have no
    order, and rows that are as near to each other here are said to be equal.
    """
    lines, compared, equal = [], 0, 0
    step = 10**-digits - 1e-9
    known = [row for row in table if row["ours"] is not None]
    for metric, pair in itertools.product(TABLE_METRICS, itertools.combinations(known, 2)):
        # The one that is better in the paper comes first.
        first, second = sorted(pair, key=lambda row: -_BETTER[metric] * row["paper"][metric])
        there, here = (
            _BETTER[metric] * (first[side][metric] - second[side][metric])
            for side in ("paper", "ours")
        )
        if there < step:
            continue
        compared += 1
        if abs(here) < step:
            equal += 1
        elif here < 0:
            papers, ours = (
                ", ".join(f"{row[side][metric]:.{digits}f}" for row in (first, second))
                for side in ("paper", "ours")
            )
            lines.append(
                f"{metric.upper()}: the paper has {first['title']} before {second['title']} "
                f"({papers}), here it is the other way ({ours})"
            )
    if not compared:
        return [f"{name}: too few rows to compare their order with the paper's."]
    return [
        f"{name}: of {compared} ordered pairs of rows in three metrics, "
        f"{compared - equal - len(lines)} are in the paper's order, {equal} are equal here "
        f"(within {10**-digits:g}), {len(lines)} are the other way.",
        *lines,
    ]


def _line(title: str, paper: tuple[float, float, float], row: Content | None) -> dict[str, Any]:
    ours = None
    if row is not None and row["lost"] is None:
        ours = {metric: row["metrics"][metric]["mean"] for metric in TABLE_METRICS}
    return {
        "title": title,
        "paper": dict(zip(TABLE_METRICS, paper, strict=True)),
        "ours": ours,
        "row": None if row is None else row["label"],
    }


def _baseline(rows: Sequence[Content], name: str) -> Content | None:
    kinds = ("noisy", "baseline")
    found = [row for row in rows if row["name"] == name and row["kind"] in kinds]
    return next((row for row in found if not row["form"]), None)


def _ablation(rows: Sequence[Content], name: str) -> Content | None:
    return next((row for row in rows if row["ablation"] == name), None)


def _best_network(rows: Sequence[Content]) -> Content | None:
    networks = [row for row in rows if row["kind"] == "network" and row["lost"] is None]
    return max(networks, key=lambda row: float(row["metrics"]["psnr"]["mean"]), default=None)
