"""Multipath ghosts: Gaussian clusters where the view from above is dense (paper section 3.3.3).

The number of points per cell of the top view is normalised; cells at or above a quantile of the
occupied ones are candidates, drawn in proportion to their density.  A ghost arrives later than the
true echo, so its centre lies behind the dense cell.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from pydantic.dataclasses import dataclass

from ...distribution import Fraction, NonNegative, choice, uniform
from ...imaging.effect import Effect, EffectSettings, parameter
from ...settings import STRICT
from ...sonar import polar
from ...sonar.echoes import Echoes, in_plane
from ...sonar.window import Window

# Cells of the density map, along range and bearing: about the size of the ghosts.
_CELLS = (64, 48)


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

    count: NonNegative = parameter(choice(1, 2, 3), "1")
    density: NonNegative = parameter(uniform(0.005, 0.04), "1")
    quantile: Fraction = parameter(0.9, "1")
    delay: NonNegative = parameter(uniform(0.01, 0.06), "1")
    spread: NonNegative = parameter(uniform(0.01, 0.03), "1")
    strength: NonNegative = parameter(uniform(0.1, 0.6), "1")


def multipath(
    scene: Echoes,
    window: Window,
    rng: np.random.Generator,
    *,
    count: float,
    density: float,
    quantile: float,
    delay: float,
    spread: float,
    strength: float,
) -> Echoes:
    """Ghost points behind the dense regions of `scene`."""
    clusters = round(count)
    points = round(density * len(scene)) if clusters else 0
    cells = _top_view_density(scene, window) if points else np.zeros(_CELLS)
    if not cells.any():
        empty = np.empty(0, np.float32)
        return in_plane(empty, empty, empty)
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


def _top_view_density(scene: Echoes, window: Window) -> npt.NDArray[np.float64]:
    """Insonified points per top-view cell, normalised to a maximum of 1; shape `_CELLS`."""
    counts = polar.density(scene, window, *_CELLS).astype(np.float64)
    return np.asarray(counts / max(counts.max(), 1.0))


MULTIPATH = Effect(MultipathSettings, multipath, "points", artefact="ghosts")
