"""`simnfnd campaign table FOLDER`: the cost-quality table of a campaign.

The campaign (`simnfnd campaign`) has trained networks, several seeds of some, and made a
report on each test set; this puts them together: table.md, table.json and table.png.
"""

from __future__ import annotations

import argparse
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from simnfnd.evaluation.metrics.statistics import Estimate, estimate
from simnfnd.evaluation.report.files import read_results
from simnfnd.factory.errors import FactoryError
from simnfnd.factory.files import write_atomically
from simnfnd.models import WEIGHTS_NAME

QUALITY = ("psnr", "ssim", "gmsd", "shadow_iou")
COUNTING = ("procedural", "real")
"""The test sets of the table; all others are checks of never worse."""
_RESAMPLES, _SEED = 2000, 0
_ROW = re.compile(r"^(?P<row>.+)-s(?P<seed>\d+)$")
_LEVELS = re.compile(r"\+ levels$")

Values = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Scores:
    """The figures of one test set.

    groups: (N,) the frame of each image.  values: label of a method -> metric -> (N,) figures.
    """

    groups: tuple[str, ...]
    values: Mapping[str, Mapping[str, Values]]

    def rows(self) -> dict[str, list[str]]:
        """Row of the campaign -> the labels of its seeds."""
        found: dict[str, list[str]] = {}
        for label in self.values:
            match = _ROW.match(label)
            if match:
                found.setdefault(match["row"], []).append(label)
        return found

    def mean_of(self, labels: Sequence[str], metric: str) -> Values:
        """(N,) mean over the seeds of a row."""
        return np.asarray(np.mean([self.values[label][metric] for label in labels], axis=0))

    def best_classical(self) -> str | None:
        """The label of the best classical method with levels, by mean PSNR on this very set."""
        known = [label for label in self.values if _LEVELS.search(label)]
        return max(known, key=lambda label: float(self.values[label]["psnr"].mean()), default=None)

    def about(self, values: Values) -> Estimate:
        """Mean with its 95 % interval, by frames."""
        return estimate(values, self.groups, resamples=_RESAMPLES, seed=_SEED)


def campaign(words: Sequence[str]) -> int:
    """Make the table of the campaign in a folder; returns the exit code."""
    parser = argparse.ArgumentParser(prog="simnfnd campaign table", description=__doc__)
    parser.add_argument("folder", type=Path, help="`out` of `simnfnd campaign`")
    folder = parser.parse_args(list(words)).folder.expanduser()
    sets = read_sets(folder)
    content = table_of(sets, costs_of(folder, sets))
    text = json.dumps(content, indent=1) + "\n"
    write_atomically(folder / "table.json", text.encode(), key="FOLDER")
    write_atomically(folder / "table.md", markdown(content).encode(), key="FOLDER")
    picture(folder / "table.png", content)
    print(markdown(content))
    print(f"table: {folder / 'table.md'}")
    return 0


def read_sets(folder: Path) -> dict[str, Scores]:
    """Name -> figures of the test sets that have a report.  FactoryError when none has."""
    found = {
        path.name: scores_of(read_results(path))
        for path in sorted((folder / "reports").glob("*"))
        if (path / "results.parquet").is_file()
    }
    if not any(name in found for name in COUNTING):
        raise FactoryError(
            f"{folder}: holds no report of a campaign; make one with `simnfnd campaign`"
        )
    return found


def scores_of(columns: Mapping[str, Any]) -> Scores:
    """The lines of a results.parquet, by method."""
    methods = np.asarray(columns["method"])
    labels = list(dict.fromkeys(methods.tolist()))
    metrics = [
        name for name in (*QUALITY, "shadow_residual", "false_light_rate") if name in columns
    ]
    first = methods == labels[0]
    places = zip(
        *(np.asarray(columns[n])[first] for n in ("location", "scene", "frame")), strict=True
    )
    values = {
        label: {name: np.asarray(columns[name], float)[methods == label] for name in metrics}
        for label in labels
    }
    return Scores(tuple("/".join(map(str, place)) for place in places), values)


def costs_of(folder: Path, sets: Mapping[str, Scores]) -> dict[str, dict[str, float]]:
    """Row -> parameters, GMAC at 256x256 and CPU ms of one core at 512x512, measured here."""
    from simnfnd.models.networks.cost import measure
    from simnfnd.models.networks.weights import load_weights

    found = {}
    for row, labels in _all_rows(sets).items():
        path = folder / "models" / labels[0] / WEIGHTS_NAME
        if path.is_file():
            found[row] = asdict(measure(load_weights(path).network))
    return found


def _all_rows(sets: Mapping[str, Scores]) -> dict[str, list[str]]:
    return {row: labels for scores in sets.values() for row, labels in scores.rows().items()}


def table_of(
    sets: Mapping[str, Scores], costs: Mapping[str, Mapping[str, float]]
) -> dict[str, Any]:
    """The whole table as plain values."""
    content: dict[str, Any] = {"sets": {}, "checks": {}, "costs": dict(costs)}
    for name, scores in sets.items():
        if name in COUNTING:
            content["sets"][name] = _quality(scores)
        else:
            content["checks"][name] = _check(scores)
    return content


