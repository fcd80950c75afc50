"""The record of a sample: the table row that says how it was made; and the axes of the pictures."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from .. import seeds
from ..dataset.schema import Axis, Column
from ..frame import FrameRef
from ..imaging.contract import Sample
from ..noise import draws as drawn
from ..noise.draws import Draws
from ..noise.registry import EFFECTS, NoiseSettings
from ..sonar.fan import pixel_size
from ..sonar.settings import SonarSettings
from ..sonar.window import Window

if TYPE_CHECKING:
    pass

_NAME = "S96"

_WHAT = (
    Column("location", _NAME, "", "area of the recording"),
    Column("scene", _NAME, "", "recording; train and test are split by it"),
    Column("frame", _NAME, "", "frame within the scene"),
    Column("variant", "i4", "1", "number of the noise draw of this frame"),
    Column("seed_key", "S32", "", "blake2b spawn key of the sample's random streams, hexadecimal"),
)
_WINDOW = (
    Column("range_min_m", "f8", "m", "range at the near edge of the picture"),
    Column("range_max_m", "f8", "m", "range at the far edge of the picture"),
    Column("azimuth_min_deg", "f8", "deg", "left edge of the sector that the camera saw"),
    Column("azimuth_max_deg", "f8", "deg", "right edge of the sector that the camera saw"),
    Column("metres_per_pixel", "f8", "m", "edge of a fan pixel, or length of a range bin"),
)
_SCENE = (
    Column("resample.rate", "f8", "1", "fraction of the scene points kept"),
    Column("points.scene", "i8", "1", "scene points in the pictures"),
    Column("full_scale", "f8", "1", "echo level shown as grey value 1"),
)
_TARGET = Column(
    "clean_full_scale",
    "f8",
    "1",
    "level shown as grey value 1 in the clean picture, in the unit of its target: echo intensity; "
    "radiometric: backscatter",
)


def columns(noise: NoiseSettings, formation: str = "points") -> tuple[Column, ...]:
    """Columns of the sample table: a parameter that was not drawn (effect off) is NaN or empty.

    formation: acoustics.formation; pictures of points have one scale for clean and noisy.
    """
    target = (_TARGET,) if formation == "field" else ()
    return _WHAT + _WINDOW + _SCENE + target + tuple(map(_described, drawn.columns(noise)))


def _described(column: Column) -> Column:
    """A parameter of noise says what the docstring of its settings says of the key."""
    kind, _, rest = column.name.partition(".")
    if kind != "noise" or column.description:
        return column
    effect, _, parameter = rest.partition(".")
    text = " ".join((EFFECTS[effect].settings.__doc__ or "").split())
    _, *told = re.split(r"(?<=\.) ((?:[a-z_]+, )*[a-z_]+): ", text)
    for names, meaning in zip(told[::2], told[1::2], strict=True):
        if parameter in names.split(", "):
            return replace(column, description=meaning.rstrip("."))
    return column


def record(
    ref: FrameRef,
    variant: int,
    window: Window,
    sonar: SonarSettings,
    sample: Sample,
    draws: Draws,
    formation: str = "points",
) -> dict[str, float | int | str]:
    """The row of one sample."""
    key = seeds.spawn_key(ref.location, ref.scene, ref.frame, variant)
    return {
        "location": ref.location,
        "scene": ref.scene,
        "frame": ref.frame,
        "variant": variant,
        "seed_key": "".join(f"{word:08x}" for word in key),
        "range_min_m": window.range_min_m,
        "range_max_m": window.range_max_m,
        "azimuth_min_deg": float(np.rad2deg(window.azimuth_min_rad)),
        "azimuth_max_deg": float(np.rad2deg(window.azimuth_max_rad)),
        "metres_per_pixel": metres_per_pixel(window, sonar),
        "resample.rate": sample.rate,
        "points.scene": sample.points,
        "full_scale": sample.full_scale,
        **({"clean_full_scale": sample.clean_full_scale} if formation == "field" else {}),
        **draws.row(sample.added),
    }


def metres_per_pixel(window: Window, sonar: SonarSettings) -> float:
    """Edge of a fan pixel, or length of a range bin of a polar picture, metres."""
    if sonar.image.layout == "polar":
        return window.range_span_m / sonar.range_bins
    return window.range_max_m * pixel_size(sonar, window.near_fraction)


def image_axes(sonar: SonarSettings) -> tuple[Axis, Axis]:
    """Row and column axes.

    With one fixed range window they are metres (and degrees of azimuth for polar pictures).  With
    an automatic one, or several, every sample has its own scale, so the axes count from 0 to 1 or
    in pixels and `range_min_m`, `range_max_m`, `metres_per_pixel` of the sample table turn them
    into metres.
    """
    rows, columns_ = (np.arange(size) + 0.5 for size in sonar.shape())
    near, far = sonar.range.min_m, sonar.range.max_m
    if sonar.image.layout == "polar":
        azimuth = Axis(
            "azimuth", "deg", np.rad2deg(sonar.beam_centres_rad()), "0 is straight ahead"
        )
        if not sonar.range.fixed:
            fraction = rows / sonar.range_bins
            return Axis("range", "1", fraction, "0 at range_min_m, 1 at range_max_m"), azimuth
        return Axis("range", "m", near + rows / sonar.range_bins * (far - near)), azimuth
    right = columns_ - sonar.image.width_px / 2
    if not sonar.range.fixed:
        return (
            Axis("ahead", "px", rows, "distance below range_max_m straight ahead"),
            Axis("right", "px", right, "distance to the right of the sonar's axis"),
        )
    pixel_m = far * pixel_size(sonar, near / far)
    return Axis("ahead", "m", far - rows * pixel_m), Axis("right", "m", right * pixel_m)
