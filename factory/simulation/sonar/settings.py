"""Keys of the `sonar` group: the device, its image and where it is mounted."""

from __future__ import annotations

from dataclasses import field
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator
from pydantic.dataclasses import dataclass

from ...common.array_types import Float64s
from ...common.distribution import Altitude
from ...common.distribution import Angle as DrawnAngle
from ...common.limits import limited
from ...common.settings import STRICT
from ...dataset.fan_geometry import beam_centres_rad
from ...dataset.schema import MAX_PIXELS
from ..render.base import Mount
from .array import ArraySettings

FARTHEST_M = 2000.0
NearRange = Annotated[float, limited(0, FARTHEST_M, "m")]
FarRange = Annotated[float, limited(0.05, FARTHEST_M, "m")]
Frequency = Annotated[float, limited(10, 10_000, "kHz")]
# Narrower than any sonar that forms images: numbers of radians are refused.
HorizontalSector = Annotated[float, limited(5, 180, "deg")]
VerticalSector = Annotated[float, limited(1, 180, "deg")]
Blur = Annotated[float, limited(0, 50)]
MOST_SAMPLES = 8192  # of one beam
MOST_FIELD_SAMPLES = 1 << 25  # twice those of the largest imaging sonars
Count = Annotated[int, Field(ge=2, le=MOST_SAMPLES)]


@dataclass(frozen=True, config=STRICT)
class RangeSettings:
    """The range window.

    auto: fit the window to each frame's echoes; then min_m and max_m only limit it.
    min_m, max_m: first and last range in the image, metres.
    windows_m: first and last ranges of several windows, metres; each place is seen through one of
        them, drawn by its name, as an operator sets the device from dive to dive.  Empty: min_m
        and max_m for all.
    """

    auto: bool = True
    min_m: NearRange = 0.2
    max_m: FarRange = 30.0
    windows_m: tuple[tuple[NearRange, FarRange], ...] = ()

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.min_m >= self.max_m:
            raise ValueError(
                f"min_m must be smaller than max_m, got min_m={self.min_m:g} max_m={self.max_m:g}"
            )
        for near_m, far_m in self.windows_m:
            if near_m >= far_m:
                raise ValueError(f"windows_m must be [near, far], got [{near_m:g}, {far_m:g}]")
        if self.windows_m and self.auto:
            raise ValueError("windows_m is for windows that are not fitted: set auto=false")
        return self

    @property
    def fixed(self) -> bool:
        """Whether all images have one window."""
        return not (self.auto or self.windows_m)


@dataclass(frozen=True, config=STRICT)
class PointSpread:
    """Keys of `sonar.point_spread`: the Gaussian that blurs polar images of acoustics=pointwise.

    range_bins: its standard deviation along range, range bins.
    beams: its standard deviation across the beams, beams.
    """

    range_bins: Blur = 0.7
    beams: Blur = 0.7


@dataclass(frozen=True, config=STRICT)
class ImageSettings:
    """Keys of `sonar.image`.

    layout: fan (Cartesian, far range on top) or polar (range_bins x beams, near range first).
    width_px, height_px: of the fan image; a polar image has one pixel a bin.
    sampling: bilinear, or nearest: pixels show the nearest sample as it is, as makers' programs do.
    enlarged: the fan is made so much larger and then shrunk, as images of a screen are.
    jpeg_quality: of the JPEG that noisy images went through before; null for none.
    """

    layout: Literal["fan", "polar"] = "fan"
    width_px: Count = 256
    height_px: Count = 256
    sampling: Literal["bilinear", "nearest"] = "bilinear"
    enlarged: Annotated[float, Field(ge=1, le=4)] = 1.0
    jpeg_quality: Annotated[int, Field(ge=1, le=100)] | None = None

    @property
    def plain(self) -> bool:
        """Whether a fan interpolates between samples, and no more is done to an image."""
        return (self.sampling, self.enlarged, self.jpeg_quality) == ("bilinear", 1, None)


TransferKind = Literal["linear", "power", "log", "soft_log"]


@dataclass(frozen=True, config=STRICT)
class TransferSettings:
    """The curve from echo level to grey value, the same for the clean and the noisy image.

    kind: linear, power (level ** exponent), log (dynamic_range_db below full scale is black) or
        soft_log (the logarithm of one plus the intensity, in units of dynamic_range_db below full
        scale: a logarithm that ends in a straight line at nothing instead of a step).
    percentile: this percentile of the clean image's echoing bins is shown at `reference`.
    reference: grey value in (0, 1] of that percentile.
    exponent: of kind power.
    dynamic_range_db: how far below full scale black lies, dB; of kinds log and soft_log.
    black: grey value of no echo at all, of soft_log.
    full_scale_db: what grey value 1 stands for in every image, as a device of fixed gain has it:
        echo intensity after time-varying gain over the source level, dB; of
        acoustics=coherent.  null takes percentile and reference of each frame.
    """

    kind: TransferKind = "linear"
    percentile: Annotated[float, Field(gt=0, le=100)] = 90.0
    reference: Annotated[float, Field(gt=0, le=1)] = 1.0
    exponent: Annotated[float, limited(0.05, 10)] = 0.5
    dynamic_range_db: Annotated[float, limited(1, 200, "dB")] = 40.0
    black: Annotated[float, Field(ge=0, lt=1)] = 0.0
    full_scale_db: Annotated[float, Field(ge=-300, le=100)] | None = None

    @model_validator(mode="after")
    def _of_one_kind(self) -> Self:
        if self.black and self.kind != "soft_log":
            raise ValueError(f"black={self.black:g} is for kind=soft_log; kind={self.kind} has 0")
        if self.black >= self.reference:
            raise ValueError(
                f"black={self.black:g} must lie below reference={self.reference:g}, the grey value "
                "of an echo"
            )
        return self


