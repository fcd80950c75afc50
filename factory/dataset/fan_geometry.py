"""Where range and bearing lie in a sonar image, simulated or real.

Needs numpy alone, so that datasets, networks, reports and readers of recordings all share it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal, Protocol

import numpy as np

from ..common.array_types import Bools, Float32s, Float64s, Floats

Maps = dict[str, Float32s]
"""`range_fraction` (range over range_max), `azimuth_rad` (positive to the right), `sector` (1 where
the sonar measured, else 0); each (H, W) float32."""


_UNKNOWN_SECTOR_DEG = 30.0
_DRAWN = "device."  # begins the columns of what was drawn for an image
FEWEST_BINS = 64
"""Range bins of a drawn device, at least."""
POINTS_HFOV_DEG = 30.0
"""Sector of images of points by a drawn device, at least."""


class SonarImage(Protocol):
    """The image of a device: its layout, and its size where it is a fan."""

    @property
    def layout(self) -> Literal["fan", "polar"]:
        """Fan or polar."""

    @property
    def width_px(self) -> int:
        """Columns of a fan."""

    @property
    def height_px(self) -> int:
        """Rows of a fan."""


class SonarDevice(Protocol):
    """What decides where range and bearing lie in a device's images."""

    @property
    def name(self) -> str:
        """Name of the device."""

    @property
    def frequency_khz(self) -> float:
        """Frequency of the device, kHz."""

    @property
    def hfov_deg(self) -> float:
        """Width of the sector."""

    @property
    def beams(self) -> int:
        """Columns of a polar image."""

    @property
    def range_bins(self) -> int:
        """Rows of a polar image."""

    @property
    def image(self) -> SonarImage:
        """The image."""

    def beam_centres_rad(self) -> Float64s:
        """(beams,) azimuth of each beam, radians, positive to the right."""


@dataclass(frozen=True)
class DeviceImage:
    """The image of a device, as a dataset's configuration describes it."""

    layout: Literal["fan", "polar"]
    width_px: int
    height_px: int


@dataclass(frozen=True)
class RecordedSonar:
    """The device of a dataset, as its configuration describes it; see `SonarSettings`."""

    name: str
    frequency_khz: float
    hfov_deg: float
    beams: int
    range_bins: int
    image: DeviceImage
    beam_azimuths_deg: tuple[float, ...] | None = None

    def beam_centres_rad(self) -> Float64s:
        """(beams,) azimuth of each beam, radians, positive to the right."""
        return beam_centres_rad(self.hfov_deg, self.beams, self.beam_azimuths_deg)


def beam_centres_rad(
    hfov_deg: float, beams: int, beam_azimuths_deg: tuple[float, ...] | None = None
) -> Float64s:
    """(beams,) azimuth of each beam, radians: those given, or evenly spaced over the sector."""
    if beam_azimuths_deg is not None:
        return np.deg2rad(np.asarray(beam_azimuths_deg, dtype=np.float64))
    step = hfov_deg / beams
    return np.asarray(np.deg2rad((np.arange(beams) + 0.5) * step - hfov_deg / 2))


def recorded_sonar(config: Mapping[str, Any]) -> RecordedSonar | None:
    """The device in a dataset's configuration; None where another program wrote it."""
    try:
        keys = config["sonar"]
        image = keys["image"]
        azimuths = keys.get("beam_azimuths_deg")
        sonar = RecordedSonar(
            name=str(keys.get("name", "")),
            frequency_khz=float(keys.get("frequency_khz", math.nan)),
            hfov_deg=float(keys["hfov_deg"]),
            beams=int(keys["beams"]),
            range_bins=int(keys["range_bins"]),
            image=DeviceImage(
                layout=image.get("layout", "fan"),
                width_px=int(image.get("width_px", 256)),
                height_px=int(image.get("height_px", 256)),
            ),
            beam_azimuths_deg=None if azimuths is None else tuple(map(float, azimuths)),
        )
    except (AttributeError, KeyError, TypeError, ValueError):
        return None
    return sonar if _is_possible(sonar) else None


