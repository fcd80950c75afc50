"""The leaderboard as Markdown and CSV."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from pathlib import Path

from evaluation.leaderboard import Row, columns
from evaluation.pictures import Item
from evaluation.statistics import Estimate
from evaluation.tuning import shown
from factory.errors import FactoryError

PAPER = {
    "median": (17.76, 0.69, 0.19),
    "gaussian": (17.76, 0.69, 0.20),
    "bilateral": (17.90, 0.69, 0.19),
    "nlm": (17.73, 0.69, 0.21),
    "bm3d": (16.65, 0.69, 0.19),
    "identity": (17.64, 0.68, 0.22),
}
"""Table 2 of the paper: PSNR, SSIM and GMSD of its rows, full frame, 1000 simulated pairs."""

_TEXTURE_LABELS = {
    "ms_ssim": "MS-SSIM",
    "edge_preservation": "edges",
    "enl": "ENL",
    "cnr": "CNR",
    "ratio_mean": "ratio mean",
    "m_index": "M-index",
}


def table(rows: Sequence[Row]) -> str:
    """Markdown table: the paper's three metrics, the paired gain, the time; best PSNR first."""
    lines = [
        "| method | PSNR, dB | 95 % interval | against noisy, dB | SSIM | GMSD | shadow IoU "
        "| ms | paper |",
        "|---|---:|:---:|:---:|---:|---:|---:|---:|---|",
    ]
    for row in _ranked(rows):
        name = f"{_label(row)}{shown(row.method.parameters)}"
        if row.lost is not None:
            lines.append(f"| {name} | lost: {row.lost.replace('|', '/')} | | | | | | | |")
            continue
        psnr = row.means["psnr"]
        gain = _with_interval(row.gains["psnr"]) if row.gains else ""
        ssim, gmsd, iou = (_plain(row.means[key].mean, 3) for key in ("ssim", "gmsd", "shadow_iou"))
        paper = PAPER.get(row.method.baseline) if not row.method.form else None
        beside = "{:.2f} / {:.2f} / {:.2f}".format(*paper) if paper else ""
        lines.append(
            f"| {name} | {psnr.mean:.2f} | {psnr.low:.2f} .. {psnr.high:.2f} | {gain} | {ssim} "
            f"| {gmsd} | {iou} | {_plain(row.milliseconds, 1)} | {beside} |"
        )
    return "\n".join(lines)


def texture_table(rows: Sequence[Row]) -> str:
    """Markdown table of the metrics of `evaluation.texture`; empty when they were not asked for."""
    names = [name for name in columns(rows) if name in _TEXTURE_LABELS]
    if not names:
        return ""
    lines = [
        "| method | " + " | ".join(_TEXTURE_LABELS[name] for name in names) + " |",
        "|---|" + "---:|" * len(names),
    ]
    lines += [
        f"| {_label(row)} | " + " | ".join(_plain(row.means[name].mean, 3) for name in names) + " |"
        for row in _ranked(rows)
        if row.lost is None
    ]
    return "\n".join(lines)


def write(out: Path, items: Sequence[Item], rows: Sequence[Row]) -> None:
    """Write baselines.csv (a line a pair) and leaderboard.csv, and add both tables to summary.md.

    Raises FactoryError when the folder cannot be written to.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
        _write_pairs(out / "baselines.csv", items, rows)
        _write_rows(out / "leaderboard.csv", rows)
        parts = [
            "## Baselines",
            table(rows),
            texture_table(rows),
            "Gain and offset of `+ levels` and the parameters of `tuned` come from validation "
            "pairs (`python -m evaluation tune`).  Against noisy: mean paired difference with its "
            "95 % bootstrap interval over frames.  Paper: PSNR / SSIM / GMSD of its Table 2.",
        ]
        with (out / "summary.md").open("a", encoding="utf-8") as file:
            file.write("\n" + "\n\n".join(part for part in parts if part) + "\n")
    except OSError as error:
        raise FactoryError(
            f"out={out}: cannot write there ({error.strerror or error}); choose another out="
        ) from error


def _write_pairs(path: Path, items: Sequence[Item], rows: Sequence[Row]) -> None:
    names = columns(rows)
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        place = ("shard", "index", "location", "scene", "frame", "variant")
        writer.writerow(("method", *place, *names))
        for row in rows:
            if row.lost is not None:
                continue
            for number, item in enumerate(items):
                where = (item.shard, item.place[1], item.location, item.scene, item.frame)
                figures = (float(row.values[name][number]) for name in names)
                writer.writerow((_label(row), *where, item.variant, *figures))


def _write_rows(path: Path, rows: Sequence[Row]) -> None:
    names = columns(rows)
    suffixes = ("", "_low", "_high", "_gain", "_gain_low", "_gain_high")
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        figures = [f"{name}{suffix}" for name in names for suffix in suffixes]
        writer.writerow(
            ("method", "parameters", "gain", "offset", "milliseconds", "lost", *figures)
        )
        for row in _ranked(rows):
            levels = row.method.levels
            cells: list[float | str] = []
            for name in names if row.lost is None else ():
                for item in (row.means.get(name), row.gains.get(name)):
                    cells += ["", "", ""] if item is None else [item.mean, item.low, item.high]
            writer.writerow(
                (
                    _label(row),
                    shown(row.method.parameters).strip(" ()"),
                    "" if levels is None else levels.gain,
                    "" if levels is None else levels.offset,
                    "" if row.lost else row.milliseconds,
                    row.lost or "",
                    *cells,
                )
            )


def _label(row: Row) -> str:
    plain = row.method.baseline == "identity" and not row.method.form
    return "noisy" if plain else row.method.label.replace("identity", "noisy")


def _ranked(rows: Sequence[Row]) -> list[Row]:
    """Best PSNR first, lost rows last."""
    return sorted(rows, key=lambda row: math.inf if row.lost else -row.means["psnr"].mean)


def _with_interval(item: Estimate) -> str:
    return f"{item.mean:+.2f} ({item.low:+.2f} .. {item.high:+.2f})"


def _plain(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if math.isfinite(value) else "-"
