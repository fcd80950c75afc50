"""Kinds of places: the ranges that a location's ground, objects, colours and water come from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt

Colour = tuple[float, ...]  # red, green, blue
Range = tuple[float, float]

# The order is the order in which locations 0, 1, 2, ... take them.
PlaceName = Literal[
    "debris", "canyon", "reef", "pier", "pipeline", "rubble", "quay", "sand", "garden", "wall"
]

PLACE_NAMES: tuple[PlaceName, ...] = get_args(PlaceName)


@dataclass(frozen=True)
class Place:
    """Ranges (low, high) that each location of this kind draws from.

    loop_m: half axes of the camera's loop.  altitude_m: camera above the ground.
    pitch_deg: camera below the horizon.  scatter: object kind -> how many, at density 1.
    pebbles: small stones.  spread_m: typical distance of objects from the camera's loop.
    banks: (foot distance from the axis, wall height) in metres, with `sides`.
    look_across: how far the camera turns to the left of the axis, where a wall is (0 to 1).
    structure: something built along the axis.
    """

    loop_m: tuple[Range, Range]
    waters: tuple[str, ...]
    scatter: dict[str, Range]
    altitude_m: Range = (0.8, 1.6)
    pitch_deg: Range = (14, 26)
    spread_m: float = 1.8
    pebbles: Range = (80, 240)
    slope_deg: Range = (0, 8)
    swell_m: Range = (0.08, 0.3)
    outcrop_cover: Range = (0.0, 0.12)
    outcrop_m: Range = (0.15, 0.5)
    gravel_cover: Range = (0.05, 0.4)
    ripples: float = 0.6
    ripple_cover: Range = (0.4, 0.95)
    banks: tuple[Range, Range] | None = None
    sides: tuple[int, ...] = (1, -1)
    look_across: float = 0.0
    structure: Literal["pier", "quay"] | None = None


_DEBRIS = {"Bottle": (16, 26), "Can": (16, 26), "Drink-carton": (12, 20), "Hook": (9, 15),
    "Propeller": (5, 9), "Shampoo-bottle": (12, 20), "Standing-bottle": (12, 20), "Tire": (6, 10),
    "Valve": (8, 13), "Chain": (3, 5), "Barrel": (1, 4)}  # fmt: skip
_SOME_DEBRIS = {name: (low * 0.2, high * 0.3) for name, (low, high) in _DEBRIS.items()}

# fmt: off
PLACES: dict[PlaceName, Place] = {
    "debris": Place(
        loop_m=((8, 11), (5, 8)), waters=("clear", "green", "lake", "dark"), altitude_m=(0.75, 1.3),
        spread_m=1.2,
        scatter={**_DEBRIS, "Boulder": (10, 22), "Block": (3, 7), "Plant": (0, 16),
                 "Anchor": (1, 2)}),
    "canyon": Place(
        loop_m=((13, 16), (0.2, 0.45)), waters=("cyan", "clear", "green"), pitch_deg=(9, 18),
        spread_m=0.9, pebbles=(200, 420), outcrop_cover=(0.05, 0.25), ripples=0.8,
        banks=((1.7, 2.7), (2.6, 5.5)),
        scatter={"Boulder": (60, 110), "Coral": (16, 36), "Chain": (0, 2), "Anchor": (0, 1)}),
    "reef": Place(
        loop_m=((8, 12), (6, 9)), waters=("deep", "clear", "green"), altitude_m=(0.9, 2.0),
        scatter={"Frame": (13, 20), "Block": (18, 32), "Tire": (8, 14), "Coral": (20, 40),
                 "Boulder": (8, 16), "Chain": (1, 3), "Barrel": (1, 3)}),
    "pier": Place(
        loop_m=((12, 15), (0.8, 1.1)), waters=("green", "dark", "clear", "lake"),
        pitch_deg=(11, 20), spread_m=1.5, structure="pier",
        scatter={**_SOME_DEBRIS, "Tire": (4, 8), "Block": (5, 10), "Boulder": (14, 26),
                 "Anchor": (0, 2), "Pipe": (1, 2)}),
    "pipeline": Place(
        loop_m=((9, 13), (4, 7)), waters=("deep", "green", "clear"), spread_m=2.0,
        scatter={"Pipe": (4, 6), "Valve": (8, 14), "Block": (7, 13), "Boulder": (10, 22),
                 "Anchor": (1, 2), "Chain": (2, 4), "Hook": (2, 5), "Plant": (0, 14)}),
    "rubble": Place(
        loop_m=((8, 11), (6, 8)), waters=("cyan", "clear", "green"), spread_m=2.6,
        pebbles=(350, 600), slope_deg=(3, 14), outcrop_cover=(0.1, 0.35), gravel_cover=(0.3, 0.8),
        ripples=0.3,
        scatter={"Boulder": (95, 150), "Coral": (8, 20), "Tire": (1, 3), "Anchor": (0, 2)}),
    "quay": Place(
        loop_m=((12, 15), (0.7, 1.2)), waters=("lake", "dark", "clear", "green"), spread_m=1.5,
        look_across=0.5, structure="quay",
        scatter={**_SOME_DEBRIS, "Barrel": (1, 3), "Boulder": (14, 30), "Block": (4, 9)}),
    "sand": Place(
        loop_m=((9, 12), (6, 9)), waters=("clear", "cyan", "deep"), swell_m=(0.12, 0.4),
        gravel_cover=(0.0, 0.15), ripples=1.0, ripple_cover=(0.8, 1.0),
        scatter={**_SOME_DEBRIS, "Tire": (3, 6), "Boulder": (6, 14), "Plant": (20, 60),
                 "Anchor": (1, 3), "Wall": (0, 2)}),
    "garden": Place(
        loop_m=((8, 11), (6, 8)), waters=("clear", "cyan", "deep"), spread_m=2.4,
        outcrop_cover=(0.15, 0.45),
        scatter={"Coral": (90, 140), "Boulder": (30, 50), "Plant": (10, 40), "Block": (0, 4)}),
    "wall": Place(
        loop_m=((12, 15), (0.8, 1.3)), waters=("deep", "cyan", "clear"), slope_deg=(2, 12),
        outcrop_cover=(0.05, 0.3), banks=((2.2, 3.2), (3.5, 6.5)), sides=(1,), look_across=0.5,
        scatter={"Boulder": (40, 70), "Coral": (20, 40), "Chain": (1, 3), "Anchor": (0, 2),
                 "Frame": (1, 3), "Tire": (0, 3)}),
}
# fmt: on


def pick(
    rng: np.random.Generator, colours: tuple[Colour, ...], darkest: float = 0.75,
    lightest: float = 1.2,
) -> npt.NDArray[np.float64]:  # fmt: skip
    """One of the colours, a little lighter or darker."""
    return np.array(colours[int(rng.integers(len(colours)))]) * rng.uniform(darkest, lightest)


def draw(rng: np.random.Generator, span: Range) -> float:
    """A uniform number in (low, high)."""
    return float(rng.uniform(*span))


_SANDS: tuple[Colour, ...] = ((0.60, 0.54, 0.43), (0.50, 0.47, 0.40), (0.64, 0.59, 0.50),
    (0.40, 0.34, 0.26), (0.30, 0.28, 0.25), (0.22, 0.20, 0.18))  # fmt: skip
_ROCKS: tuple[Colour, ...] = ((0.33, 0.30, 0.25), (0.24, 0.23, 0.22), (0.40, 0.34, 0.27))
_ALGAE: tuple[Colour, ...] = ((0.12, 0.14, 0.06), (0.17, 0.13, 0.06), (0.10, 0.15, 0.09))
_CRUSTS: tuple[Colour, ...] = ((0.42, 0.20, 0.26), (0.50, 0.28, 0.12), (0.40, 0.38, 0.16))


@dataclass(frozen=True)
class _Water:
    """Ranges of a kind of water; fade is relative to that of green."""

    haze: Colour
    fade: Colour
    sun: Range
    sky: Colour
    clear_m: Range


_WATERS: dict[str, _Water] = {
    "clear": _Water((0.03, 0.24, 0.41), (3.2, 1.0, 0.75), (0.6, 1.0), (0.26, 0.60, 0.70), (10, 17)),
    "cyan": _Water((0.07, 0.42, 0.48), (2.7, 1.0, 0.95), (0.6, 1.0), (0.34, 0.68, 0.70), (9, 15)),
    "deep": _Water((0.01, 0.075, 0.19), (3.6, 1.0, 0.65), (0.2, 0.4), (0.13, 0.36, 0.52), (9, 15)),
    "green": _Water((0.04, 0.15, 0.105), (2.0, 1.0, 1.35), (0.4, 0.8), (0.30, 0.52, 0.40), (8, 12)),
    "lake": _Water((0.07, 0.085, 0.035), (1.25, 1.0, 1.9), (0.3, 0.6), (0.42, 0.44, 0.26),
                  (7.5, 11)),
    "dark": _Water((0.012, 0.04, 0.045), (2.4, 1.0, 1.1), (0.08, 0.2), (0.24, 0.30, 0.30),
                  (7.5, 11)),
}  # fmt: skip


class Look:
    """Colours, water and light of a location, of a kind of place.

    palette: (5, 3) float32 albedo of sand, gravel, rock, algae and crust, red, green, blue.
    turf: how much of the rock is overgrown, 0 to 1.
    water: (4, 3) float32 attenuation per metre, colour of open water, light from the sun's
    direction and from all above.  sun_direction: (3,) unit, from the ground to the sun.
    clear_m: beyond this range nothing has a depth.
    """

    def __init__(self, rng: np.random.Generator, place: Place) -> None:
        kind = _WATERS[place.waters[int(rng.integers(len(place.waters)))]]
        self.clear_m = draw(rng, kind.clear_m)
        height, turn = rng.uniform(0.72, 0.92), rng.uniform(0, 2 * np.pi)
        flat = np.sqrt(1 - height**2)
        self.sun_direction = np.array([flat * np.cos(turn), flat * np.sin(turn), height])
        sun = draw(rng, kind.sun)
        fade = [1.15 / self.clear_m * share for share in kind.fade]
        haze = [value * rng.uniform(0.85, 1.15) for value in kind.haze]
        light = [sun * share for share in (0.62, 1.0, 0.92)]
        self.water = np.array([fade, haze, light, kind.sky], np.float32)
        rock = pick(rng, _ROCKS, 0.85, 1.15)
        sand, algae, crust = (pick(rng, some, 0.85, 1.15) for some in (_SANDS, _ALGAE, _CRUSTS))
        gravel = rock * (1.15, 1.12, 1.08)
        self.palette = np.array([sand, gravel, rock, algae, crust], np.float32)
        self.turf = rng.uniform(0.2, 0.8)