@dataclass(frozen=True, config=STRICT)
class SonarSettings:
    """Keys of the `sonar` group.

    frequency_khz: of the device; decides absorption and noise of acoustics=coherent, and is
        only kept with the data otherwise (resample.rate stands for its effect).
    hfov_deg, vfov_deg: insonified sector; echoes outside are dropped.
    beams: number of beams.
    range_bins: number of range bins of a beam.
    samples_per_bin: raw samples whose intensities a range bin averages (multi-look); of
        acoustics=coherent.
    beam_azimuths_deg: directions of the beams from left to right where they are not uniform.
    projection: slant_range (what a sonar measures) or top_view (the paper's view from above).
    accumulate: how echoes in one bin become its level: mean, max or sum.
    altitude_m: height of the sonar above the ground right under it; of `scenes=seabed` and drawn
        paths of `scenes=mesh`; null: as the places and paths have it.  Drawn for each frame; for
        each place in recordings.
    tilt_deg: how far it looks below the horizon; likewise.
    sector: which bearings have data: seen (from the first to the last at which the camera measured
        a surface; the others are black) or whole (all of them; where nothing echoes, the
        receiver's noise shows).
    tvg_db_per_decade: time-varying gain on the echoes, in dB per tenfold range; 20 undoes the
        1/r^2 of the render.
    """

    name: str = "camera_matched"
    frequency_khz: Frequency = 900.0
    hfov_deg: HorizontalSector = 45.0
    vfov_deg: VerticalSector = 30.0
    beams: Count = 256
    range_bins: Count = 256
    samples_per_bin: Annotated[int, Field(ge=1, le=64)] = 1
    beam_azimuths_deg: tuple[float, ...] | None = None
    projection: Literal["slant_range", "top_view"] = "slant_range"
    accumulate: Literal["mean", "max", "sum"] = "sum"
    tvg_db_per_decade: Annotated[float, limited(-200, 200, "dB")] = 40.0
    range: RangeSettings = field(default_factory=RangeSettings)
    point_spread: PointSpread = field(default_factory=PointSpread)
    image: ImageSettings = field(default_factory=ImageSettings)
    transfer: TransferSettings = field(default_factory=TransferSettings)
    array: ArraySettings = field(default_factory=ArraySettings)
    mount: Mount = field(default_factory=Mount)
    altitude_m: Altitude | None = None
    tilt_deg: DrawnAngle | None = None
    sector: Literal["seen", "whole"] = "seen"

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.range_bins * self.samples_per_bin > MOST_SAMPLES:
            raise ValueError(
                f"range_bins {self.range_bins} of samples_per_bin {self.samples_per_bin} are more "
                f"than {MOST_SAMPLES} raw samples; take fewer of one"
            )
        self._check_size()
        table = self.beam_azimuths_deg
        if table is None:
            return self
        if len(table) != self.beams:
            raise ValueError(f"beam_azimuths_deg has {len(table)} entries for {self.beams} beams")
        if np.any(np.diff(table) <= 0):
            raise ValueError("beam_azimuths_deg must increase from left to right")
        if max(abs(table[0]), abs(table[-1])) > self.hfov_deg / 2:
            raise ValueError("beam_azimuths_deg must lie within hfov_deg")
        return self

    def _check_size(self) -> None:
        """Raise ValueError for images that no shard holds, and fields that fill the memory."""
        rows, columns = self.shape()
        if rows * columns > MAX_PIXELS:
            raise ValueError(
                f"an image of {rows} x {columns} pixels is larger than {MAX_PIXELS:,}; take a "
                "smaller image.width_px and image.height_px (polar: range_bins and beams)"
            )
        if self.beams * self.range_bins * self.samples_per_bin > MOST_FIELD_SAMPLES:
            raise ValueError(
                f"{self.beams} beams of {self.range_bins * self.samples_per_bin} raw samples are "
                f"more than {MOST_FIELD_SAMPLES:,} in an image; take fewer beams or range_bins"
            )

    def beam_centres_rad(self) -> Float64s:
        """(beams,) azimuth of each beam, radians, positive to the right."""
        return beam_centres_rad(self.hfov_deg, self.beams, self.beam_azimuths_deg)

    def shape(self) -> tuple[int, int]:
        """(rows, columns) of the image."""
        if self.image.layout == "polar":
            return self.range_bins, self.beams
        return self.image.height_px, self.image.width_px
