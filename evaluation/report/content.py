"""What the report says, as plain data: the one source of every file that shows it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..methods import Method
from ..metrics.fidelity import PSNR_CAP_DB
from ..metrics.statistics import LEAST_FRAMES, Estimate, estimate, holm, paired
from ..pairs import Item
from ..runner import SECONDS, Measured
from ..settings import EvaluationSettings
from .tables import (
    METRIC_NAMES,
    TABLE_METRICS,
    Content,
    interval,
    percent,
    plain,
    written_p,
)

SCHEMA = "simnfnd-report/1"
_COMPARED = ("psnr", "ssim", "gmsd", "psnr_fan", "ssim_fan", "gmsd_fan", "shadow_iou")

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
"""Row of the paper's Table 2 (Yang, Zhang and Yao 2024, Remote Sensing 16(15), 2815) -> its name
there and PSNR, SSIM, GMSD; full frame, 1000 simulated pairs."""

TABLE_3 = {
    "olddata_l1": ("OldData + L1loss", (17.897056920, 0.744666177, 0.194743096)),
    "simnfnd_l1": ("SimNFND + L1loss", (20.16920049, 0.7889269, 0.188262191)),
    OURS: ("SimNFND + Newloss", (20.775460450, 0.795312975, 0.180447812)),
}
"""The ablation, row as the keys of `ablation` in the configuration."""


def content_of(
    methods: Sequence[Method],
    measured: Measured,
    items: Sequence[Item],
    settings: EvaluationSettings,
    tuned: Mapping[str, Any],
) -> dict[str, Any]:
    """The rows with their intervals and tests, best PSNR first, and the paper's tables.

    tuned: baseline -> entry of the tuned file.
    """
    figures = measured.wide()
    groups = [item.group for item in items]
    options = {"resamples": settings.bootstrap, "seed": settings.seed}

    def compared(label: str, reference: str) -> dict[str, Any]:
        """Pair by pair, metric by metric."""
        lines = {}
        for name in (name for name in _COMPARED if name in figures):
            first, second = (figures[name][side].to_numpy() for side in (label, reference))
            better = METRIC_NAMES[name].better
            result = paired(first, second, groups, better=better, **options)
            both = {"p": plain(result.p), "wins": plain(result.wins)}
            lines[name] = _as_dict(result.difference) | both
        return lines

    lines = []
    for method in methods:
        label = method.label
        lost = measured.lost.get(method.label)
        seconds = math.nan if lost else float(np.median(figures[SECONDS][label]))
        noisy = lost is not None or method.kind == "noisy"
        metrics = [] if lost else [name for name in figures if name != SECONDS]
        lines.append(
            {
                **{n: getattr(method, n) for n in ("label", "name", "form", "kind")},
                "parameters": dict(method.parameters),
                "levels": None if method.levels is None else vars(method.levels),
                "ablation": method.ablation,
                "milliseconds": plain(1000 * seconds),
                "lost": lost,
                "metrics": {
                    name: _as_dict(estimate(figures[name][label].to_numpy(), groups, **options))
                    for name in metrics
                },
                "against_noisy": {} if noisy else compared(label, "noisy"),
                "against_best": {},
            }
        )
    _adjust(lines, "against_noisy")
    best, chosen_on = best_classical(lines, tuned)
    if best is not None:
        for line in lines:
            if line["kind"] in ("network", "pictures") and line["lost"] is None:
                line["against_best"] = compared(line["label"], best)
        _adjust(lines, "against_best")
    lines.sort(key=lambda line: math.inf if line["lost"] else -line["metrics"]["psnr"]["mean"])
    third = paper_table(TABLE_3, lines)
    facts = _facts(settings, items, int((figures["psnr"]["noisy"] >= PSNR_CAP_DB).sum()))
    return {
        "schema": SCHEMA,
        "facts": facts,
        "rows": lines,
        "best_classical": {"row": best, "chosen_on": chosen_on},
        "table_2": paper_table(TABLE_2, lines),
        # Weights of Table 3 are seldom given; without any there is nothing to say of it.
        "table_3": third if any(line["ours"] for line in third) else [],
    }


def best_classical(
    rows: Sequence[Mapping[str, Any]], tuned: Mapping[str, Any]
) -> tuple[str | None, str]:
    """(label of the best baseline, what it was chosen on).

    On validation pairs where baselines are tuned, so that the choice has not seen the test pairs.
    """
    psnr = {
        row["label"]: float(row["metrics"]["psnr"]["mean"])
        for row in rows
        if row["kind"] == "baseline" and row["lost"] is None
    }
    known = {
        label: float(entry[key]["psnr_levels"])
        for name, entry in tuned.items()
        for form, key in (("+ levels", "default"), ("tuned + levels", "tuned_levels"))
        if (label := f"{name} {form}") in psnr
    }
    chosen, on = (known, "validation pairs") if known else (psnr, "these very pairs")
    return max(chosen, key=chosen.__getitem__, default=None), on


def verdict(content: Mapping[str, Any]) -> str:
    """What the networks give beyond the best baseline, in words."""
    best = content["best_classical"]
    if best["row"] is None:
        return "No baseline was measured."
    lines = [f"The best classical row is `{best['row']}`, chosen on {best['chosen_on']}."]
    for row in content["rows"]:
        margin = row["against_best"].get("psnr")
        if margin is not None:
            lines.append(
                f"`{row['label']}` is {margin['mean']:+.2f} dB from it "
                f"({_evidence(margin)}better in {percent(margin['wins'])} of the pairs)."
            )
    return " ".join(lines)


def _evidence(margin: Mapping[str, Any]) -> str:
    """The interval and the p value of a difference, where there are frames enough for them."""
    parts = []
    if margin["low"] is not None:
        parts.append(interval(margin, 2))
    if margin["p_holm"] is not None:
        parts.append(f"Wilcoxon-Holm p {written_p(margin['p_holm'])}")
    return "".join(f"{part}; " for part in parts)


def _facts(settings: EvaluationSettings, items: Sequence[Item], identical: int) -> dict[str, Any]:
    """What was measured, and how."""
    rules = [
        "Intervals: 95 % bootstrap that draws whole frames. p: Wilcoxon signed ranks of the mean "
        f"differences of frames, Holm's correction over the rows, from {LEAST_FRAMES} frames "
        f"on. Identical pairs ({identical} here) count as {PSNR_CAP_DB:g} dB. ENL and the ratio "
        "image rank no methods alone. "
        "`+ levels`: one gain and offset for all images; they and the parameters of `tuned` come "
        "from validation pairs. ms: median CPU time of an image (of networks on a GPU: elapsed "
        "time).",
    ]
    return {
        "dataset": settings.name,
        "split": settings.split,
        "pairs": len(items),
        "frames": len({item.group for item in items}),
        "scenes": sorted({item.scene for item in items}),
        "locations": sorted({item.location for item in items}),
        "identical_pairs": identical,
        "seed": settings.seed,
        "bootstrap": settings.bootstrap,
        "rules": rules,
    }


def best_forms(rows: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Of each method the form with the best PSNR here; rows come best first, lost ones last."""
    best: dict[str, Mapping[str, Any]] = {}
    for row in rows:
        if row["kind"] == "noisy" or row["name"] != "identity":
            best.setdefault(row["name"], row)
    return list(best.values())


