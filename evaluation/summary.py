"""The measurements of a dataset as a table, as files and as a picture."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from evaluation import metrics
from evaluation.measure import METRICS, EvaluationSettings, Score, as_rows
from evaluation.statistics import Estimate
from factory.errors import FactoryError
from factory.shards.reader import open_shard

PAPER_ORIGIN = {"psnr": 17.64, "ssim": 0.68, "gmsd": 0.22}
"""Table 2 of the paper, row Origin: mean over 1000 simulated pairs, full frame."""

_LABELS = {
    "psnr": ("PSNR, dB", 2),
    "ssim": ("SSIM", 3),
    "gmsd": ("GMSD", 3),
    "psnr_fan": ("PSNR fan only, dB", 2),
    "ssim_fan": ("SSIM fan only", 3),
    "gmsd_fan": ("GMSD fan only", 3),
    "shadow_iou": ("shadow IoU", 3),
    "shadow_residual": ("shadow residual", 4),
    "false_light_rate": ("false-light rate", 3),
}


def table(summary: dict[str, Estimate]) -> str:
    """Markdown table of the means with their intervals, beside the paper's."""
    lines = [
        "| noisy against clean | mean | 95 % interval | median | paper |",
        "|---|---:|:---:|---:|---:|",
    ]
    for name in METRICS:
        label, digits = _LABELS[name]
        item = summary[name]
        if not item.count:
            lines.append(f"| {label} | - | - | - | |")
            continue
        paper = f"{PAPER_ORIGIN[name]:.2f}" if name in PAPER_ORIGIN else ""
        mean, low, high, median = (
            f"{value:.{digits}f}" for value in (item.mean, item.low, item.high, item.median)
        )
        lines.append(f"| {label} | {mean} | {low} .. {high} | {median} | {paper} |")
    return "\n".join(lines)


def write(
    out: Path, scores: list[Score], summary: dict[str, Estimate], settings: EvaluationSettings
) -> None:
    """Write metrics.csv, summary.json, summary.md and summary.png into the folder `out`."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        rows = as_rows(scores)
        with (out / "metrics.csv").open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, fieldnames=list(rows[0]))
            writer.writeheader()
            writer.writerows(rows)
        facts = _facts(scores, settings)
        content = {**facts, "paper": PAPER_ORIGIN, "metrics": _plain(summary)}
        text = json.dumps(content, indent=2, allow_nan=False)
        (out / "summary.json").write_text(text + "\n", encoding="utf-8")
        (out / "summary.md").write_text(_markdown(summary, facts), encoding="utf-8")
        picture(out / "summary.png", scores, settings)
    except OSError as error:
        raise FactoryError(
            f"out={out}: cannot write there ({error.strerror or error}); choose another out="
        ) from error


def picture(path: Path, scores: list[Score], settings: EvaluationSettings) -> None:
    """Histograms of the three metrics above the best, the median and the worst pair by PSNR."""
    # pyplot takes a second to import and is needed here alone; Figure needs no display.
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 13.4), layout="constrained", facecolor="white")
    grid = figure.add_gridspec(4, 3, height_ratios=[0.62, 1, 1, 1])
    for column, name in enumerate(PAPER_ORIGIN):
        values = [metrics.finite_psnr(getattr(s.quality, name)) for s in scores]
        axis = figure.add_subplot(grid[0, column])
        axis.hist(values, bins=min(40, max(5, len(values) // 4)), color="#4c78a8")
        axis.axvline(float(np.mean(values)), color="black", label=f"mean {np.mean(values):.3g}")
        paper = PAPER_ORIGIN[name]
        axis.axvline(paper, color="#e45756", ls="--", label=f"paper {paper:g}")
        axis.set(xlabel=_LABELS[name][0], ylabel="pairs" if column == 0 else "")
        axis.locator_params(axis="x", nbins=6)
        axis.legend(frameon=False, fontsize=9)
        axis.spines[["top", "right"]].set_visible(False)
    ranked = sorted(scores, key=lambda score: score.quality.psnr)
    chosen = {"best": ranked[-1], "median": ranked[len(ranked) // 2], "worst": ranked[0]}
    for row, (rank, score) in enumerate(chosen.items(), start=1):
        with open_shard(Path(settings.dataset.dir) / score.shard) as file:
            noisy, clean = file["noisy"][score.index], file["clean"][score.index]
        full = 255.0 if noisy.dtype == np.uint8 else 1.0
        panels = {
            f"{rank}: noisy, {score.quality.psnr:.2f} dB": noisy / full,
            f"clean - {score.scene} {score.frame}": clean / full,
            "noisy minus clean": noisy / full - clean / full,
        }
        for column, (title, image) in enumerate(panels.items()):
            axis = figure.add_subplot(grid[row, column])
            if column == 2:
                shown = axis.imshow(image, cmap="RdBu_r", vmin=-1, vmax=1)
                figure.colorbar(shown, ax=axis, fraction=0.046, pad=0.02)
            else:
                axis.imshow(image, cmap="gray", vmin=0, vmax=1)
            axis.set_title(title, fontsize=10)
            axis.set_axis_off()
    figure.savefig(path, dpi=100)


def _facts(scores: list[Score], settings: EvaluationSettings) -> dict[str, Any]:
    with open_shard(Path(settings.dataset.dir) / scores[0].shard) as file:
        config_hash = file.attrs.get("config_hash", "")
        height, width = file["noisy"].shape[1:]
        kind = str(file["noisy"].dtype)
    return {
        "dataset": Path(settings.dataset.dir).resolve().name,
        "config_hash": config_hash.decode() if isinstance(config_hash, bytes) else str(config_hash),
        "split": settings.split,
        "pairs": len(scores),
        "frames": len({score.group for score in scores}),
        "scenes": sorted({score.scene for score in scores}),
        "image": f"{height}x{width} {kind}",
        "identical_pairs": sum(math.isinf(score.quality.psnr) for score in scores),
        "shadow_threshold": settings.shadow_threshold,
    }


def _plain(summary: dict[str, Estimate]) -> dict[str, Any]:
    """JSON has no NaN: a metric without any value becomes null."""
    return {
        name: None
        if not item.count
        else {
            "mean": item.mean,
            "low": item.low,
            "high": item.high,
            "median": item.median,
            "count": item.count,
        }
        for name, item in summary.items()
    }


def _markdown(summary: dict[str, Estimate], facts: dict[str, Any]) -> str:
    return (
        f"# Noisy against clean: {facts['dataset']}, {facts['split']} split\n\n"
        f"{facts['pairs']} pairs of {facts['frames']} frames ({facts['image']}; config "
        f"{facts['config_hash'] or 'unknown'}).\n\n{table(summary)}\n\n"
        "Intervals: 95 % bootstrap over frames.  PSNR: mean of the dB values of the images; "
        f"identical pairs ({facts['identical_pairs']} here) count as {metrics.PSNR_CAP_DB:g} dB.  "
        "SSIM: Gaussian window, sigma 1.5.  GMSD: 2x2 mean first, c = 170 on 0..255.  "
        f"A pixel is shadow at or below {facts['shadow_threshold']:g} of full scale.  "
        "Paper: Table 2, row Origin, full frame.\n"
    )
