"""The table of fans that `data.geometry` and `--geometry` name."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from ...factory.common.errors import FactoryError
from ...factory.common.small_files import read_regular
from ...factory.dataset.fan_geometry import FanGeometry

COLUMNS = (
    "file", "apex_x", "apex_y", "edge_slope", "top_row", "bottom_row", "squeeze", "quarter_turns",
)  # fmt: skip
_MOST_BYTES = 1 << 28
_MDD_SQUEEZE = {"A": 1.0, "B": 0.8}


def read_fans(path: str | Path) -> dict[str, FanGeometry]:
    """File name -> geometry of a fan, from a CSV table.

    Columns: `file`; `apex_x`, `apex_y` (pixels); `edge_slope` (columns a row along the sector's
    edge); `top_row`, `bottom_row` (first and last row with echoes); and, where a pixel is not as
    wide as high, `squeeze` (its height over its width; MDD's own table has the letter of
    one of its two geometries in `config` instead).  Of images without far range on top also
    `quarter_turns`, counter-clockwise, that bring it there; rows are then those of an image turned
    about its apex.  Raises FactoryError.
    """
    try:
        text = read_regular(Path(path).expanduser(), _MOST_BYTES).decode()
        return {row["file"]: _fan(row) for row in csv.DictReader(io.StringIO(text, newline=""))}
    except OSError as error:
        raise FactoryError(f"geometry={path}: cannot be read ({error.strerror})") from error
    except (KeyError, ValueError, TypeError, UnicodeDecodeError) as error:
        raise FactoryError(
            f"geometry={path}: not a table of fans ({' '.join(str(error).split())}); it needs the "
            "columns file, apex_x, apex_y, edge_slope, top_row, bottom_row"
        ) from error


def write_fans(path: str | Path, fans: Mapping[str, FanGeometry]) -> None:
    """The table of fans, as `read_fans` takes it.  Raises OSError."""
    with Path(path).open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(COLUMNS)
        for name, fan in fans.items():
            half = (fan.azimuth_max_rad - fan.azimuth_min_rad) / 2
            # The last row of a fan that begins at the sonar lies a trifle ahead of it.
            ahead = max(fan.near_px, 0.01) * math.cos(half)
            rows = fan.apex_y_px - fan.far_px, fan.apex_y_px - ahead
            slope = math.tan(half) * fan.x_scale
            numbers = (fan.apex_x_px, fan.apex_y_px, slope, *rows, fan.x_scale)
            table.writerow((name, *(round(value, 5) for value in numbers), fan.quarter_turns))


def _fan(row: Mapping[str, str]) -> FanGeometry:
    squeeze = float(row.get("squeeze") or _MDD_SQUEEZE.get(row.get("config", ""), 1.0))
    half = math.atan(float(row["edge_slope"]) / squeeze)
    apex_y = float(row["apex_y"])
    far = apex_y - float(row["top_row"])
    near = apex_y - float(row["bottom_row"])
    if not far > near >= 0:
        raise ValueError(
            f"{row['file']}: apex_y must not lie above bottom_row, and that must lie below top_row"
        )
    turns = int(row.get("quarter_turns") or 0)
    if turns not in range(4):
        raise ValueError(f"{row['file']}: quarter_turns must be 0, 1, 2 or 3")
    upright = FanGeometry.fan(
        2 * half,
        apex_x_px=float(row["apex_x"]),
        apex_y_px=apex_y,
        # The last row that has echoes is where the near arc meets the edges of the sector.
        near_px=near / math.cos(half),
        far_px=far,
        x_scale=squeeze,
    )
    return replace(upright, quarter_turns=turns)
