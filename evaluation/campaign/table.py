"""`simnfnd campaign table FOLDER`: the cost-quality table of a campaign.

`simnfnd campaign` trains networks, some with several seeds, and makes a report on each test set;
this puts the reports together: table.md, table.json and table.png.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ...factory.cli import Parser
from ...factory.dataset.describe import markdown
from ...factory.errors import FactoryError
from ...factory.files import write_atomically
from ...models import WEIGHTS_NAME
from ..metrics.statistics import Estimate, estimate
from ..report.files import read_content, read_results
from .trainings import Training, read_trainings

QUALITY = ("psnr", "ssim", "gmsd", "shadow_iou")
COUNTING = ("procedural", "real")
"""The test sets of the table; all others are checks of never worse."""
_RESAMPLES, _SEED = 2000, 0

Values = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Scores:
    """The figures of one test set.

    groups: (N,) the frame of each image.  values: label of a method -> metric -> (N,) figures.
    rows: row of the campaign -> the labels of its seeds.
    classical: labels of the classical methods with levels.
    """

    groups: tuple[str, ...]
    values: Mapping[str, Mapping[str, Values]]
    rows: Mapping[str, Sequence[str]]
    classical: Sequence[str]

    def mean_of(self, labels: Sequence[str], metric: str) -> Values:
        """(N,) mean over the seeds of a row."""
        return np.asarray(np.mean([self.values[label][metric] for label in labels], axis=0))

    def best_classical(self) -> str | None:
        """The label of the best classical method with levels, by mean PSNR on this very set."""
        return max(
            self.classical, key=lambda label: float(self.values[label]["psnr"].mean()), default=None
        )

    def estimate(self, values: Values) -> Estimate:
        """Mean with its 95 % interval, by frames."""
        return estimate(values, self.groups, resamples=_RESAMPLES, seed=_SEED)


def campaign(words: Sequence[str]) -> int:
    """Make the table of the campaign in a folder; returns the exit code."""
    parser = Parser(prog="simnfnd campaign table")
    parser.add_argument("folder", type=Path, help="`out` of `simnfnd campaign`")
    folder = parser.parse_args(list(words)).folder.expanduser()
    trainings = read_trainings(folder)
    content = table_of(read_sets(folder, trainings), costs_of(folder, trainings))
    text = json.dumps(content, indent=1) + "\n"
    write_atomically(folder / "table.json", text.encode(), key="FOLDER")
    write_atomically(folder / "table.md", as_markdown(content).encode(), key="FOLDER")
    picture(folder / "table.png", content)
    print(as_markdown(content))
    print(f"table: {folder / 'table.md'}")
    return 0


def read_sets(folder: Path, trainings: Sequence[Training]) -> dict[str, Scores]:
    """Name -> figures of the test sets that have a report.  FactoryError when none has."""
    found = {
        path.name: scores_of(read_results(path), read_content(path), trainings)
        for path in sorted((folder / "reports").glob("*"))
        if (path / "results.parquet").is_file()
    }
    if not any(name in found for name in COUNTING):
        raise FactoryError(
            f"{folder}: holds no report of a campaign; make one with `simnfnd campaign`"
        )
    return found


def scores_of(
    columns: Mapping[str, Any], content: Mapping[str, Any], trainings: Sequence[Training]
) -> Scores:
    """The figures of one report.  columns: of results.parquet.  content: of report.json."""
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
    rows: dict[str, list[str]] = {}
    for one in trainings:
        if one.label in values:
            rows.setdefault(one.row, []).append(one.label)
    classical = [
        row["label"]
        for row in content["rows"]
        if row["kind"] == "baseline" and row["levels"] and row["label"] in values
    ]
    groups = tuple("/".join(map(str, place)) for place in places)
    return Scores(groups, values, rows, classical)


def costs_of(folder: Path, trainings: Sequence[Training]) -> dict[str, dict[str, float]]:
    """Row -> parameters, GMAC at 256x256 and CPU ms of one core at 512x512, measured here."""
    from ...models.networks.cost import measure
    from ...models.networks.weights import load_weights

    found: dict[str, dict[str, float]] = {}
    for one in trainings:
        path = folder / one.folder / WEIGHTS_NAME
        if one.row not in found and path.is_file():
            found[one.row] = asdict(measure(load_weights(path).network))
    return found


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
    chosen = {"noisy": ["noisy"], **({best: [best]} if best else {}), **scores.rows}
    for row, labels in chosen.items():
        means = {name: scores.mean_of(labels, name) for name in QUALITY if name in noisy}
        each = [float(scores.values[label]["psnr"].mean()) for label in labels]
        entry = {name: asdict(scores.estimate(values)) for name, values in means.items()}
        entry["gain_db"] = asdict(scores.estimate(means["psnr"] - noisy["psnr"]))
        if best:
            margin = means["psnr"] - scores.values[best]["psnr"]
            entry["margin_db"] = asdict(scores.estimate(margin))
        gains = [scores.values[label]["psnr"] - noisy["psnr"] for label in labels]
        rows[row] = {
            **entry,
            "seeds": len(labels),
            "seed_spread_db": max(each) - min(each),
            "worse": int(np.sum(np.array(gains) < 0)),
            "images": int(np.size(gains)),
            "worst_gain_db": float(np.min(gains)),
        }
    frames = len(set(scores.groups))
    return {"images": len(scores.groups), "frames": frames, "best_classical": best, "rows": rows}


def _check(scores: Scores) -> dict[str, Any]:
    """PSNR in and out, and how many images came out worse, of every row."""
    noisy = scores.values["noisy"]["psnr"]
    rows = {}
    for row, labels in scores.rows.items():
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


_HEAD = ("row", "seeds", "PSNR, dB", "gain, dB", "margin, dB", "SSIM", "GMSD", "shadow IoU",
         "worse", "GMAC", "CPU ms")  # fmt: skip
_DIGITS = {"psnr": 2, "gain_db": 2, "margin_db": 2, "ssim": 3, "gmsd": 3, "shadow_iou": 3}
_CHECKS = ("test set", "row", "PSNR in, dB", "out", "lowest", "worse", "worst")


def as_markdown(content: Mapping[str, Any]) -> str:
    """The table for people."""
    parts = [_set_table(name, found, content["costs"]) for name, found in content["sets"].items()]
    if content["checks"]:
        rows = [
            [
                name,
                row,
                f"{entry['psnr_noisy']:.2f}",
                f"{entry['psnr']:.2f}",
                f"{entry['lowest_psnr']:.2f}",
                f"{entry['worse']} of {entry['images']}",
                f"{entry['worst_gain_db']:+.2f}",
            ]
            for name, found in content["checks"].items()
            for row, entry in found["rows"].items()
        ]
        parts.append(
            f"### Never worse?\n\n{markdown.table(_CHECKS, rows, 'llr')}\n\n"
            "An untouched image counts as 100 dB: at no noise at all, `out` counts.\n"
        )
    parts.append(
        "Intervals: 95 % bootstrap by frames.  Of several seeds the mean; GMAC at 256x256, CPU "
        "milliseconds of one core at 512x512.\n"
    )
    return "\n".join(parts)


def _set_table(name: str, found: Mapping[str, Any], costs: Mapping[str, Any]) -> str:
    rows = []
    for row, entry in found["rows"].items():
        cost = costs.get(row)
        rows.append(
            [
                row,
                entry["seeds"],
                *(_interval(entry.get(metric), digits) for metric, digits in _DIGITS.items()),
                f"{entry['worse']} of {entry['images']}",
                *([f"{cost['gmac']:.2f}", f"{cost['cpu_ms']:.0f}"] if cost else ["", ""]),
            ]
        )
    best = found["best_classical"]
    margin = f"over `{best}`, the best classical method on these very pairs, with levels"
    return (
        f"### {name}: {found['images']} pairs of {found['frames']} frames\n\n"
        f"{markdown.table(_HEAD, rows)}\n\n"
        f"Margin: {margin if best else 'unknown, no classical method was tuned'}.\n"
    )


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
