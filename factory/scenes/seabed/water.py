"""Light and water: how bright and what colour the surface looks through the water.

Image formation after Akkaynak & Treibitz (2018): the direct signal fades with one coefficient a
colour, the veil of scattered light grows with another.  `colour_loops.photograph` computes it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .biomes import draw
from .fields import Floats

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class Water:
    """Water and light of a location; triples are red, green, blue.

    fade_per_m, veil_per_m: attenuation of the direct signal and growth of the veil.
    veil: colour of open water.  sun, sky: light from the sun's direction and from all above.
    sun_direction: unit, from the ground to the sun.  caustics: 0 to 1.  lamp: light at the camera.
    clear_m: beyond this range nothing has a depth.  motes: bright specks in a frame, at most.
    """

    fade_per_m: Triple
    veil_per_m: Triple
    veil: Triple
    sun: Triple
    sky: Triple
    sun_direction: Triple
    caustics: float
    caustic_period_m: float
    lamp: Triple
    clear_m: float
    motes: int

    @property
    def table(self) -> Floats:
        """(6, 3) fade, growth of the veil, veil, sun, sky, lamp."""
        rows = (self.fade_per_m, self.veil_per_m, self.veil, self.sun, self.sky, self.lamp)
        return np.array(rows, dtype=np.float32)


@dataclass(frozen=True)
class _Kind:
    """Ranges of a kind of water; fade is relative to that of green."""

    veil: Triple
    fade: Triple
    sun: tuple[float, float]
    sky: Triple
    caustics: tuple[float, float]
    lamp: tuple[float, float]
    clear_m: tuple[float, float]


_KINDS: dict[str, _Kind] = {
    "clear": _Kind((0.03, 0.24, 0.41), (3.2, 1.0, 0.75), (0.6, 1.0), (0.26, 0.60, 0.70),
                   (0.1, 0.45), (0, 0), (10, 17)),
    "cyan": _Kind((0.07, 0.42, 0.48), (2.7, 1.0, 0.95), (0.6, 1.0), (0.34, 0.68, 0.70),
                  (0.1, 0.4), (0, 0), (9, 15)),
    "deep": _Kind((0.010, 0.075, 0.19), (3.6, 1.0, 0.65), (0.2, 0.4), (0.13, 0.36, 0.52),
                  (0.0, 0.1), (0.0, 0.8), (9, 15)),
    "green": _Kind((0.040, 0.150, 0.105), (2.0, 1.0, 1.35), (0.4, 0.8), (0.30, 0.52, 0.40),
                   (0.0, 0.25), (0.0, 0.4), (8, 12)),
    "lake": _Kind((0.070, 0.085, 0.035), (1.25, 1.0, 1.9), (0.3, 0.6), (0.42, 0.44, 0.26),
                  (0.0, 0.1), (0.0, 0.8), (7.5, 11)),
    "dark": _Kind((0.012, 0.040, 0.045), (2.4, 1.0, 1.1), (0.08, 0.2), (0.07, 0.13, 0.14),
                  (0.0, 0.0), (1.6, 2.8), (7.5, 11)),
}  # fmt: skip


def draw_water(rng: np.random.Generator, kinds: tuple[str, ...]) -> Water:
    """Draw the water of a location from one of the named kinds."""
    kind = _KINDS[kinds[int(rng.integers(len(kinds)))]]
    clear = draw(rng, kind.clear_m)
    green = 1.15 / clear
    height, turn = rng.uniform(0.72, 0.92), rng.uniform(0, 2 * np.pi)
    flat = np.sqrt(1 - height**2)
    sun, lamp = draw(rng, kind.sun), draw(rng, kind.lamp)
    shade = [value * rng.uniform(0.85, 1.15) for value in kind.veil]
    return Water(
        fade_per_m=_triple([green * share for share in kind.fade]),
        veil_per_m=_triple([1.35 * green * share**0.5 for share in kind.fade]),
        veil=_triple(shade),
        sun=_triple([sun * share for share in (0.62, 1.0, 0.92)]),
        sky=kind.sky,
        sun_direction=_triple([flat * np.cos(turn), flat * np.sin(turn), height]),
        caustics=draw(rng, kind.caustics),
        caustic_period_m=rng.uniform(3.0, 5.5),
        lamp=_triple([lamp * share for share in (1.0, 0.97, 0.88)]),
        clear_m=clear,
        motes=int(rng.integers(0, 60)),
    )


def _triple(values: list[float]) -> Triple:
    red, green, blue = (float(value) for value in values)
    return red, green, blue
