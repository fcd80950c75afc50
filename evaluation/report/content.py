"""What the report says, as plain data: the one source of every file that shows it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..methods import Method
from ..metrics.fidelity import PSNR_CAP_DB
from ..metrics.statistics import Estimate, estimate, frames_needed, holm, paired
from ..runner import SECONDS, Measured
from ..settings import EvaluationSettings
from . import paper
from .tables import METRIC_NAMES, interval, percent, plain, written_p

if TYPE_CHECKING:
    from ..pairs import Item

SCHEMA = "simnfnd-report/1"
_COMPARED = ("psnr", "ssim", "gmsd", "psnr_fan", "ssim_fan", "gmsd_fan", "shadow_iou")


def content_of(
    methods: Sequence[Method],
    measured: Measured,
    items: Sequence[Item],
    settings: EvaluationSettings,
    tuned: Mapping[str, Any],
    costs: Mapping[str, Mapping[str, float]],
) -> dict[str, Any]:
    """The rows with their intervals and tests, best PSNR first, and the paper's tables.

    tuned: baseline -> entry of the tuned file.  costs: label -> gmac and parameters of networks.
    """
    figures = measured.wide()
    groups = [item.group for item in items]
    options = {"resamples": settings.bootstrap, "seed": settings.seed}

    def compared(label: str, other: str) -> dict[str, Any]:
        """Pair by pair, metric by metric."""
        found = {}
        for name in (name for name in _COMPARED if name in figures):
            first, second = (figures[name][one].to_numpy() for one in (label, other))
            better = METRIC_NAMES[name].better
            result = paired(first, second, groups, better=better, **options)
            both = {"p": plain(result.p), "wins": plain(result.wins)}
            found[name] = _as_dict(result.difference) | both
        return found

    found = []
    for method in methods:
        label, lost = method.label, measured.lost.get(method.label)
        seconds = math.nan if lost else float(np.median(figures[SECONDS][label]))
        noisy = lost is not None or method.kind == "noisy"
        metrics = [] if lost else [name for name in figures if name != SECONDS]
        found.append(
            {
                **{n: getattr(method, n) for n in ("label", "name", "form", "kind")},
                "parameters": dict(method.parameters),
                "levels": None if method.levels is None else vars(method.levels),
                "ablation": method.ablation,
                "milliseconds": plain(1000 * seconds),
                "gmac": costs.get(label, {}).get("gmac"),
                "weights": costs.get(label, {}).get("parameters"),
                "lost": lost,
                "metrics": {
                    name: _as_dict(estimate(figures[name][label].to_numpy(), groups, **options))
                    for name in metrics
                },
                "against_noisy": {} if noisy else compared(label, "noisy"),
                "against_best": {},
            }
        )
    _adjust(found, "against_noisy")
    best, chosen_on = best_classical(found, tuned)
    if best is not None:
        for line in found:
            if line["kind"] in ("network", "pictures") and line["lost"] is None:
                line["against_best"] = compared(line["label"], best)
        _adjust(found, "against_best")
    found.sort(key=lambda line: math.inf if line["lost"] else -line["metrics"]["psnr"]["mean"])
    second, third = paper.table_2(found), paper.table_3(found)
    # Weights of Table 3 are seldom given; without any there is nothing to say of it.
    given = any(line["ours"] for line in third)
    facts = _facts(settings, items, int((figures["psnr"]["noisy"] >= PSNR_CAP_DB).sum()))
    return {
        "schema": SCHEMA,
        "facts": {**facts, "few_frames": few_frames(found, len(set(groups)))},
        "rows": found,
        "best_classical": {"row": best, "chosen_on": chosen_on},
        "table_2": second,
        "table_3": third,
        "ordering": paper.ordering(second),
        "ordering_3": paper.ordering(third, "Table 3", digits=3) if given else [],
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
                f"({interval(margin, 2)}; Wilcoxon-Holm p {written_p(margin['p_holm'])}; better "
                f"in {percent(margin['wins'])} of the pairs)."
            )
    return " ".join(lines)


def _facts(settings: EvaluationSettings, items: Sequence[Item], identical: int) -> dict[str, Any]:
    """What was measured, and how."""
    rules = [
        "Intervals: 95 % bootstrap that draws whole frames. Wilcoxon: signed ranks of the frames' "
        "mean differences, Holm's correction over the rows. Wins: share of pairs where the row "
        "is better.",
        f"PSNR: mean of the dB values of the images; identical pairs ({identical} here) count as "
        f"{PSNR_CAP_DB:g} dB. SSIM: Gaussian window, sigma 1.5. GMSD: 2x2 mean first, c = 170 on "
        "0..255; `as printed` in the paper: without the 2x2 mean. A pixel is shadow at or below "
        f"{settings.shadow_threshold:g} of full scale. ENL rewards blur and a ratio mean of 1 is "
        "best: neither ranks methods alone.",
        "`+ levels`: one gain and offset for all images; they and the parameters of `tuned` come "
        "from validation pairs. ms: median CPU time of one image (of networks on a GPU: elapsed "
        "time); other processes can still slow it down through shared caches.",
    ]
    return {
        "dataset": settings.name,
        "split": settings.split,
        "pairs": len(items),
        "frames": len({item.group for item in items}),
        "scenes": sorted({item.scene for item in items}),
        "locations": sorted({item.location for item in items}),
        "identical_pairs": identical,
        "shadow_threshold": settings.shadow_threshold,
        "seed": settings.seed,
        "bootstrap": settings.bootstrap,
        "rules": rules,
    }


def few_frames(rows: Sequence[Mapping[str, Any]], frames: int) -> str:
    """What to say of the tests where so few frames can show nothing; else nothing."""
    comparisons = sum("psnr" in row["against_noisy"] for row in rows)
    needed = frames_needed(comparisons)
    if not comparisons or frames >= needed:
        return ""
    return (
        f"With {frames} frames and {comparisons} comparisons p (Holm) cannot fall below 0.05, "
        f"however many wins there are: it takes {needed} frames. The intervals are rough, too."
    )


def best_forms(rows: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Of each method the form with the best PSNR here; rows come best first, lost ones last."""
    best: dict[str, Mapping[str, Any]] = {}
    for row in rows:
        if row["kind"] == "noisy" or row["name"] != "identity":
            best.setdefault(row["name"], row)
    return list(best.values())


def shown_rows(rows: Sequence[Mapping[str, Any]], most: int) -> list[str]:
    """Labels for pictures and curves: noisy, then of each method its best form, best first."""
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
        values = [np.nan if one["p"] is None else one["p"] for one in family]
        for one, adjusted in zip(family, holm(values), strict=True):
            one["p_holm"] = plain(adjusted)