def drawn_sonar(sonar: SonarDevice, record: Mapping[str, Any] | np.void) -> SonarDevice:
    """The device of one image: `sonar`, with what was drawn for the image (`devices`)."""
    names = record.dtype.names or () if isinstance(record, np.void) else record
    drawn = {
        name.removeprefix(_DRAWN): float(record[name]) for name in names if name.startswith(_DRAWN)
    }
    if not drawn:
        return sonar
    image = sonar.image
    height_px = image.height_px
    hfov_deg = drawn.get("hfov_deg", sonar.hfov_deg)
    beams = round(drawn.get("beams", sonar.beams))
    range_bins = sonar.range_bins
    if "bins_per_px" in drawn:
        range_bins = max(round(height_px * drawn["bins_per_px"]), FEWEST_BINS)
    if not drawn.get("field_share", 1.0):
        hfov_deg = max(hfov_deg, POINTS_HFOV_DEG)
        beams = image.width_px
        range_bins = height_px
    is_even = "beams" in drawn or "hfov_deg" in drawn
    return RecordedSonar(
        name=sonar.name,
        frequency_khz=drawn.get("frequency_khz", sonar.frequency_khz),
        hfov_deg=hfov_deg,
        beams=beams,
        range_bins=range_bins,
        image=DeviceImage(image.layout, image.width_px, height_px),
        beam_azimuths_deg=None if is_even else _beam_table_deg(sonar),
    )


def _beam_table_deg(sonar: SonarDevice) -> tuple[float, ...]:
    return tuple(np.rad2deg(sonar.beam_centres_rad()).tolist())


def _is_possible(sonar: RecordedSonar) -> bool:
    """Whether such a device can be: what another program wrote may be anything."""
    azimuths_deg = sonar.beam_azimuths_deg
    has_azimuths = azimuths_deg is None or (
        len(azimuths_deg) == sonar.beams and bool(np.all(np.diff(azimuths_deg) > 0))
    )
    sizes = sonar.beams, sonar.range_bins, sonar.image.width_px, sonar.image.height_px
    return (
        has_azimuths
        and 0 < sonar.hfov_deg <= 180
        and min(sizes) >= 2
        and sonar.image.layout in ("fan", "polar")
    )


