"""Smooth random fields, exact at every point, so that two views of one spot agree."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ...common.array_types import Draws, Float32s


class Waves:
    """A smooth random field with mean 0 and unit variance: a sum of plane waves.

    It has wavelengths from `longest_m` to `shortest_m`; amplitude goes as wavelength ** roughness
    (1 is a natural landscape, 0 is white).
    """

    def __init__(
        self, rng: Draws, longest_m: float, shortest_m: float, roughness: float, dimensions: int = 2
    ) -> None:
        octaves = max(np.log2(longest_m / shortest_m), 0.5)
        count = max(round((dimensions + 3) * octaves), 3)
        # One wave in each equal step of log wavelength, so that no octave is left out by chance.
        steps = (np.arange(count) + rng.random(count)) / count
        wavelengths = longest_m * (shortest_m / longest_m) ** steps
        directions = rng.standard_normal((count, dimensions))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        amplitudes = wavelengths**roughness
        amplitudes *= np.sqrt(2 / np.sum(amplitudes**2))
        vectors = directions * (2 * np.pi / wavelengths)[:, None]
        parts = vectors, rng.uniform(0, 2 * np.pi, count), amplitudes
        self._waves = [np.ascontiguousarray(part, dtype=np.float32) for part in parts]

    def __call__(self, *coordinates_m: npt.ArrayLike) -> Float32s:
        """The field at D coordinate arrays (metres, one shape), float32 of that shape."""
        # Reading a configuration imports this module; only making frames needs numba.
        from .kernels import sum_waves

        axes = np.array(coordinates_m, dtype=np.float32)
        total: Float32s = sum_waves(axes.reshape(len(axes), -1), *self._waves)
        return total.reshape(axes.shape[1:])
