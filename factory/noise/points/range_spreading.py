"""Range spreading: echoes that arrive later and more dispersed the farther they come from.

Paper section 3.3.2: n_i = alpha * d_i, N ~ N(0, n_i), and each coordinate gets |N| added.  Printed
so, in camera axes, the formula also turns every point to the right and downwards and brings those
that lie to the left nearer, although the text says later and farther;
tests/factory/noise/test_noise.py states by how much.  `mode: paper` is that formula to the letter;
`mode: radial` is what the text means: the range grows by |N| and the direction stays.
`mode: exponential` delays by e ~ Exp(alpha * d) and weakens the echo by exp(-e / (alpha * d))
(Potokar et al. 2022, HoloOcean).
"""

from __future__ import annotations

from typing import Literal

import numpy as np
import numpy.typing as npt
from pydantic.dataclasses import dataclass

from ...distribution import NonNegative, uniform
from ...imaging.effect import Effect, EffectSettings, option, parameter
from ...settings import STRICT
from ...sonar.echoes import Echoes, from_xyz
from ...sonar.window import Window


@dataclass(frozen=True, config=STRICT)
class RangeSpreadingSettings(EffectSettings):
    """Keys of `noise.range_spreading`.

    mode: how echoes move: paper as it prints them, radial half-normally behind their point,
        exponential likewise and weaker.
    alpha: standard deviation of the spreading as a fraction of the range.
    """

    mode: Literal["paper", "radial", "exponential"] = option("radial")
    alpha: NonNegative = parameter(uniform(0.004, 0.040), "1")


def range_spreading(
    scene: Echoes, window: Window, rng: np.random.Generator, *, mode: str, alpha: float
) -> Echoes:
    """The scene's echoes, spread; same number and order of points."""
    if mode == "paper":
        return _as_printed(scene, rng, alpha)
    scale_m = np.float32(alpha) * scene.range_m
    if mode == "radial":
        delay_m = _half_normal(rng, len(scene))
        delay_m *= scale_m
        strength = scene.strength
    else:
        unit_delay = rng.standard_exponential(len(scene), dtype=np.float32)
        delay_m = unit_delay * scale_m
        strength = scene.strength * np.exp(-unit_delay)
    return Echoes(scene.range_m + delay_m, scene.azimuth_rad, scene.elevation_rad, strength)


def _half_normal(rng: np.random.Generator, count: int) -> npt.NDArray[np.float32]:
    """(count,) float32 draws of |N(0, 1)|, by the inverse of its distribution."""
    from ... import elementary  # loads numba

    size = np.empty(count, np.float32)
    elementary.half_normal(rng.random(count, dtype=np.float32), size)
    return size


def _as_printed(scene: Echoes, rng: np.random.Generator, alpha: float) -> Echoes:
    # The paper adds |N| along x right, y down, z forward; sonar axes are x forward, y left, z up.
    offset = np.abs(rng.standard_normal((len(scene), 3))) * (alpha * scene.range_m[:, None])
    forward, right, down = offset.T
    return from_xyz(scene.xyz_m() + np.stack([forward, -right, -down], axis=1), scene.strength)


RANGE_SPREADING = Effect(
    RangeSpreadingSettings, range_spreading, "points", moves=True, artefact="blur"
)
