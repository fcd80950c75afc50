"""What the report says, as plain data: the one source of every file that shows it."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any, NamedTuple

from ..judging.methods import NOISY, Method
from ..judging.pairs import JudgedPair
from ..judging.runner import Measured
from ..judging.settings import EvaluationSettings
from ..metrics.fidelity import PSNR_CAP_DB
from ..metrics.statistics import LEAST_FRAMES
from .estimates import Estimator, add_holm_p
from .paper_tables import table_2_beside, table_3_beside
from .tables import Content, interval, percent, plain, written_p

SCHEMA = "simnfnd-report/1"


def content_of(
    methods: Sequence[Method],
    measured: Measured,
    items: Sequence[JudgedPair],
    settings: EvaluationSettings,
    tuned: Mapping[str, Any],
) -> dict[str, Any]:
    """The rows with their intervals and tests, best PSNR first, and the paper's tables.

    tuned: baseline -> entry of the tuned file.
    """
    groups = [item.group for item in items]
    estimator = Estimator(measured.wide(), groups, settings.bootstrap, settings.seed)
    rows = [_row(method, measured.lost.get(method.label), estimator) for method in methods]
    best = best_classical(rows, tuned)
    _compare_with_noisy(rows, estimator)
    if best.row is not None:
        _compare_with_best(rows, best.row, estimator)
    rows.sort(key=_rank)
    return {
        "schema": SCHEMA,
        "facts": _facts(settings, items, _count_identical(estimator)),
        "rows": rows,
        "best_classical": best._asdict(),
        "table_2": table_2_beside(rows),
        "table_3": table_3_beside(rows),
    }


def _row(method: Method, loss: str | None, estimator: Estimator) -> dict[str, Any]:
    """A method with its figures; loss: why it has none, if so."""
    label = method.label
    is_lost = loss is not None
    return {
        "label": label,
        "name": method.name,
        "form": method.form,
        "kind": method.kind,
        "parameters": dict(method.parameters),
        "levels": None if method.levels is None else vars(method.levels),
        "ablation": method.ablation,
        "milliseconds": None if is_lost else plain(estimator.median_milliseconds(label)),
        "lost": loss,
        "metrics": {} if is_lost else estimator.means(label),
        "against_noisy": {},
        "against_best": {},
    }


def _compare_with_noisy(rows: Sequence[dict[str, Any]], estimator: Estimator) -> None:
    """Fill `against_noisy` of every row that changes the image."""
    for row in rows:
        if row["kind"] != "noisy" and row["lost"] is None:
            row["against_noisy"] = estimator.differences(row["label"], NOISY.label)
    add_holm_p([row["against_noisy"] for row in rows])


def _compare_with_best(rows: Sequence[dict[str, Any]], best: str, estimator: Estimator) -> None:
    """Fill `against_best` of networks and of other programs' images; best: label of a baseline."""
    for row in rows:
        if row["kind"] in ("network", "pictures") and row["lost"] is None:
            row["against_best"] = estimator.differences(row["label"], best)
    add_holm_p([row["against_best"] for row in rows])


def _rank(row: Content) -> float:
    """Sorts the best PSNR first, lost rows last."""
    if row["lost"] is not None:
        return math.inf
    return -float(row["metrics"]["psnr"]["mean"])


def _count_identical(estimator: Estimator) -> int:
    """The number of pairs whose noisy image is the clean one."""
    return int((estimator.values("psnr", NOISY.label) >= PSNR_CAP_DB).sum())


class BestClassical(NamedTuple):
    """The best baseline.  row: its label; None: there is none.  chosen_on: which pairs."""

    row: str | None
    chosen_on: str


def best_classical(rows: Sequence[Content], tuned: Mapping[str, Any]) -> BestClassical:
    """The baseline of the best PSNR.

    On validation pairs where baselines are tuned, so that the choice has not seen the test pairs.
    """
    psnr_db = {
        row["label"]: float(row["metrics"]["psnr"]["mean"])
        for row in rows
        if row["kind"] == "baseline" and row["lost"] is None
    }
    validation_psnr_db = _validation_psnr_db(tuned, psnr_db)
    if validation_psnr_db:
        label = max(validation_psnr_db, key=validation_psnr_db.__getitem__)
        return BestClassical(label, "validation pairs")
    label_or_none = max(psnr_db, key=psnr_db.__getitem__, default=None)
    return BestClassical(label_or_none, "these very pairs")


def _validation_psnr_db(tuned: Mapping[str, Any], labels: Collection[str]) -> dict[str, float]:
    """Label -> PSNR on validation pairs, of those `labels` that have tuned levels."""
    psnr_db = {}
    for name, entry in tuned.items():
        for form, key in (("+ levels", "default"), ("tuned + levels", "tuned_levels")):
            label = f"{name} {form}"
            if label in labels:
                psnr_db[label] = float(entry[key]["psnr_levels"])
    return psnr_db


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


def _facts(
    settings: EvaluationSettings, items: Sequence[JudgedPair], identical: int
) -> dict[str, Any]:
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
    """The form of each method with the best PSNR here; rows come best first, lost ones last."""
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
