"""Keys of the `devices` group: what the device of each image is drawn from."""

from __future__ import annotations

from dataclasses import field, fields
from typing import Annotated, Literal

from pydantic.dataclasses import dataclass

from ...common.distribution import (
    Decibels,
    Distribution,
    Fraction,
    PositiveFraction,
    as_written,
    within,
)
from ...common.settings import STRICT

_HorizontalSector = Annotated[Distribution, within(5, 180, "deg"), as_written]
_VerticalSector = Annotated[Distribution, within(1, 180, "deg"), as_written]
_Frequency = Annotated[Distribution, within(10, 10000, "kHz"), as_written]
_Size = Annotated[Distribution, within(2, 8192), as_written]
_Ratio = Annotated[Distribution, within(0.01, 100), as_written]
_NearRange = Annotated[Distribution, within(0, 2000, "m"), as_written]
_FarRange = Annotated[Distribution, within(0.05, 2000, "m"), as_written]
_SpreadingGain = Annotated[Distribution, within(0, 80, "dB"), as_written]
_LambertExponent = Annotated[Distribution, within(0, 8), as_written]
_DynamicRange = Annotated[Distribution, within(1, 200, "dB"), as_written]
_Exponent = Annotated[Distribution, within(0.05, 10), as_written]
_Enlargement = Annotated[Distribution, within(1e-06, 16), as_written]
_Quality = Annotated[Distribution, within(1e-06, 100), as_written]


@dataclass(frozen=True, config=STRICT)
class DeviceSettings:
    """What the device, its display and its image are drawn from, anew for every image.

    field_share: part of the images that acoustics=coherent makes; the others are points.
    hfov_deg, vfov_deg: sector and vertical beam, degrees.  frequency_khz: decides absorption.
    height_px: of a fan image, pixels; its width follows from the sector.  Datasets keep
        `sonar.image`, because their images are all of one size.
    bins_per_px: range bins for one pixel of the fan's height.  beams: number.
    resolution_bins: range resolution c / 2B over the length of a bin.
    beamwidth_beams: -3 dB width of a beam over the distance of two.
    auto_range_share: part of the images whose window is fitted to the scene; range_min_m,
        range_max_m: the window of the others, metres.
    tvg_log, lambert_exponent, background_db: see `acoustics`.
    standing_share: part of the images of the field in which part of the speckle is static, and
        `noise.scintillation` acts; standing: which part of its power (`acoustics.standing`).
    log_share: part of the images of the field with a logarithmic display: dynamic_range_db, and
        the grey value of the median echo, log_reference.  The others show level ** exponent, the
        echoes' 95th percentile at power_reference.
    soft_share: part of the logarithmic displays that end in a straight line instead of a step
        (`sonar.transfer.kind=soft_log`), with the grey value `black` where nothing echoes.
    points_log_share: the same of images of points; those that are left are linear.
    receiver_db: level of the receiver's noise over the median echo, dB; where noise.receiver is on,
        instead of its level_db.
    quiet_share: part of the images without any noise; fewer_share: part of them in which each
        effect is switched off by a coin.
    odd_share: part of the images of the field that have the effects of spokes, ghosts and wrong
        gains, each by a coin; the others have grain and haze alone.
    nearest_share: part of the fans whose pixels show the nearest sample as it is, as makers'
        images do; the others interpolate.
    enlarged_share: part of the images that are made larger and shrunk to their size, by
        `enlarged`.  jpeg_share: part that went through JPEG of jpeg_quality.
    polar_share: part that is polar, not a fan; none in datasets.
    reflectivity_db: of object classes, by name; see `acoustics.reflectivity_db`.
    objects_db: added to the reflectivity of all classes but Background.
    per: image (drawn anew for each image) or place (one device for all images of a place).

    A key that is null is not drawn: the image has what the configuration says.
    """

    field_share: Fraction | None = None
    hfov_deg: _HorizontalSector | None = None
    vfov_deg: _VerticalSector | None = None
    frequency_khz: _Frequency | None = None
    height_px: _Size | None = None
    bins_per_px: _Ratio | None = None
    beams: _Size | None = None
    resolution_bins: _Ratio | None = None
    beamwidth_beams: _Ratio | None = None
    auto_range_share: Fraction | None = None
    range_min_m: _NearRange | None = None
    range_max_m: _FarRange | None = None
    tvg_log: _SpreadingGain | None = None
    lambert_exponent: _LambertExponent | None = None
    background_db: Decibels | None = None
    standing_share: Fraction | None = None
    standing: Fraction | None = None
    log_share: Fraction | None = None
    dynamic_range_db: _DynamicRange | None = None
    log_reference: PositiveFraction | None = None
    soft_share: Fraction | None = None
    black: Fraction | None = None
    exponent: _Exponent | None = None
    power_reference: PositiveFraction | None = None
    points_log_share: Fraction | None = None
    receiver_db: Decibels | None = None
    quiet_share: Fraction | None = None
    fewer_share: Fraction | None = None
    odd_share: Fraction | None = None
    nearest_share: Fraction | None = None
    enlarged_share: Fraction | None = None
    enlarged: _Enlargement | None = None
    jpeg_share: Fraction | None = None
    jpeg_quality: _Quality | None = None
    polar_share: Fraction | None = None
    reflectivity_db: dict[str, Decibels] = field(default_factory=dict)
    objects_db: Decibels | None = None
    per: Literal["image", "place"] = "image"


def distributions(settings: DeviceSettings) -> dict[str, Distribution]:
    """Key -> what its value is drawn from, in order; only keys that are drawn.

    Of a class the key is reflectivity_db.CLASS.
    """
    drawn = {}
    for item in fields(settings):
        value = getattr(settings, item.name)
        if isinstance(value, Distribution):
            drawn[item.name] = value
    of_classes = settings.reflectivity_db.items()
    return drawn | {f"reflectivity_db.{name}": value for name, value in of_classes}
