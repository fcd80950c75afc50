"""The tables of the paper beside the rows that were measured here.

Source: Yang, Zhang and Yao 2024, Remote Sensing 16(15), 2815.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from .tables import TABLE_METRICS, Content

OURS = "simnfnd_newloss"


class PaperRow(NamedTuple):
    """A row as the paper prints it.  psnr: dB."""

    title: str
    psnr: float
    ssim: float
    gmsd: float

    def figures(self) -> dict[str, float]:
        """Metric -> figure."""
        return {metric: getattr(self, metric) for metric in TABLE_METRICS}


TABLE_2 = {
    "identity": PaperRow("Origin", 17.64, 0.68, 0.22),
    "median": PaperRow("Median", 17.76, 0.69, 0.19),
    "gaussian": PaperRow("Gaussian", 17.76, 0.69, 0.20),
    "bilateral": PaperRow("Bilateral", 17.90, 0.69, 0.19),
    "nlm": PaperRow("NLM", 17.73, 0.69, 0.21),
    "bm3d": PaperRow("BM3D", 16.65, 0.69, 0.19),
    OURS: PaperRow("Ours", 20.77, 0.79, 0.18),
}
"""Methods on the full frame of 1000 simulated pairs; keys as in the registry of filters."""

TABLE_3 = {
    "olddata_l1": PaperRow("OldData + L1loss", 17.897056920, 0.744666177, 0.194743096),
    "simnfnd_l1": PaperRow("SimNFND + L1loss", 20.16920049, 0.7889269, 0.188262191),
    OURS: PaperRow("SimNFND + Newloss", 20.775460450, 0.795312975, 0.180447812),
}
"""The ablation; keys as those of `ablation` in the configuration."""


def table_2_beside(rows: Sequence[Content]) -> list[dict[str, Any]]:
    """Table 2 beside these rows; the network is that of `ablation`, else the best one given.

    rows: of the report, the best first, lost ones last.
    """
    lines = []
    for name, paper_row in TABLE_2.items():
        counterpart = _counterpart(name, rows)
        if counterpart is None and name == OURS:
            counterpart = _best_network(rows)
        lines.append(_line(paper_row, counterpart))
    return lines


def table_3_beside(rows: Sequence[Content]) -> list[dict[str, Any]]:
    """Table 3 beside these rows; empty unless a network of `ablation` was measured."""
    lines = [_line(paper_row, _counterpart(name, rows)) for name, paper_row in TABLE_3.items()]
    # Weights of Table 3 are seldom given; without any there is nothing to compare.
    is_measured = any(line["ours"] for line in lines)
    return lines if is_measured else []


def _counterpart(name: str, rows: Sequence[Content]) -> Content | None:
    """Our row of a method: a baseline with the defaults of its library, or one of `ablation`."""
    for row in rows:
        is_default = row["kind"] in ("noisy", "baseline") and not row["form"]
        if is_default and row["name"] == name:
            return row
    return next((row for row in rows if row["ablation"] == name), None)


def _best_network(rows: Sequence[Content]) -> Content | None:
    return next((row for row in rows if row["kind"] == "network" and row["lost"] is None), None)


def _line(paper_row: PaperRow, counterpart: Content | None) -> dict[str, Any]:
    """A row of the paper, and the means of its counterpart where that was measured."""
    line: dict[str, Any] = {
        "title": paper_row.title,
        "paper": paper_row.figures(),
        "ours": None,
        "row": None,
    }
    if counterpart is None:
        return line
    line["row"] = counterpart["label"]
    if counterpart["lost"] is None:
        line["ours"] = _means_of(counterpart)
    return line


def _means_of(row: Content) -> Mapping[str, float]:
    """The metrics of the paper's tables -> mean of a row that was measured."""
    return {metric: row["metrics"][metric]["mean"] for metric in TABLE_METRICS}
