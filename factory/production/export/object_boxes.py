"""Boxes of objects by convention: their echoes, echoes and shadow, or the objects themselves."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from ...common.array_types import Float64s
from ...common.errors import FactoryError
from ...dataset.fan_geometry import FanGeometry

_STEPS = 9
"""Points along each side of a box and of a patch of range and bearing."""


class Box(NamedTuple):
    """The smallest box around an object, pixels."""

    left: int
    top: int
    width: int
    height: int

    @property
    def corners(self) -> tuple[float, float, float, float]:
        """Left, top, right, bottom."""
        return self.left, self.top, self.left + self.width, self.top + self.height


class ObjectPlace(NamedTuple):
    """Where an object is, as the column boxes says it, in metres and radians of the sonar's axes.

    points_m: (N, 3) points of its oriented box: ahead, left, up.
    bearings_rad: least and most of its echoes.  nearest_m: range of its nearest echo.
    shadow_m: range at which its shadow ends, None where none is seen.
    """

    points_m: Float64s
    bearings_rad: tuple[float, float]
    nearest_m: float
    shadow_m: float | None


def parse_places(text: str, place: str) -> dict[int, ObjectPlace]:
    """Number in /instance -> place of each object that echoes, of a value of the column boxes.

    place: where the text is, for the error.  Raises FactoryError for anything else.
    """
    try:
        return {
            int(entry["instance"]): _place_of(entry)
            for entry in json.loads(text)
            if entry["range_m"] is not None
        }
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise FactoryError(
            f"{place}: column boxes is no list of boxes ({type(error).__name__}); "
            "make the dataset anew"
        ) from error


def _place_of(entry: Mapping[str, Any]) -> ObjectPlace:
    """The place of an object by an entry of the column `boxes`: points that fill its box.

    Raises ValueError for numbers that are not finite.
    """
    yaw_rad = math.radians(entry["yaw_deg"])
    along = np.linspace(-0.5, 0.5, _STEPS)
    parts = np.stack(np.meshgrid(along, along, along, indexing="ij"), axis=-1).reshape(-1, 3)
    length, width, height = (parts * np.asarray(entry["size_m"], np.float64)).T
    turned = np.stack(
        [
            length * math.cos(yaw_rad) - width * math.sin(yaw_rad),
            length * math.sin(yaw_rad) + width * math.cos(yaw_rad),
            height,
        ],
        axis=-1,
    )
    first_deg, last_deg = entry["bearing_deg"]
    shadow_m = entry.get("shadow_m")
    numbers = [*turned.ravel().tolist(), *entry["centre_m"], first_deg, last_deg]
    numbers += [*entry["range_m"], 0.0 if shadow_m is None else shadow_m]
    if not np.isfinite(np.asarray(numbers, np.float64)).all():
        raise ValueError("numbers that are not finite")
    return ObjectPlace(
        points_m=turned + np.asarray(entry["centre_m"], np.float64),
        bearings_rad=(math.radians(first_deg), math.radians(last_deg)),
        nearest_m=float(entry["range_m"][0]),
        shadow_m=None if shadow_m is None else float(shadow_m),
    )


def box_with_shadow(
    echo: Box, place: ObjectPlace, geometry: FanGeometry, shape: tuple[int, int]
) -> Box:
    """The box around the echoes of an object and its shadow, behind them at their bearings."""
    if place.shadow_m is None:
        return echo
    steps = np.linspace(0, 1, _STEPS)
    first_rad, last_rad = place.bearings_rad
    range_m = place.nearest_m + steps[:, None] * (place.shadow_m - place.nearest_m)
    bearing_rad = first_rad + steps[None] * (last_rad - first_rad)
    return _box_around(range_m, bearing_rad, geometry, shape, echo)


def box_of_object(
    echo: Box, place: ObjectPlace, geometry: FanGeometry, shape: tuple[int, int]
) -> Box:
    """The box around all of an object, what echoes and what does not."""
    ahead, left, _ = place.points_m.T
    range_m = np.linalg.norm(place.points_m, axis=1)
    # The share of the range to the left is -sin(bearing) in conical beams, at any elevation.
    bearing_rad = np.arcsin(np.clip(-left / np.maximum(range_m, 1e-9), -1, 1))
    is_ahead = ahead > 0
    return _box_around(range_m[is_ahead], bearing_rad[is_ahead], geometry, shape, echo)


def _box_around(
    range_m: Float64s,
    bearing_rad: Float64s,
    geometry: FanGeometry,
    shape: tuple[int, int],
    echo: Box,
) -> Box:
    """The box around points in the image, and around the echoes.

    Points beyond the window or the sector count at its edge.
    """
    if geometry.range_min_m is None or geometry.range_max_m is None or not range_m.size:
        return echo
    near_m, far_m = geometry.range_min_m, geometry.range_max_m
    fraction = np.clip(range_m, near_m, far_m) / far_m
    bearing = np.clip(bearing_rad, geometry.azimuth_min_rad, geometry.azimuth_max_rad)
    row, column = geometry.pixels(*np.broadcast_arrays(fraction, bearing))
    height, width = shape
    left, top, right, bottom = echo.corners
    left = max(min(left, math.floor(float(column.min()) + 0.5)), 0)
    top = max(min(top, math.floor(float(row.min()) + 0.5)), 0)
    right = min(max(right, math.floor(float(column.max()) + 0.5) + 1), width)
    bottom = min(max(bottom, math.floor(float(row.max()) + 0.5) + 1), height)
    return Box(int(left), int(top), int(right - left), int(bottom - top))
