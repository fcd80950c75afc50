"""What numbers of a dataset mean: classes of labels; in words grey values, rows and columns.

The text goes into shards, cards and exports, so that the files are enough to use them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Literal, get_args

Formation = Literal["pointwise", "coherent", ""]

_UNKNOWN_GREY = "echo strength after the transfer curve in `config`, the same for noisy and clean"


def formation_of(config: Mapping[str, Any]) -> Formation:
    """`schema.Pair.formation` of a dataset with this configuration, as its shards state it."""
    if config.get("devices") is not None or "noise" not in config:
        return ""
    # What never reaches the paper's images is not stated.
    return "coherent" if "acoustics" in config else "pointwise"


def grey_meaning(config: Mapping[str, Any], dtype: str, *, scale_place: str = "/meta") -> str:
    """How grey values of noisy and clean turn back into echo levels; one paragraph.

    config: as shards state it.  dtype: of the images, uint8 or float32.
    scale_place: where the full scale of an image is found.
    """
    formation = formation_of(config)
    if not formation:
        return _UNKNOWN_GREY
    try:
        formula = _inverse_curve(config["sonar"]["transfer"], formation)
    except (AttributeError, KeyError, TypeError, ValueError):  # an untrusted configuration
        return _UNKNOWN_GREY
    grey = "v / 255" if dtype == "uint8" else "v"
    quantity = (
        "sum of the echo strengths in the bin (relative)"
        if formation == "pointwise"
        else "echo intensity after time-varying gain, over the source level"
    )
    scales = (
        f"full_scale is in {scale_place}"
        if formation == "pointwise"
        else f"full_scale is in {scale_place}; clean has clean_full_scale"
    )
    return (
        f"grey value g = {grey} shows the level L, the {quantity}: {formula}; {scales}. 0 is no "
        "echo, or one below the curve; 1 is full scale or more. In decibels: 10 log10(L)."
    )


def _inverse_curve(curve: Mapping[str, Any], formation: Formation) -> str:
    # Coherent images show amplitudes, and their levels are intensities.
    power = 2 if formation == "coherent" else 1
    return _INVERSES[curve["kind"]](curve, power)


def _linear(curve: Mapping[str, Any], power: float) -> str:
    return f"L = full_scale * g^{power:g}"


def _power(curve: Mapping[str, Any], power: float) -> str:
    return f"L = full_scale * g^({power:g} / {curve['exponent']:g})"


def _log(curve: Mapping[str, Any], _: float) -> str:
    return f"10 log10(L) = 10 log10(full_scale) - {curve['dynamic_range_db']:g} dB * (1 - g)"


def _soft_log(curve: Mapping[str, Any], _: float) -> str:
    black = curve.get("black", 0)
    span_db = curve["dynamic_range_db"]
    shown = f"(g - {black:g}) / {1 - black:g}" if black else "g"
    return f"L = full_scale * ((1 + R)^({shown}) - 1) / R with R = 10^({span_db:g} / 10)"


_INVERSES = {"linear": _linear, "power": _power, "log": _log, "soft_log": _soft_log}


def pixel_meaning(
    layout: str,
    width: int,
    *,
    bearings: str = "in /axes/azimuth (degrees, right is positive)",
) -> str:
    """How rows and columns turn into metres and bearings; one paragraph.

    layout: fan or polar.  width: columns of the images.
    bearings: where or what the bearings of the columns of a polar image are.
    """
    if layout == "polar":
        return (
            "range_m = range_min_m + (row + 0.5) * metres_per_pixel; the bearing of a column is "
            f"{bearings}."
        )
    return (
        "ahead_m = range_max_m - (row + 0.5) * metres_per_pixel; "
        f"right_m = (column + 0.5 - {width} / 2) * metres_per_pixel; "
        "range_m = hypot(ahead_m, right_m); bearing = atan2(right_m, ahead_m). "
        "Rows and columns count from 0 at the top left."
    )


# --- classes of labels

ObjectName = Literal[
    "Bottle", "Can", "Chain", "Drink-carton", "Hook", "Propeller", "Shampoo-bottle",
    "Standing-bottle", "Tire", "Valve", "Wall", "Boulder", "Pipe", "Pillar", "Frame", "Anchor",
    "Block", "Coral", "Plant", "Barrel",
]  # fmt: skip

# 0 to 11 are those of the Marine Debris Dataset; ground is 0.
CLASSES: tuple[str, ...] = ("Background", *get_args(ObjectName))


FITTING = "Fitting"
"""What belongs to a place and is no object to be found, such as a rope: a class without numbers."""


def class_names(added: Iterable[str]) -> tuple[str, ...]:
    """CLASSES and, from their end on, the classes of the user's own objects."""
    return tuple(dict.fromkeys((*CLASSES, *added)))


def classes_of(config: Mapping[str, Any]) -> tuple[str, ...]:
    """The class names of a dataset, from the settings in its shards."""
    return class_names(config.get("classes", ()))
