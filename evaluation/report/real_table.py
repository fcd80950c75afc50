"""Rows of several reports on real images beside each other: `simnfnd evaluate compare A B C...`."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ...factory.common.errors import FactoryError
from .tables import as_markdown, as_table, written

REAL_NAME = "real.json"
_BEST_FILTER = "best filter"
_NOISY = "noisy"


def is_real_report(folder: Path) -> bool:
    """Whether a folder holds a report of `simnfnd evaluate real`."""
    return (folder / REAL_NAME).is_file()


def tabulate(folders: Sequence[Path]) -> str:
    """PSNR and SSIM of noisy images, the best filter and each network, a column a report.

    A network counts by the last part of its label, so folders of one name are one row.
    Raises FactoryError for a folder without a report that can be read.
    """
    columns = [_read_column(folder) for folder in folders]
    names = [json.loads((folder / REAL_NAME).read_text("utf-8"))["name"] for folder in folders]
    labels = dict.fromkeys((_NOISY, _BEST_FILTER))
    for column in columns:
        labels |= dict.fromkeys(column)
    lines = [[label, *(column.get(label, "-") for column in columns)] for label in labels]
    table = as_markdown(as_table(["PSNR, dB / SSIM", *names], lines), "lr")
    return f"{table}\n\nThe best filter is the one of the highest PSNR in each report."


def _read_column(folder: Path) -> dict[str, str]:
    """Label -> its figures in a report."""
    path = folder / REAL_NAME
    try:
        report = json.loads(path.read_text(encoding="utf-8"))
        rows = {row["label"]: row for row in report["rows"] if row["lost"] is None}
        column = {_NOISY: _figures(rows[_NOISY])}
        best = (report["best_filter"] or {}).get("psnr_db")
        if best is not None and best in rows:
            column[_BEST_FILTER] = f"{_figures(rows[best])} ({best.split()[0]})"
        for label, row in rows.items():
            if row["network"]:
                column[Path(label).name] = _figures(row)
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise FactoryError(
            f"{path}: damaged or of another version; make it again by `simnfnd evaluate real`"
        ) from error
    return column


def _figures(row: Mapping[str, Any]) -> str:
    means = row["means"]
    return f"{written(means.get('psnr_db'), 2)} / {written(means.get('ssim'), 3)}"
