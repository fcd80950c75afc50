"""Pictures for papers and slides: the leaderboard, and the paper's Figures 15, 16 and 17 remade."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ...factory.files import write_atomically
from ...factory.scheduler.workers.tasks import TaskPool
from ..methods.method import Method
from ..settings import EvaluationSettings
from .content import shown_rows
from .examples import Example, real_examples
from .names import METRIC_NAMES, written

_ROWS = 40


def write(
    settings: EvaluationSettings,
    content: Mapping[str, Any],
    examples: Sequence[Example],
    methods: Sequence[Method],
    pool: TaskPool,
) -> list[str]:
    """Write leaderboard.png, figure16.png and, with real images, figure15.png and figure17.png.

    Figures 15 and 16 show the methods on real and on simulated pictures; 17 shows the networks
    alone (the ablation) on the real ones.  Returns the names of the files.
    """
    out, made = settings.folder, ["leaderboard.png"]
    _save(out / "leaderboard.png", leaderboard(content))
    if examples:
        made.append("figure16.png")
        _save(out / "figure16.png", sheet(examples))
    if settings.real:
        real = real_examples(settings, methods, pool)
        made.append("figure15.png")
        _save(out / "figure15.png", sheet(real))
        networks = [method.label for method in methods if method.weights]
        if networks:
            made.append("figure17.png")
            _save(out / "figure17.png", sheet(real, ["noisy", *networks]))
    return made


def leaderboard(content: Mapping[str, Any]) -> Any:
    """PSNR with intervals, SSIM, GMSD and time of the best form of each method."""
    from matplotlib.figure import Figure  # a second to import; a Figure needs no display

    rows = {row["label"]: row for row in content["rows"]}
    labels = [*shown_rows(content["rows"], _ROWS)[1:], "noisy"]
    labels.sort(key=lambda label: rows[label]["metrics"]["psnr"]["mean"])
    figure = Figure(
        figsize=(9.6, 1.3 + 0.36 * len(labels)), layout="constrained", facecolor="white"
    )
    axis, side = figure.subplots(1, 2, width_ratios=[2.2, 1])
    colours = {"noisy": "#8a929b", "baseline": "#4c78a8", "network": "#d1600a"}
    colours["pictures"] = colours["network"]
    for height, label in enumerate(labels):
        row = rows[label]
        psnr, colour = row["metrics"]["psnr"], colours[row["kind"]]
        axis.plot([psnr["low"], psnr["high"]], [height, height], color=colour, lw=3, alpha=0.45)
        axis.plot(psnr["mean"], height, "o", color=colour, ms=7)
        cells = [written(psnr["mean"], 2)]
        cells += [
            written(row["metrics"][n]["mean"], METRIC_NAMES[n].digits) for n in ("ssim", "gmsd")
        ]
        cells.append("" if row["kind"] == "noisy" else written(row["milliseconds"], 1))
        for column, text in enumerate(cells):
            side.text(column + 0.8, height, text, ha="right", va="center", fontsize=9)
    axis.set_ylim(-0.6, len(labels) - 0.1)
    axis.set_yticks(range(len(labels)), labels, fontsize=9)
    axis.set_xlabel("PSNR in dB against clean, with 95 % interval over frames")
    axis.grid(axis="x", color="#d5dbe2", lw=0.8)
    axis.spines[["top", "right", "left"]].set_visible(False)
    axis.tick_params(axis="y", length=0)
    for column, text in enumerate(("PSNR", "SSIM", "GMSD", "ms")):
        side.text(column + 0.8, len(labels) - 0.45, text, ha="right", fontsize=9, weight="bold")
    side.set(xlim=(0, 4), ylim=axis.get_ylim())
    side.set_axis_off()
    facts = content["facts"]
    figure.suptitle(
        f"{facts['dataset']}, {facts['split']} split: {facts['pairs']} pairs of "
        f"{facts['frames']} frames, {facts['image']}; best form of each method",
        fontsize=10,
    )
    return figure


def sheet(examples: Sequence[Example], labels: Sequence[str] | None = None) -> Any:
    """A row an example, a column a method, with the PSNR where it is known."""
    from matplotlib.figure import Figure

    every = list(dict.fromkeys(label for one in examples for label in one.images))
    columns = [label for label in every if labels is None or label in labels]
    ratio = max(one.images["noisy"].shape[0] / one.images["noisy"].shape[1] for one in examples)
    size = (1.7 * len(columns), (1.7 * ratio + 0.32) * len(examples) + 0.25)
    figure = Figure(figsize=size, layout="constrained", facecolor="white")
    axes = figure.subplots(len(examples), len(columns), squeeze=False)
    for line, one in zip(axes, examples, strict=True):
        for axis, label in zip(line, columns, strict=True):
            axis.set_axis_off()
            if label not in one.images:
                continue
            axis.imshow(one.images[label], cmap="gray", vmin=0, vmax=1)
            known = one.psnr.get(label)
            title = label.replace(" + levels", "\n+ levels")
            axis.set_title(title + (f"\n{known:.2f} dB" if known else ""), fontsize=7)
    return figure


def _save(path: Path, figure: Any) -> None:
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=150)
    write_atomically(path, content.getvalue(), key="out")