@dataclass(frozen=True)
class FanGeometry:
    """Range and bearing of every pixel of one image.

    layout: fan (far range on top, apex at or below the lower edge; or see quarter_turns) or polar
        (one row per range bin, near range first; one column per beam, left to right).
    near_fraction: range_min over range_max.
    sector_rad: width of the device's whole sector, which is symmetric about straight ahead.
    azimuth_min_rad, azimuth_max_rad: the part of it that holds data, radians.
    range_min_m, range_max_m: the range window in metres, None where it is unknown.
    fan: apex_x_px, apex_y_px, the centre of the arcs, in pixels from the centre of the top left
        pixel; far_px, the radius of range_max along y; x_scale, pixels along x for the distance of
        one along y.  quarter_turns, 0 to 3, counter-clockwise (`numpy.rot90`), bring far range to
        the top; the apex is that of the image as it is, far_px and x_scale of the turned one.
    polar: range_bins, the number of rows; beam_azimuths_rad, the bearing of each column in
        ascending order, evenly spaced or not.  Both are empty until `with_size`.
    """

    layout: Literal["fan", "polar"]
    near_fraction: float
    sector_rad: float
    azimuth_min_rad: float
    azimuth_max_rad: float
    range_min_m: float | None = None
    range_max_m: float | None = None
    apex_x_px: float = 0.0
    apex_y_px: float = 0.0
    far_px: float = 1.0
    x_scale: float = 1.0
    quarter_turns: int = 0
    range_bins: int = 0
    beam_azimuths_rad: tuple[float, ...] = ()

    @classmethod
    def from_sonar(
        cls,
        sonar: SonarDevice,
        range_min_m: float,
        range_max_m: float,
        azimuth_min_rad: float = -math.pi,
        azimuth_max_rad: float = math.pi,
    ) -> FanGeometry:
        """The factory's image of a range window by a device.

        azimuth_min_rad, azimuth_max_rad: the part of the sector that the camera saw.
        """
        half = math.radians(sonar.hfov_deg) / 2
        image = sonar.image
        near_fraction = range_min_m / range_max_m
        seen_rad = max(azimuth_min_rad, -half), min(azimuth_max_rad, half)
        common = (image.layout, near_fraction, 2 * half, *seen_rad, range_min_m, range_max_m)
        if image.layout == "polar":
            bearings = tuple(sonar.beam_centres_rad().tolist())
            return cls(*common, range_bins=sonar.range_bins, beam_azimuths_rad=bearings)
        far_px = 1 / pixel_size(sonar, near_fraction)
        return cls(*common, image.width_px / 2 - 0.5, far_px - 0.5, far_px)

    @classmethod
    def from_record(cls, sonar: SonarDevice, record: Mapping[str, Any] | np.void) -> FanGeometry:
        """The image of one row of a dataset's /meta, by the device that was drawn for it.

        Raises KeyError or ValueError for a row without its window.
        """
        sonar = drawn_sonar(sonar, record)
        window = (float(record[name]) for name in ("range_min_m", "range_max_m"))
        seen_rad = (math.radians(float(record[f"azimuth_{end}_deg"])) for end in ("min", "max"))
        return cls.from_sonar(sonar, *window, *seen_rad)

    @classmethod
    def fan(
        cls, sector_rad: float, *, apex_x_px: float, apex_y_px: float, near_px: float,
        far_px: float, **more: Any,
    ) -> FanGeometry:  # fmt: skip
        """A fan image measured in pixels, its whole sector with data.

        near_px, far_px: radii of range_min and range_max along y.
        more: where they are known x_scale, range_min_m, range_max_m.
        """
        more |= {"apex_x_px": apex_x_px, "apex_y_px": apex_y_px, "far_px": far_px}
        return cls("fan", near_px / far_px, sector_rad, -sector_rad / 2, sector_rad / 2, **more)

    @classmethod
    def polar(
        cls,
        sector_rad: float = math.radians(_UNKNOWN_SECTOR_DEG),
        range_min_m: float | None = None,
        range_max_m: float | None = None,
    ) -> FanGeometry:
        """A polar image that divides its window (unknown: from range 0 on) and sector evenly.

        `with_size` says how many rows and columns there are.
        """
        near = range_min_m
        far = range_max_m
        half = sector_rad / 2
        near_fraction = 0.0 if near is None or far is None else near / far
        return cls("polar", near_fraction, sector_rad, -half, half, near, far)

    def with_size(self, rows: int, columns: int) -> FanGeometry:
        """The geometry for an image of this size; another one only where polar sizes were open."""
        if self.layout == "fan" or self.beam_azimuths_rad:
            return self
        step = (np.arange(columns) + 0.5) / columns
        bearings = tuple((step * self.sector_rad - self.sector_rad / 2).tolist())
        return replace(self, range_bins=rows, beam_azimuths_rad=bearings)

    def scaled(self, rows: int, columns: int, scale: float) -> FanGeometry:
        """The geometry of a fan after the image was resized by `scale`, to this size.

        A polar image keeps its sector; its new columns divide it evenly.
        """
        if self.layout == "polar":
            return replace(self, range_bins=0, beam_azimuths_rad=()).with_size(rows, columns)
        return replace(
            self,
            apex_x_px=(self.apex_x_px + 0.5) * scale - 0.5,
            apex_y_px=(self.apex_y_px + 0.5) * scale - 0.5,
            far_px=self.far_px * scale,
        )

    def turned(self, rows: int, columns: int) -> FanGeometry:
        """The geometry after `quarter_turns` of an image of this size: far range on top."""
        x, y = self.apex_x_px, self.apex_y_px
        last_row = rows - 1
        last_column = columns - 1
        apex = ((x, y), (y, last_column - x), (last_column - x, last_row - y), (last_row - y, x))
        apex_x_px, apex_y_px = apex[self.quarter_turns % 4]
        return replace(self, apex_x_px=apex_x_px, apex_y_px=apex_y_px, quarter_turns=0)

    def turned_back(self, quarter_turns: int, rows: int, columns: int) -> FanGeometry:
        """The inverse of `turned`: of an image of this size that lies `quarter_turns` off."""
        size = (rows, columns) if quarter_turns % 2 == 0 else (columns, rows)
        # Three quarters more are one back.
        back = replace(self, quarter_turns=-quarter_turns % 4).turned(*size)
        return replace(back, quarter_turns=quarter_turns % 4)

    @property
    def near_px(self) -> float:
        """Radius of range_min in a fan image, pixels along y."""
        return self.near_fraction * self.far_px

    @property
    def range_span_m(self) -> float | None:
        """Length of the range window in metres, None where it is unknown."""
        if self.range_min_m is None or self.range_max_m is None:
            return None
        return self.range_max_m - self.range_min_m

    @property
    def data_fraction(self) -> tuple[float, float]:
        """First and last bearing with data, as fractions of the sector from its left edge."""
        first, last = (
            limit / self.sector_rad + 0.5 for limit in (self.azimuth_min_rad, self.azimuth_max_rad)
        )
        return max(0.0, first), min(1.0, last)

    def maps(self, top: int, left: int, height: int, width: int) -> Maps:
        """The maps of a window of the image."""
        row = np.arange(top, top + height, dtype=np.float32)[:, None]
        column = np.arange(left, left + width, dtype=np.float32)[None]
        if self.layout == "fan":
            ahead, across = self._ahead_and_across(row, column)
            right = across / np.float32(self.x_scale)
            range_fraction = np.hypot(ahead, right) / np.float32(self.far_px)
            azimuth = np.arctan2(right, ahead)
        else:
            step = (row + np.float32(0.5)) / np.float32(self.range_bins)
            range_fraction = self.near_fraction + (1 - self.near_fraction) * step
            range_fraction = np.broadcast_to(range_fraction, (height, width))
            bearing = np.asarray(self.beam_azimuths_rad[left : left + width], np.float32)
            azimuth = np.broadcast_to(bearing[None], (height, width))
        sector = (range_fraction >= self.near_fraction) & (range_fraction <= 1)
        sector &= (azimuth >= self.azimuth_min_rad) & (azimuth <= self.azimuth_max_rad)
        maps = {"range_fraction": range_fraction, "azimuth_rad": azimuth, "sector": sector}
        return {name: np.ascontiguousarray(values, np.float32) for name, values in maps.items()}

    def _ahead_and_across(self, row: Floats, column: Floats) -> tuple[Floats, Floats]:
        """Distances from the apex, pixels: along straight ahead, and to the right of it."""
        over = row.dtype.type(self.apex_y_px) - row
        right = column - column.dtype.type(self.apex_x_px)
        return ((over, right), (right, -over), (-over, -right), (-right, over))[
            self.quarter_turns % 4
        ]

    def sector_mask(self, height: int, width: int) -> Bools:
        """(H, W) bool: the pixels whose centres lie in the whole sector, with data or not."""
        if self.layout == "polar":
            return np.ones((height, width), dtype=bool)
        row = np.arange(height, dtype=np.float64)[:, None]
        ahead, across = self._ahead_and_across(row, np.arange(width, dtype=np.float64)[None])
        right = across / self.x_scale
        radius = np.hypot(ahead, right)
        inside = (radius >= self.near_px) & (radius <= self.far_px)
        return np.asarray(inside & (np.abs(np.arctan2(right, ahead)) <= self.sector_rad / 2))

    def pixels(self, range_fraction: Floats, azimuth_rad: Floats) -> tuple[Floats, Floats]:
        """(row, column) of points, in pixels; the inverse of `maps`."""
        if self.layout == "fan":
            radius_px = range_fraction * self.far_px
            ahead = radius_px * np.cos(azimuth_rad)
            across = radius_px * np.sin(azimuth_rad) * self.x_scale
            up = ((ahead, across), (-across, ahead), (-ahead, -across), (across, -ahead))
            over, right = up[self.quarter_turns % 4]
            return self.apex_y_px - over, self.apex_x_px + right
        step = (range_fraction - self.near_fraction) / (1 - self.near_fraction)
        bearings = np.asarray(self.beam_azimuths_rad)
        column = np.interp(azimuth_rad, bearings, np.arange(len(bearings)))
        return step * self.range_bins - 0.5, column


def fan_size(hfov_deg: float, near_fraction: float) -> tuple[float, float]:
    """Width and height of a sector as fractions of range_max."""
    half = np.deg2rad(hfov_deg) / 2
    return 2 * np.sin(half), 1 - near_fraction * np.cos(half)


def pixel_size(sonar: SonarDevice, near_fraction: float) -> float:
    """Edge of a (square) fan pixel as a fraction of range_max, the sector just fitting."""
    width, height = fan_size(sonar.hfov_deg, near_fraction)
    return float(max(width / sonar.image.width_px, height / sonar.image.height_px))
