"""Keys of the `devices` group: what the device of each image is drawn from."""

from __future__ import annotations

from dataclasses import fields

from pydantic.dataclasses import dataclass

from ...common.distribution import AnyNumber, Fraction, NonNegative, Positive, PositiveFraction
from ...common.settings import STRICT


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
    """

    field_share: Fraction
    hfov_deg: Positive
    vfov_deg: Positive
    frequency_khz: Positive
    height_px: Positive
    bins_per_px: Positive
    beams: Positive
    resolution_bins: Positive
    beamwidth_beams: Positive
    auto_range_share: Fraction
    range_min_m: NonNegative
    range_max_m: Positive
    tvg_log: NonNegative
    lambert_exponent: NonNegative
    background_db: AnyNumber
    standing_share: Fraction
    standing: Fraction
    log_share: Fraction
    dynamic_range_db: Positive
    log_reference: PositiveFraction
    soft_share: Fraction
    black: Fraction
    exponent: Positive
    power_reference: PositiveFraction
    points_log_share: Fraction
    receiver_db: AnyNumber
    quiet_share: Fraction
    fewer_share: Fraction
    odd_share: Fraction
    nearest_share: Fraction
    enlarged_share: Fraction
    enlarged: Positive
    jpeg_share: Fraction
    jpeg_quality: Positive
    polar_share: Fraction


def distributions(settings: DeviceSettings) -> dict[str, AnyNumber]:
    """Key -> what its value is drawn from, in order."""
    return {item.name: getattr(settings, item.name) for item in fields(settings)}
