"""Random fields of the seabed: waves that can be asked for anywhere, and periodic noise pictures.

`Waves` give the shape of the ground (smooth, exact at every point, so two views of one spot agree);
`tiles` give fine relief and colour, looked up as fast as a picture can be resampled.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ...seeds import stream

Floats = npt.NDArray[np.float32]
Arrays = npt.NDArray[np.floating[Any]]  # any precision

WORLD_SEED = 0  # the procedural world is one and the same; a location number is a place in it
TILE = 1024  # pixels a side of every noise picture


@dataclass(frozen=True, eq=False)
class Waves:
    """A sum of plane waves: a smooth random field with mean 0 and unit variance.

    vectors: (K, D) rad/m.  phases: (K,) rad.  amplitudes: (K,).
    """

    vectors: npt.NDArray[np.float64]
    phases: npt.NDArray[np.float64]
    amplitudes: npt.NDArray[np.float64]

    def __call__(self, *coordinates_m: Arrays) -> Floats:
        """The field at D coordinate arrays (metres, one shape), float32 of that shape."""
        # Reading a configuration imports this module; only making frames needs numba.
        from .kernels import add_waves

        first = np.asarray(coordinates_m[0])
        axes = np.stack([np.asarray(axis, dtype=np.float32).ravel() for axis in coordinates_m])
        total = np.zeros(first.size, dtype=np.float32)
        vectors, phases, amplitudes = self._singles
        add_waves(axes, vectors, phases, amplitudes, total)
        return total.reshape(first.shape)

    @functools.cached_property
    def _singles(self) -> tuple[Floats, Floats, Floats]:
        parts = (self.vectors, self.phases, self.amplitudes)
        vectors, phases, amplitudes = (np.ascontiguousarray(p, dtype=np.float32) for p in parts)
        return vectors, phases, amplitudes


def waves(
    rng: np.random.Generator,
    longest_m: float,
    shortest_m: float,
    roughness: float = 1.0,
    dimensions: int = 2,
    per_octave: int = 5,
) -> Waves:
    """Draw a fractal field with wavelengths from `longest_m` to `shortest_m`.

    roughness: amplitude goes as wavelength ** roughness (1 is a natural landscape, 0 is white).
    """
    octaves = max(np.log2(longest_m / shortest_m), 0.5)
    count = max(round(per_octave * octaves), 3)
    # One wave in each equal step of log wavelength, so that no octave is left out by chance.
    steps = (np.arange(count) + rng.random(count)) / count
    wavelengths = longest_m * (shortest_m / longest_m) ** steps
    directions = rng.standard_normal((count, dimensions))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    amplitudes = wavelengths**roughness
    amplitudes *= np.sqrt(2 / np.sum(amplitudes**2))
    vectors = directions * (2 * np.pi / wavelengths)[:, None]
    return Waves(vectors, rng.uniform(0, 2 * np.pi, count), amplitudes)


def smoothstep(
    low: float | Arrays,
    high: float | Arrays,
    x: Arrays,
) -> Floats:
    """0 below `low`, 1 above `high`, a smooth ramp between."""
    t = np.clip((x - low) / (high - low), 0, 1).astype(np.float32)
    return t * t * (3 - 2 * t)


@dataclass(frozen=True, eq=False)
class Tiles:
    """Noise pictures, TILE pixels a side, that repeat without a seam; each channel has std 1.

    texture: (S / 2, S / 2) int32, four channels of 8 bits, the first the lowest: broad clouds,
    fine grain, cells (dark seams between lumps), speckle, in steps of 1 / STEPS: a picture looks up
    a million places all over it, which must be near, and all channels of one at once.
    rock, sand: (S, S) relief, mean 0.
    """

    texture: npt.NDArray[np.int32]
    rock: Floats
    sand: Floats


@functools.cache
def tiles() -> Tiles:
    """The noise pictures, drawn once a process; every location uses them at its own offset."""
    from .kernels import STEPS

    rng = stream(WORLD_SEED, "seabed", "tiles")
    broad, grain = _fractal(rng, 2, 64, 1.3), _fractal(rng, 24, 400, 0.5)
    cells, speckle = _cells(rng, 26), _fractal(rng, 60, 500, 0.0)
    ridged = _unit(-np.abs(_fractal(rng, 3, 80, 1.0)))
    rock = _unit(ridged + 0.6 * _fractal(rng, 3, 160, 0.9) + 0.35 * _cells(rng, 22))
    sand = _unit(_fractal(rng, 6, 120, 0.9))
    words = np.zeros((TILE // 2, TILE // 2), dtype=np.uint32)
    for k, channel in enumerate((broad, grain, cells, speckle)):
        steps = (
            np.clip(np.rint(channel[::2, ::2] * STEPS), -127, 127).astype(np.int8).view(np.uint8)
        )
        words |= steps.astype(np.uint32) << np.uint32(8 * k)
    return Tiles(words.view(np.int32), rock, sand)


def _fractal(
    rng: np.random.Generator, fewest_cycles: float, most_cycles: float, roughness: float
) -> Floats:
    """Periodic spectral noise whose amplitude goes as frequency ** -(1 + roughness)."""
    frequency = np.hypot(np.fft.fftfreq(TILE)[:, None], np.fft.rfftfreq(TILE)[None]) * TILE
    band = (frequency >= fewest_cycles) & (frequency <= most_cycles)
    gain = np.where(band, np.maximum(frequency, 1) ** -(1 + roughness), 0)
    white = np.fft.rfft2(rng.standard_normal((TILE, TILE), dtype=np.float32))
    return _unit(np.fft.irfft2(white * gain, s=(TILE, TILE)))


def _cells(rng: np.random.Generator, across: int) -> Floats:
    """Periodic lumps: how much nearer the nearest of across x across scattered points is."""
    side = TILE // 2
    scattered = rng.random((across, across, 2), dtype=np.float32)  # one in each square of a grid
    at = (np.arange(side, dtype=np.float32) + np.float32(0.5)) * np.float32(across / side)
    own = at.astype(np.int64)
    first, second = (np.full((side, side), np.inf, np.float32) for _ in range(2))
    for down in (-2, -1, 0, 1, 2):
        for right in (-2, -1, 0, 1, 2):
            point = scattered[((own + down) % across)[:, None], (own + right) % across]
            dy = point[..., 0] + (own + down - at).astype(np.float32)[:, None]
            dx = point[..., 1] + (own + right - at).astype(np.float32)
            apart = dx * dx + dy * dy
            second = np.minimum(second, np.maximum(first, apart))
            first = np.minimum(first, apart)
    lumps = np.sqrt(second) - np.sqrt(first)
    for axis in (0, 1):  # twice as fine: each new value a quarter of a pixel from an old one
        sides = [0.75 * lumps + 0.25 * np.roll(lumps, turn, axis) for turn in (1, -1)]
        shape = (TILE, side) if axis == 0 else (TILE, TILE)
        lumps = np.stack(sides, axis=axis + 1).reshape(shape)
    return _unit(np.sqrt(np.maximum(lumps, 0)))


def _unit(field: Arrays) -> Floats:
    return np.asarray((field - field.mean()) / field.std(), dtype=np.float32)
