"""The rows of a report, as plain data: the one source of every file that shows them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

from ...factory.dataset.quality import PSNR_CAP_DB
from ..judging.methods import NOISY, Method
from ..judging.pairs import JudgedPair
from ..judging.runner import SECONDS, Measured
from ..judging.settings import EvaluationSettings
from ..metrics.measure import METRICS
from ..metrics.statistics import LEAST_FRAMES, Estimate, estimate, holm, paired
from .paper_tables import table_2_beside, table_3_beside
from .tables import Content, interval, percent, plain, written_p

if TYPE_CHECKING:
    import pandas as pd

SCHEMA = "simnfnd-report/2"


@dataclass(frozen=True, eq=False)
class Estimator:
    """The figures of all rows, and what their bootstrap draws.

    figures: metric -> its values of each image or group (rows) by each method (columns, labels).
    groups: what each value belongs to, the unit that the bootstrap draws.
    resamples, seed: of the bootstrap.
    """

    figures: Mapping[str, pd.DataFrame]
    groups: Sequence[str]
    resamples: int
    seed: int

    def means(self, label: str) -> dict[str, dict[str, Any]]:
        """Metric -> mean of a row with its interval; metrics without figures are absent."""
        means = {}
        for metric, table in self.figures.items():
            if metric == SECONDS or table[label].isna().all():
                continue
            values = table[label].to_numpy(float)
            mean = estimate(values, self.groups, resamples=self.resamples, seed=self.seed)
            means[metric] = _as_dict(mean)
        return means

    def difference(self, metric: str, label: str, reference: str) -> dict[str, Any]:
        """Mean difference of a row to a reference, pair by pair, with its test."""
        table = self.figures[metric]
        comparison = paired(
            table[label].to_numpy(float),
            table[reference].to_numpy(float),
            self.groups,
            better=METRICS[metric].better,
            resamples=self.resamples,
            seed=self.seed,
        )
        test = {"p": plain(comparison.p), "wins": plain(comparison.wins)}
        return _as_dict(comparison.difference) | test


def rows_of(
    methods: Sequence[Method], measured: Measured, estimator: Estimator
) -> list[dict[str, Any]]:
    """A row for each method: what it is, its figures, or why it is lost."""
    rows = []
    for method in methods:
        label = method.label
        loss = measured.lost.get(label)
        seconds = math.nan if loss is not None else measured.median_seconds(label)
        rows.append({
            "label": label,
            "name": method.name,
            "form": method.form,
            "kind": method.kind,
            "parameters": [dict(point) for point in method.folds or (method.parameters,)],
            "levels": None if method.levels is None else asdict(method.levels),
            "ablation": method.ablation,
            "cpu_s": plain(seconds),
            "lost": loss,
            "metrics": {} if loss is not None else estimator.means(label),
            "against_noisy": {},
            "against_best": {},
        })  # fmt: skip
    return rows


def compare_rows(
    rows: Sequence[dict[str, Any]],
    key: str,
    kinds: Sequence[str],
    references: Mapping[str, str],
    estimator: Estimator,
) -> None:
    """Fill `key` of the rows of some kinds with their differences to references.

    references: metric -> label of the row to compare with.  Each metric is a family of tests, whose
    p values are Holm's as `p_holm`.
    """
    for metric, reference in references.items():
        family = []
        for row in rows:
            if row["kind"] in kinds and metric in row["metrics"] and row["label"] != reference:
                row[key][metric] = estimator.difference(metric, row["label"], reference)
                family.append(row[key][metric])
        add_holm_p(family)


def add_holm_p(family: Sequence[dict[str, Any]]) -> None:
    """Add Holm's adjusted p values, as `p_holm`, to the differences of a family of tests."""
    p_values = [math.nan if test["p"] is None else test["p"] for test in family]
    for test, adjusted_p in zip(family, holm(p_values), strict=True):
        test["p_holm"] = plain(adjusted_p)


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
    rows = rows_of(methods, measured, estimator)
    best = best_classical(rows, tuned)
    compared = [name for name in _COMPARED_METRICS if name in estimator.figures]
    noisy = dict.fromkeys(compared, NOISY.label)
    compare_rows(rows, "against_noisy", ("baseline", "network", "pictures"), noisy, estimator)
    if best.row is not None:
        references = dict.fromkeys(compared, best.row)
        compare_rows(rows, "against_best", ("network", "pictures"), references, estimator)
    rows.sort(key=_rank)
    identical = int((estimator.figures["psnr"][NOISY.label] >= PSNR_CAP_DB).sum())
    return {
        "schema": SCHEMA,
        "facts": _facts(settings, items, identical),
        "rows": rows,
        "best_classical": best._asdict(),
        "table_2": table_2_beside(rows),
        "table_3": table_3_beside(rows),
    }


_COMPARED_METRICS = ("psnr", "ssim", "gmsd", "psnr_fan", "ssim_fan", "gmsd_fan", "shadow_iou")


def _rank(row: Content) -> float:
    """Sorts the best PSNR first, lost rows last."""
    return math.inf if row["lost"] is not None else -float(row["metrics"]["psnr"]["mean"])


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
    validation_psnr_db = {}
    for name, entry in tuned.items():
        for form, key in (("+ levels", "default"), ("tuned + levels", "tuned_levels")):
            if (label := f"{name} {form}") in psnr_db:
                validation_psnr_db[label] = float(entry[key]["psnr_levels"])
    chosen_on = "validation pairs" if validation_psnr_db else "these very pairs"
    candidates = validation_psnr_db or psnr_db
    return BestClassical(max(candidates, key=candidates.__getitem__, default=None), chosen_on)


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


def best_forms(rows: Sequence[Content]) -> list[Content]:
    """The form of each method with the best PSNR here; rows come best first, lost ones last."""
    best: dict[str, Content] = {}
    for row in rows:
        if row["kind"] == "noisy" or row["name"] != "identity":
            best.setdefault(row["name"], row)
    return list(best.values())


def shown_rows(rows: Sequence[Content]) -> list[str]:
    """Labels for images: noisy, then of each method its best form, best first."""
    alive = [row for row in rows if row["lost"] is None]
    best = [row["label"] for row in best_forms(alive) if row["kind"] != "noisy"]
    return ["noisy", *best]


def _as_dict(item: Estimate) -> dict[str, Any]:
    """An estimate for JSON, which has no NaN."""
    return {name: value if name == "count" else plain(value) for name, value in vars(item).items()}
