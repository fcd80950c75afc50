"""The sample table: how a pair was made."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np

from ...common import seeds
from ...dataset.fan_geometry import pixel_size
from ...dataset.frame_ref import FrameRef
from ...dataset.schema import Column
from ..imaging.contract import SceneSample
from ..imaging.settings import Formation
from ..noise import draws as drawn
from ..noise.draws import Draws
from ..noise.registry import EFFECTS, NoiseSettings
from ..sonar.settings import SonarSettings
from ..sonar.window import Window

Row = dict[str, float | str]

_SAMPLE = (
    Column("location", "S96", "", "area of the recording"),
    Column("scene", "S96", "", "recording; train and test are split by it"),
    Column("frame", "S96", "", "frame within the scene"),
    Column("variant", "i4", "1", "number of the noise draw of this frame"),
    Column("seed_key", "S32", "", "blake2b spawn key of the sample's random streams, hexadecimal"),
    Column("range_min_m", "f8", "m", "range at the near edge of the picture"),
    Column("range_max_m", "f8", "m", "range at the far edge of the picture"),
    Column("azimuth_min_deg", "f8", "deg", "left edge of the sector that the camera saw"),
    Column("azimuth_max_deg", "f8", "deg", "right edge of the sector that the camera saw"),
    Column("metres_per_pixel", "f8", "m", "edge of a fan pixel, or length of a range bin"),
    Column("resample.rate", "f8", "1", "fraction of the scene points kept"),
    Column("points.scene", "i8", "1", "scene points in the pictures"),
    Column("full_scale", "f8", "1", "echo level shown as grey value 1"),
)
_TARGET = (
    Column(
        "clean_full_scale",
        "f8",
        "1",
        "level shown as grey value 1 in the clean picture, in the unit of its target: echo "
        "intensity; radiometric: backscatter",
    ),
)


# Start of a key's entry in the docstring of noise settings: `key: ` or `key, key: `.
_DOCUMENTED_KEYS = re.compile(r"(?<=\.) ((?:[a-z_]+, )*[a-z_]+): ")


def columns(noise: NoiseSettings, formation: Formation = "pointwise") -> tuple[Column, ...]:
    """Return the columns of the sample table.

    A parameter that was not drawn, because its effect is off, is NaN or empty in the rows.

    formation: acoustics.formation; pointwise images have one scale for clean and noisy.
    """
    target = _TARGET if formation == "coherent" else ()
    return _SAMPLE + target + tuple(map(_described, drawn.columns(noise)))


def _described(column: Column) -> Column:
    """Return the column of a noise parameter with the description of its settings key.

    Other columns, and those that have a description, are returned as they are.
    """
    kind, _, effect_and_parameter = column.name.partition(".")
    if kind != "noise" or column.description:
        return column

    effect, _, parameter = effect_and_parameter.partition(".")
    docstring = " ".join((EFFECTS[effect].settings.__doc__ or "").split())
    _, *entries = _DOCUMENTED_KEYS.split(docstring)
    for keys, meaning in zip(entries[::2], entries[1::2], strict=True):
        if parameter in keys.split(", "):
            return replace(column, description=meaning.rstrip("."))
    return column


def record(
    ref: FrameRef,
    variant: int,
    window: Window,
    sonar: SonarSettings,
    sample: SceneSample,
    draws: Draws,
    formation: Formation = "pointwise",
) -> Row:
    """Return the row of one sample, without the columns of `dataset.columns`."""
    key_words = seeds.spawn_key(ref.location, ref.scene, ref.frame, variant)
    seed_key = "".join(f"{word:08x}" for word in key_words)
    pixel_m = window.range_span_m / sonar.range_bins
    if sonar.image.layout != "polar":
        pixel_m = window.range_max_m * pixel_size(sonar, window.near_fraction)
    row: Row = {
        "location": ref.location,
        "scene": ref.scene,
        "frame": ref.frame,
        "variant": variant,
        "seed_key": seed_key,
        "range_min_m": window.range_min_m,
        "range_max_m": window.range_max_m,
        "azimuth_min_deg": float(np.rad2deg(window.azimuth_min_rad)),
        "azimuth_max_deg": float(np.rad2deg(window.azimuth_max_rad)),
        "metres_per_pixel": pixel_m,
        "resample.rate": sample.rate,
        "points.scene": sample.points,
        "full_scale": sample.full_scale,
    }
    if formation == "coherent":
        row["clean_full_scale"] = sample.full_scale
    return row | draws.row(sample.added)