def _quality(scores: Scores) -> dict[str, Any]:
    noisy, best = scores.values["noisy"], scores.best_classical()
    rows: dict[str, Any] = {}
    chosen = {"noisy": ["noisy"], **({best: [best]} if best else {}), **scores.rows()}
    for row, labels in chosen.items():
        means = {name: scores.mean_of(labels, name) for name in QUALITY if name in noisy}
        each = [float(scores.values[label]["psnr"].mean()) for label in labels]
        entry = {name: asdict(scores.about(values)) for name, values in means.items()}
        entry["gain_db"] = asdict(scores.about(means["psnr"] - noisy["psnr"]))
        if best:
            margin = means["psnr"] - scores.values[best]["psnr"]
            entry["margin_db"] = asdict(scores.about(margin))
        lost = [scores.values[label]["psnr"] - noisy["psnr"] for label in labels]
        rows[row] = {
            **entry,
            "seeds": len(labels),
            "seed_spread_db": max(each) - min(each),
            "worse": int(np.sum(np.array(lost) < 0)),
            "images": int(np.size(lost)),
            "worst_gain_db": float(np.min(lost)),
        }
    frames = len(set(scores.groups))
    return {"images": len(scores.groups), "frames": frames, "best_classical": best, "rows": rows}


def _check(scores: Scores) -> dict[str, Any]:
    """PSNR in and out, and how many images came out worse, of every row."""
    noisy = scores.values["noisy"]["psnr"]
    rows = {}
    for row, labels in scores.rows().items():
        out = np.array([scores.values[label]["psnr"] for label in labels])
        rows[row] = {
            "psnr": float(out.mean()),
            "psnr_noisy": float(noisy.mean()),
            "lowest_psnr": float(out.min()),
            "worse": int((out < noisy).sum()),
            "images": int(out.size),
            "worst_gain_db": float((out - noisy).min()),
        }
    return {"images": len(scores.groups), "rows": rows}


def markdown(content: Mapping[str, Any]) -> str:
    """The table for people."""
    parts = []
    for name, found in content["sets"].items():
        parts.append(
            f"### {name}: {found['images']} pairs of {found['frames']} frames\n\n"
            "| row | seeds | PSNR, dB | gain, dB | margin, dB | SSIM | GMSD | shadow IoU | worse | "
            "GMAC | CPU ms |\n|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|"
        )
        for row, entry in found["rows"].items():
            cost = content["costs"].get(row, {})
            shown = [row, str(entry["seeds"])]
            digits = {"psnr": 2, "gain_db": 2, "margin_db": 2, "ssim": 3, "gmsd": 3}
            for metric in ("psnr", "gain_db", "margin_db", "ssim", "gmsd", "shadow_iou"):
                shown.append(_interval(entry.get(metric), digits.get(metric, 3)))
            shown.append(f"{entry['worse']} of {entry['images']}")
            shown += [f"{cost['gmac']:.2f}", f"{cost['cpu_ms']:.0f}"] if cost else ["", ""]
            parts.append(f"| {' | '.join(shown)} |")
        best = found["best_classical"]
        told = f"over `{best}`, the best classical method on these very pairs, with levels"
        parts.append(f"\nMargin: {told if best else 'unknown, no classical method was tuned'}.\n")
    if content["checks"]:
        parts.append(
            "### Never worse?\n\n| test set | row | PSNR in, dB | out | lowest | worse | worst |"
            "\n|---|---|---:|---:|---:|---:|---:|"
        )
        for name, found in content["checks"].items():
            for row, entry in found["rows"].items():
                parts.append(
                    f"| {name} | {row} | {entry['psnr_noisy']:.2f} | {entry['psnr']:.2f} | "
                    f"{entry['lowest_psnr']:.2f} | {entry['worse']} of {entry['images']} | "
                    f"{entry['worst_gain_db']:+.2f} |"
                )
        parts.append("\nAn untouched image counts as 100 dB: at no noise at all, `out` counts.\n")
    parts.append(
        "Intervals: 95 % bootstrap by frames.  Of several seeds the mean; GMAC at 256x256, CPU "
        "milliseconds of one core at 512x512.\n"
    )
    return "\n".join(parts)


def _interval(item: Mapping[str, float] | None, digits: int) -> str:
    if item is None or not item["count"]:
        return "-"
    mean, low, high = (f"{item[name]:.{digits}f}" for name in ("mean", "low", "high"))
    return f"{mean} ({low} .. {high})"


def picture(path: Path, content: Mapping[str, Any]) -> None:
    """Gain over noisy against GMAC and against CPU time, a mark for each row and test set."""
    from matplotlib.figure import Figure  # slow to import

    figure = Figure(figsize=(11, 4.6), layout="constrained", facecolor="white")
    axes = figure.subplots(1, 2, sharey=True)
    labels = {"gmac": "GMAC at 256x256", "cpu_ms": "CPU ms at 512x512, one core"}
    for axis, (key, label) in zip(axes, labels.items(), strict=True):
        for (name, found), mark in zip(content["sets"].items(), "os", strict=False):
            rows = {r: e for r, e in found["rows"].items() if r in content["costs"]}
            if not rows:
                continue
            x = [content["costs"][row][key] for row in rows]
            gains = [entry["gain_db"] for entry in rows.values()]
            y = [gain["mean"] for gain in gains]
            low = [gain["mean"] - gain["low"] for gain in gains]
            high = [gain["high"] - gain["mean"] for gain in gains]
            axis.errorbar(x, y, yerr=[low, high], fmt=mark, ms=6, capsize=3, label=name)
            for row, one, two in zip(rows, x, y, strict=True):
                axis.annotate(row, (one, two), (5, 5), textcoords="offset points", fontsize=8)
        axis.set(xscale="log", xlabel=label)
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("gain over noisy, dB")
    axes[0].legend(frameon=False)
    figure.savefig(path, dpi=110)
