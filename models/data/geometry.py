"""Where range and bearing are in a picture: what a network may be told beside the grey values."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from simnfnd.factory.errors import FactoryError
from simnfnd.factory.sonar.fan import pixel_size
from simnfnd.factory.sonar.settings import SonarSettings

Maps = dict[str, npt.NDArray[np.float32]]
"""`range_fraction` (range over range_max), `azimuth_rad` (positive to the right), `sector` (1 where
the sonar measured, else 0); each (H, W) float32."""

_MDD_SQUEEZE = {"A": 1.0, "B": 0.8}


@dataclass(frozen=True)
class Geometry:
    """Range and bearing of every pixel of one picture.

    layout: fan (far range on top) or polar (near range first, columns from left to right).
    near_fraction: range_min over range_max.  azimuth_min_rad, azimuth_max_rad: what is insonified.
    fan: apex_x, apex_y, far_px are the sonar's column and row and the distance of range_max from
    it, in pixels along the vertical; squeeze: width of a pixel's step across in such pixels.
    polar: azimuths_rad, the bearing of each column; rows: the number of range bins.
    """

    layout: Literal["fan", "polar"]
    near_fraction: float
    azimuth_min_rad: float
    azimuth_max_rad: float
    apex_x: float = 0.0
    apex_y: float = 0.0
    far_px: float = 1.0
    squeeze: float = 1.0
    azimuths_rad: tuple[float, ...] = ()
    rows: int = 0

    def maps(self, top: int, left: int, height: int, width: int) -> Maps:
        """The maps of a window of the picture."""
        row = np.arange(top, top + height, dtype=np.float32)[:, None]
        column = np.arange(left, left + width, dtype=np.float32)[None]
        if self.layout == "fan":
            ahead = np.float32(self.apex_y) - row
            right = (column - np.float32(self.apex_x)) / np.float32(self.squeeze)
            range_fraction = np.hypot(ahead, right) / np.float32(self.far_px)
            azimuth = np.arctan2(right, ahead)
        else:
            share = (row + np.float32(0.5)) / np.float32(self.rows)
            range_fraction = self.near_fraction + (1 - self.near_fraction) * share
            range_fraction = np.broadcast_to(range_fraction, (height, width))
            bearing = np.asarray(self.azimuths_rad[left : left + width], np.float32)
            azimuth = np.broadcast_to(bearing[None], (height, width))
        sector = (range_fraction >= self.near_fraction) & (range_fraction <= 1)
        sector &= (azimuth >= self.azimuth_min_rad) & (azimuth <= self.azimuth_max_rad)
        found = {"range_fraction": range_fraction, "azimuth_rad": azimuth, "sector": sector}
        return {name: np.ascontiguousarray(values, np.float32) for name, values in found.items()}

    def pixels(
        self, range_fraction: npt.NDArray[np.floating], azimuth_rad: npt.NDArray[np.floating]
    ) -> tuple[npt.NDArray[np.floating], npt.NDArray[np.floating]]:
        """(row, column) of points, in pixels; the inverse of `maps`."""
        if self.layout == "fan":
            length = range_fraction * self.far_px
            row = self.apex_y - length * np.cos(azimuth_rad)
            return row, self.apex_x + length * np.sin(azimuth_rad) * self.squeeze
        share = (range_fraction - self.near_fraction) / (1 - self.near_fraction)
        bearings = np.asarray(self.azimuths_rad)
        return share * self.rows - 0.5, np.interp(azimuth_rad, bearings, np.arange(len(bearings)))


def of_sonar(
    sonar: SonarSettings,
    near_fraction: float,
    azimuth_min_rad: float = -math.pi,
    azimuth_max_rad: float = math.pi,
) -> Geometry:
    """The geometry of the factory's pictures of a device (see `simnfnd.factory.sonar.fan`).

    azimuth_min_rad, azimuth_max_rad: the part of the sector that the camera saw.
    """
    half = math.radians(sonar.hfov_deg) / 2
    limits = max(azimuth_min_rad, -half), min(azimuth_max_rad, half)
    if sonar.image.layout == "polar":
        bearings = tuple(float(value) for value in sonar.beam_centres_rad())
        return Geometry(
            "polar", near_fraction, *limits, azimuths_rad=bearings, rows=sonar.range_bins
        )
    pixel = pixel_size(sonar, near_fraction)
    return Geometry(
        "fan",
        near_fraction,
        *limits,
        apex_x=sonar.image.width_px / 2 - 0.5,
        apex_y=1 / pixel - 0.5,
        far_px=1 / pixel,
    )


def of_record(sonar: SonarSettings, record: Mapping[str, Any]) -> Geometry:
    """The geometry of one sample, from its row of the sample table."""
    return of_sonar(
        sonar,
        float(record["range_min_m"]) / float(record["range_max_m"]),
        math.radians(float(record["azimuth_min_deg"])),
        math.radians(float(record["azimuth_max_deg"])),
    )


def polar_picture(height: int, width: int, sector_deg: float = 30.0) -> Geometry:
    """A polar picture of which nothing else is known: from range 0, columns evenly spread."""
    half = math.radians(sector_deg) / 2
    bearings = (np.arange(width) + 0.5) / width * 2 * half - half
    return Geometry("polar", 0.0, -half, half, azimuths_rad=tuple(bearings.tolist()), rows=height)


def read_fans(path: str | Path) -> dict[str, Geometry]:
    """File name -> geometry of a fan, from a CSV table.

    Columns: `file`; `apex_x`, `apex_y` (pixels); `edge_slope` (columns a row along the sector's
    edge); `top_row`, `bottom_row` (first and last row with echoes); and, where a pixel is not as
    wide as high, `squeeze` (its height over its width; MDD's own table has the letter of
    one of its two geometries in `config` instead).  Raises FactoryError.
    """
    try:
        with Path(path).expanduser().open(newline="", encoding="utf-8") as file:
            return {row["file"]: _fan(row) for row in csv.DictReader(file)}
    except OSError as error:
        raise FactoryError(f"geometry={path}: cannot be read ({error.strerror})") from error
    except (KeyError, ValueError, TypeError, UnicodeDecodeError) as error:
        raise FactoryError(
            f"geometry={path}: not a table of fans ({' '.join(str(error).split())}); it needs the "
            "columns file, apex_x, apex_y, edge_slope, top_row, bottom_row"
        ) from error


def _fan(row: Mapping[str, str]) -> Geometry:
    squeeze = float(row.get("squeeze") or _MDD_SQUEEZE.get(row.get("config", ""), 1.0))
    slope = float(row["edge_slope"])
    half = math.atan(slope / squeeze)
    apex_y = float(row["apex_y"])
    far, near = apex_y - float(row["top_row"]), apex_y - float(row["bottom_row"])
    if not far > near > 0:
        raise ValueError(f"{row['file']}: apex_y must lie below bottom_row, and that below top_row")
    # The last row that has echoes is where the near arc meets the edges of the sector.
    near_fraction = near / math.cos(half) / far
    return Geometry("fan", near_fraction, -half, half, float(row["apex_x"]), apex_y, far, squeeze)


def mirrored(maps: Maps) -> Maps:
    """The maps of the picture mirrored left to right: bearings change their sign."""
    flipped = {name: values[:, ::-1] for name, values in maps.items()}
    flipped["azimuth_rad"] = -flipped["azimuth_rad"]
    return flipped
