"""The paper's noise: echoes that are moved or added (Yang et al. 2024, section 3.3)."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Literal

import numpy as np
from pydantic.dataclasses import dataclass

from ...common.distribution import (
    Count,
    Density,
    Distribution,
    Fraction,
    Share,
    Strength,
    as_written,
    within,
)
from ...common.settings import STRICT
from ..imaging.effect import Effect, EffectSettings, Rng, parameter
from ..sonar import polar
from ..sonar.polar import Echoes, from_xyz, in_plane
from ..sonar.window import Window

# Cells of the density map, along range and bearing: about the size of the ghosts.
_CELLS = (64, 48)

_Width = Annotated[Distribution, within(0, 180, "deg"), as_written]


@dataclass(frozen=True, config=STRICT)
class RangeSpreadingSettings(EffectSettings):
    """Keys of `noise.range_spreading`.

    mode: how echoes move: paper as it prints them, radial half-normally behind their point,
        exponential likewise and weaker.
    alpha: standard deviation of the spreading as a fraction of the range.
    """

    mode: Literal["paper", "radial", "exponential"] = parameter("radial")
    alpha: Share = parameter({"uniform": [0.004, 0.040]}, "1")


def range_spreading(scene: Echoes, window: Window, rng: Rng, *, mode: str, alpha: float) -> Echoes:
    """The echoes, later and more dispersed the farther they come from; same number and order.

    Section 3.3.2: n_i = alpha * d_i, N ~ N(0, n_i), and each coordinate gets |N| added.  In camera
    axes that also turns every point to the right and downwards and brings those on the left nearer.
    `mode: paper` is that formula to the letter; `radial` is what the text means: the range grows by
    |N| and the direction stays.  `exponential` delays by e ~ Exp(alpha * d) and weakens the echo by
    exp(-e / (alpha * d)) (Potokar et al. 2022, HoloOcean).
    """
    from ...common import elementary  # loads numba

    if mode == "paper":
        # Along x right, y down, z forward; sonar axes are x forward, y left, z up.
        offset = np.abs(rng.standard_normal((len(scene), 3))) * (alpha * scene.range_m[:, None])
        forward, right, down = offset.T
        return from_xyz(scene.xyz_m() + np.stack([forward, -right, -down], axis=1), scene.strength)
    strength = scene.strength
    delay = np.empty(len(scene), np.float32)
    if mode == "radial":  # |N(0, 1)| by the inverse of its distribution
        elementary.half_normal(rng.random(len(scene), dtype=np.float32), delay)
    else:
        rng.standard_exponential(out=delay, dtype=np.float32)
        strength = strength * np.exp(-delay)
    range_m = scene.range_m + delay * (np.float32(alpha) * scene.range_m)
    return replace(scene, range_m=range_m, strength=strength)


RANGE_SPREADING = Effect(RangeSpreadingSettings, range_spreading, "points", "blur", moves=True)


@dataclass(frozen=True, config=STRICT)
class MultipathSettings(EffectSettings):
    """Keys of `noise.multipath`.

    count: number of ghost clusters (rounded).
    density: points of all ghosts together as a fraction of the resampled scene points.
    quantile: only cells denser than this fraction of the occupied cells cast ghosts.
    delay: distance of a ghost behind its cell as a fraction of the range window.
    spread: standard deviation of a cluster as a fraction of the range window.
    strength: strongest ghost point; 1 alone fills a bin to full scale.
    """

    count: Count = parameter({"choice": [1, 2, 3]}, "1")
    density: Density = parameter({"uniform": [0.005, 0.04]}, "1")
    quantile: Fraction = parameter(0.9, "1")
    delay: Share = parameter({"uniform": [0.01, 0.06]}, "1")
    spread: Share = parameter({"uniform": [0.01, 0.03]}, "1")
    strength: Strength = parameter({"uniform": [0.1, 0.6]}, "1")


def multipath(
    scene: Echoes, window: Window, rng: Rng, *, count: float, density: float, quantile: float,
    delay: float, spread: float, strength: float,
) -> Echoes:  # fmt: skip
    """Ghosts: Gaussian clusters behind what is dense in the view from above (section 3.3.3).

    The number of points per cell of the top view is normalised; cells at or above a quantile of the
    occupied ones are candidates, drawn in proportion to their density.  A ghost arrives later than
    the true echo, so its centre lies behind the dense cell.
    """
    clusters = round(count)
    points = round(density * len(scene)) if clusters else 0
    cells = np.zeros(_CELLS)
    if points:
        counts = polar.count_echoes(scene, window, *_CELLS).astype(np.float64)
        cells = counts / max(counts.max(), 1.0)
    if not cells.any():
        return in_plane(*np.empty((3, 0), np.float32))
    threshold = np.quantile(cells[cells > 0], quantile)
    weight = np.where(cells >= threshold, cells, 0.0).ravel()
    chosen = rng.choice(cells.size, size=clusters, p=weight / weight.sum())
    row, column = np.unravel_index(chosen, _CELLS)
    centre_range_m = window.range_min_m + window.range_span_m * (
        (row + rng.random(clusters)) / _CELLS[0] + delay
    )
    centre_azimuth_rad = window.azimuth_min_rad + window.azimuth_span_rad * (
        (column + rng.random(clusters)) / _CELLS[1]
    )
    member = rng.integers(clusters, size=points)
    spread_m = spread * window.range_span_m
    range_m = centre_range_m[member] + spread_m * rng.standard_normal(points)
    # The same width in metres across as along, at the ghost's own range.
    across_rad = spread_m / np.maximum(centre_range_m[member], spread_m + 1e-6)
    azimuth_rad = centre_azimuth_rad[member] + across_rad * rng.standard_normal(points)
    return in_plane(range_m, azimuth_rad, strength * rng.random(points))


MULTIPATH = Effect(MultipathSettings, multipath, "points", "ghosts")


@dataclass(frozen=True, config=STRICT)
class AzimuthSettings(EffectSettings):
    """Keys of `noise.azimuth`.

    count: number of spokes (rounded).
    density: points of all spokes together as a fraction of the resampled scene points.
    sigma_deg: angular width (one standard deviation) of a spoke.
    strength: strongest spoke point; 1 alone fills a bin to full scale.
    """

    count: Count = parameter({"choice": [1, 2]}, "1")
    density: Density = parameter({"uniform": [0.003, 0.02]}, "1")
    sigma_deg: _Width = parameter({"uniform": [0.1, 0.4]}, "deg")
    strength: Strength = parameter({"uniform": [0.1, 0.6]}, "1")


def azimuth(
    scene: Echoes, window: Window, rng: Rng, *, count: float, density: float, sigma_deg: float,
    strength: float,
) -> Echoes:  # fmt: skip
    """Spokes: too much echo from single bearings, drawn anywhere in the window (section 3.3.4).

    r ~ U(r_min, r_max) and theta ~ N(theta_0, sigma) around each of `count` bearings.
    """
    spokes = round(count)
    points = round(density * len(scene)) if spokes else 0
    bearing_rad = window.azimuth_min_rad + window.azimuth_span_rad * rng.random(spokes)
    member = rng.integers(max(spokes, 1), size=points)
    azimuth_rad = bearing_rad[member] + np.deg2rad(sigma_deg) * rng.standard_normal(points)
    range_m = window.range_min_m + window.range_span_m * rng.random(points)
    return in_plane(range_m, azimuth_rad, strength * rng.random(points))


AZIMUTH = Effect(AzimuthSettings, azimuth, "points", "spokes")


@dataclass(frozen=True, config=STRICT)
class RangeArcSettings(EffectSettings):
    """Keys of `noise.range_arc`.

    count: number of arcs (rounded).
    density: points of all arcs together as a fraction of the resampled scene points.
    sigma: thickness (one standard deviation) of an arc as a fraction of the range window.
    strength: strongest arc point; 1 alone fills a bin to full scale.
    """

    count: Count = parameter(0, "1")
    density: Density = parameter(0.02, "1")
    sigma: Share = parameter(0.003, "1")
    strength: Strength = parameter(0.5, "1")


def range_arc(
    scene: Echoes, window: Window, rng: Rng, *, count: float, density: float, sigma: float,
    strength: float,
) -> Echoes:  # fmt: skip
    """Arcs: echoes smeared over all bearings at the ranges of strong ones.

    A strong return leaks through the sidelobes into every beam of its range row (HoloOcean calls
    this an azimuth streak).  The counterpart of the spokes; off unless `count` says so.
    """
    arcs = round(count)
    points = round(density * len(scene)) if arcs else 0
    total = float(scene.strength.sum(dtype=np.float64))
    if not points or total <= 0:
        return in_plane(*np.empty((3, 0), np.float32))
    probability = scene.strength.astype(np.float64) / total
    source = rng.choice(len(scene), size=arcs, p=probability / probability.sum())
    member = rng.integers(arcs, size=points)
    centre_m = scene.range_in(window)[source]
    range_m = centre_m[member] + sigma * window.range_span_m * rng.standard_normal(points)
    azimuth_rad = window.azimuth_min_rad + window.azimuth_span_rad * rng.random(points)
    return in_plane(range_m, azimuth_rad, strength * rng.random(points))


RANGE_ARC = Effect(RangeArcSettings, range_arc, "points", "spokes")


@dataclass(frozen=True, config=STRICT)
class BackgroundSettings(EffectSettings):
    """Keys of `noise.background`.

    density: number of noise points as a fraction of the resampled scene points.
    strength: strongest noise point; 1 alone fills a bin to full scale.
    """

    density: Density = parameter({"uniform": [0.002, 0.045]}, "1")
    strength: Strength = parameter({"uniform": [0.05, 0.35]}, "1")


def background(
    scene: Echoes, window: Window, rng: Rng, *, density: float, strength: float
) -> Echoes:
    """Silt, micro-organisms and other scatterers in the water (section 3.3.1).

    r ~ U(a, b), theta ~ U(c, d), strength ~ U(0, 1): points spread evenly over range and bearing,
    so their density on the ground falls as 1/r, as the paper prints it.
    """
    count = round(density * len(scene))
    range_m = window.range_min_m + window.range_span_m * rng.random(count, dtype=np.float32)
    azimuth_rad = window.azimuth_min_rad + window.azimuth_span_rad * rng.random(
        count, dtype=np.float32
    )
    return in_plane(range_m, azimuth_rad, strength * rng.random(count, dtype=np.float32))


BACKGROUND = Effect(BackgroundSettings, background, "points", "speckle")
