"""Kinds of places: the ranges that a location's ground, objects, colours and water come from."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt

Colour = Sequence[float]  # red, green, blue
Range = tuple[float, float]

# The order is the order in which locations 0, 1, 2, ... take them.
PlaceName = Literal[
    "debris", "canyon", "reef", "pier", "pipeline", "rubble", "quay", "sand", "garden", "wall"
]

PLACE_NAMES: tuple[PlaceName, ...] = get_args(PlaceName)


@dataclass(frozen=True)
class Place:
    """Ranges that each location of this kind draws from; `places.yaml` says what they are."""

    loop_m: tuple[Range, Range]
    waters: tuple[str, ...]
    scatter: dict[str, Range]
    altitude_m: Range
    pitch_deg: Range
    spread_m: float
    pebbles: Range
    slope_deg: Range
    swell_m: Range
    outcrop_cover: Range
    outcrop_m: Range
    gravel_cover: Range
    ripples: float
    ripple_cover: Range
    banks: tuple[Range, Range] | None
    sides: tuple[int, ...]
    look_across: float
    structure: Literal["pier", "quay"] | None


@functools.cache
def catalogue() -> dict[str, Any]:
    """`places.yaml`."""
    import yaml

    text = Path(__file__).with_name("places.yaml").read_text("utf-8")
    found: dict[str, Any] = yaml.safe_load(text)
    return found


def draw(rng: np.random.Generator, span: Range) -> float:
    """A uniform number in (low, high)."""
    return float(rng.uniform(*span))


def pick(
    rng: np.random.Generator, colours: Sequence[Colour], shades: Range = (0.75, 1.2)
) -> npt.NDArray[np.float64]:
    """One of the colours, a little lighter or darker."""
    return np.array(colours[int(rng.integers(len(colours)))]) * rng.uniform(*shades)


class Look:
    """Colours, water and light of a location, of a kind of place.

    palette: (5, 3) float32 albedo of sand, gravel, rock, algae and crust, red, green, blue.
    turf: how much of the rock is overgrown, 0 to 1.
    water: (4, 3) float32 attenuation per metre, colour of open water, light from the sun's
    direction and from all above.  sun_direction: (3,) unit, from the ground to the sun.
    clear_m: beyond this range nothing has a depth.
    """

    def __init__(self, rng: np.random.Generator, place: Place) -> None:
        water = catalogue()["waters"][place.waters[int(rng.integers(len(place.waters)))]]
        self.clear_m = draw(rng, water["clear_m"])
        height, turn = rng.uniform(0.72, 0.92), rng.uniform(0, 2 * np.pi)
        flat = np.sqrt(1 - height**2)
        self.sun_direction = np.array([flat * np.cos(turn), flat * np.sin(turn), height])
        sun = draw(rng, water["sun"])
        fade = [1.15 / self.clear_m * share for share in water["fade"]]
        haze = [value * rng.uniform(0.85, 1.15) for value in water["haze"]]
        light = [sun * share for share in (0.62, 1.0, 0.92)]
        self.water = np.array([fade, haze, light, water["sky"]], np.float32)
        rock, sand, algae, crust = (
            pick(rng, catalogue()["colours"][name], (0.85, 1.15))
            for name in ("rock", "sand", "algae", "crust")
        )
        self.palette = np.array([sand, rock * (1.15, 1.12, 1.08), rock, algae, crust], np.float32)
        self.turf = rng.uniform(0.2, 0.8)