def shown_rows(rows: Sequence[Mapping[str, Any]], most: int) -> list[str]:
    """Labels for images: noisy, then of each method its best form, best first."""
    alive = [row for row in rows if row["lost"] is None]
    best = [row["label"] for row in best_forms(alive) if row["kind"] != "noisy"]
    return ["noisy", *best[:most]]


def _as_dict(item: Estimate) -> dict[str, Any]:
    """An estimate for JSON."""
    return {name: value if name == "count" else plain(value) for name, value in vars(item).items()}


def _adjust(rows: Sequence[dict[str, Any]], key: str) -> None:
    """Add Holm's p over the rows, metric by metric."""
    for name in _COMPARED:
        family = [row[key][name] for row in rows if name in row[key]]
        values = [np.nan if result["p"] is None else result["p"] for result in family]
        for result, adjusted in zip(family, holm(values), strict=True):
            result["p_holm"] = plain(adjusted)


def paper_table(
    table: Mapping[str, tuple[str, tuple[float, float, float]]], rows: Sequence[Content]
) -> list[dict[str, Any]]:
    """The rows of a table of the paper beside ours.

    Baselines as their library has them, networks by `ablation`; for OURS in Table 2 else the best
    of the given networks.  rows: the best first, those that are lost last.
    """
    lines: list[dict[str, Any]] = []
    for name, (title, paper) in table.items():
        named = (row for row in rows if row["name"] == name and not row["form"])
        same = [row for row in named if row["kind"] in ("noisy", "baseline")]
        same += [row for row in rows if row["ablation"] == name]
        if name == OURS and table is TABLE_2:
            same += [row for row in rows if row["kind"] == "network" and row["lost"] is None]
        line: dict[str, Any] = {
            "title": title,
            "paper": dict(zip(TABLE_METRICS, paper, strict=True)),
        }
        line |= {"ours": None, "row": same[0]["label"] if same else None}
        if same and same[0]["lost"] is None:
            line["ours"] = {name: same[0]["metrics"][name]["mean"] for name in TABLE_METRICS}
        lines.append(line)
    return lines
