"""Colours of a location: sand, gravel, rock and what grows on them (`colour_loops` paints)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .fields import Floats
from .objects.meshes import Colour


@dataclass(frozen=True)
class Palette:
    """Albedo of a location's ground and growth, red, green, blue."""

    sand: Colour
    gravel: Colour
    rock: Colour
    algae: Colour
    crust: Colour
    turf: float  # how much of the rock is overgrown, 0 to 1

    @property
    def table(self) -> Floats:
        """(5, 3) sand, gravel, rock, algae, crust."""
        colours = (self.sand, self.gravel, self.rock, self.algae, self.crust)
        return np.array(colours, dtype=np.float32)


_SANDS: tuple[Colour, ...] = (
    (0.60, 0.54, 0.43),
    (0.50, 0.47, 0.40),
    (0.64, 0.59, 0.50),
    (0.40, 0.34, 0.26),
    (0.30, 0.28, 0.25),
    (0.22, 0.20, 0.18),
)
_ROCKS: tuple[Colour, ...] = ((0.33, 0.30, 0.25), (0.24, 0.23, 0.22), (0.40, 0.34, 0.27))
_ALGAE: tuple[Colour, ...] = ((0.12, 0.14, 0.06), (0.17, 0.13, 0.06), (0.10, 0.15, 0.09))
_CRUSTS: tuple[Colour, ...] = ((0.42, 0.20, 0.26), (0.50, 0.28, 0.12), (0.40, 0.38, 0.16))


def draw_palette(rng: np.random.Generator) -> Palette:
    """Draw the colours of a location."""

    def one(colours: tuple[Colour, ...]) -> Colour:
        red, green, blue = colours[int(rng.integers(len(colours)))]
        shade = float(rng.uniform(0.85, 1.15))
        return red * shade, green * shade, blue * shade

    rock = one(_ROCKS)
    gravel = (rock[0] * 1.15, rock[1] * 1.12, rock[2] * 1.08)
    return Palette(one(_SANDS), gravel, rock, one(_ALGAE), one(_CRUSTS), rng.uniform(0.2, 0.8))
