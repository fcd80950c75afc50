"""Random fields of the seabed: waves that can be asked for anywhere, and periodic noise pictures.

`Waves` give the shape of the ground (smooth, exact at every point, so two views of one spot agree);
`tiles` give fine relief and colour, looked up as fast as a picture can be resampled.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from simnfnd.factory.seeds import stream

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
        axes = [np.asarray(axis, dtype=np.float32) for axis in coordinates_m]
        total = np.zeros_like(axes[0])
        for vector, phase, amplitude in zip(
            self.vectors, self.phases, self.amplitudes, strict=True
        ):
            angle = np.full_like(total, phase)
            for axis, rate in zip(axes, vector, strict=True):
                angle += np.float32(rate) * axis
            total += np.float32(amplitude) * np.sin(angle)
        return total


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


def dot(a: Floats, b: Floats) -> Floats:
    """Scalar products of (..., 3) vectors; BLAS-free, so the same on any number of threads."""
    return np.asarray(a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2])


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

    texture: (S, S, 4) broad clouds, fine grain, cells (dark seams between lumps), speckle.
    slope: (S, S, 2) gradient of a rough surface, for the light on detail too fine for the mesh.
    rock, sand: (S, S) relief, mean 0.
    caustics: (S, S) brightness of sunlight focused by waves, mean 1.
    """

    texture: Floats
    slope: Floats
    rock: Floats
    sand: Floats
    caustics: Floats


def lookup(
    tile: Floats,
    u_m: Arrays,
    v_m: Arrays,
    period_m: float,
) -> Floats:
    """Values of a periodic `tile`, one period every `period_m`, at (H, W) coordinates."""
    # OpenCV keeps pixel coordinates in 16 bits, so wrap them before it does.
    u, v = (np.asarray(axis, dtype=np.float32) * np.float32(1 / period_m) for axis in (u_m, v_m))
    u, v = ((axis - np.floor(axis)) * np.float32(tile.shape[0]) for axis in (u, v))
    return np.asarray(cv2.remap(tile, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP))


def wrapped(
    tile: Floats, points_m: Floats, normals: Floats, period_m: float, offset_m: tuple[float, float]
) -> Floats:
    """Values of a tile on surfaces of any direction: (H, W) or (H, W, channels).

    The tile is laid on from the three axes and mixed by the normal, so nothing is stretched.
    """
    total = np.zeros((*points_m.shape[:2], *tile.shape[2:]), dtype=np.float32)
    for share, (a, b) in zip(_shares(normals), _PLANES, strict=True):
        values = lookup(
            tile, points_m[..., a] + offset_m[0], points_m[..., b] + offset_m[1], period_m
        )
        total += values * share.reshape(share.shape + (1,) * (tile.ndim - 2))
    return total


@dataclass(frozen=True, eq=False)
class Unwrapped:
    """Plane coordinates of surfaces of any direction, to look up many tiles at the same points.

    Where `wrapped` mixes the three axes, this picks one for each pixel, by chance in proportion.

    axis: (H, W) uint8, the axis that the tile is laid on from.  u_m, v_m: (H, W).
    """

    axis: npt.NDArray[np.uint8]
    u_m: Floats
    v_m: Floats

    def __call__(self, tile: Floats, period_m: float) -> Floats:
        """Values of a tile, (H, W) or (H, W, channels)."""
        return lookup(tile, self.u_m, self.v_m, period_m)

    def gradient(self, tile: Floats, period_m: float) -> Floats:
        """(H, W, 3) world gradient of a rough surface from a (S, S, 2) tile of its slopes."""
        slope = lookup(tile, self.u_m, self.v_m, period_m)
        along_u, along_v = slope[..., 0], slope[..., 1]
        zero = np.float32(0)
        return np.stack(
            [
                np.where(self.axis == 0, zero, along_u),
                np.where(self.axis == 0, along_u, np.where(self.axis == 1, zero, along_v)),
                np.where(self.axis == 2, zero, along_v),
            ],
            axis=-1,
        )


def unwrap(points_m: Floats, normals: Floats, offset_m: tuple[float, float]) -> Unwrapped:
    """Choose the axis of each pixel; the chance is a fixed pattern of pixels, so it repeats."""
    x, y, _ = _shares(normals)
    height, width = x.shape
    repeat = (-(-height // TILE), -(-width // TILE))
    chance = np.tile(_dither(), repeat)[:height, :width]
    axis = np.where(chance < x, np.uint8(0), np.where(chance < x + y, np.uint8(1), np.uint8(2)))
    u = np.where(axis == 0, points_m[..., 1], points_m[..., 0]) + np.float32(offset_m[0])
    v = np.where(axis == 2, points_m[..., 1], points_m[..., 2]) + np.float32(offset_m[1])
    return Unwrapped(axis, u, v)


@functools.cache
def _dither() -> Floats:
    return stream(WORLD_SEED, "seabed", "dither").random((TILE, TILE), dtype=np.float32)


_PLANES = ((1, 2), (0, 2), (0, 1))


def _shares(normals: Floats) -> tuple[Floats, Floats, Floats]:
    x, y, z = (np.square(np.square(normals[..., k])) for k in range(3))
    total = np.maximum(x + y + z, 1e-12)
    return x / total, y / total, z / total


@functools.cache
def tiles() -> Tiles:
    """The noise pictures, drawn once a process; every location uses them at its own offset."""
    rng = stream(WORLD_SEED, "seabed", "tiles")
    broad, fine = _fractal(rng, 2, 64, 1.3), _fractal(rng, 24, 400, 0.5)
    cells, speckle = _cells(rng, 700), _fractal(rng, 60, 500, 0.0)
    rough = 0.5 * _cells(rng, 1100) + 0.7 * _fractal(rng, 12, 300, 0.9)
    gradient = np.stack([_difference(rough, 1), _difference(rough, 0)], axis=-1)
    ridged = _unit(-np.abs(_fractal(rng, 3, 80, 1.0)))
    rock = _unit(ridged + 0.6 * _fractal(rng, 3, 160, 0.9) + 0.35 * _cells(rng, 500))
    sand = _unit(_fractal(rng, 6, 120, 0.9))
    return Tiles(
        np.ascontiguousarray(np.stack([broad, fine, cells, speckle], axis=-1)),
        np.ascontiguousarray(gradient / gradient.std()),
        rock,
        sand,
        _caustics(rng),
    )


def _fractal(
    rng: np.random.Generator, fewest_cycles: float, most_cycles: float, roughness: float
) -> Floats:
    """Periodic spectral noise whose amplitude goes as frequency ** -(1 + roughness)."""
    frequency = np.hypot(np.fft.fftfreq(TILE)[:, None], np.fft.rfftfreq(TILE)[None]) * TILE
    band = (frequency >= fewest_cycles) & (frequency <= most_cycles)
    gain = np.where(band, np.maximum(frequency, 1) ** -(1 + roughness), 0)
    white = np.fft.rfft2(rng.standard_normal((TILE, TILE), dtype=np.float32))
    return _unit(np.fft.irfft2(white * gain, s=(TILE, TILE)))


def _cells(rng: np.random.Generator, count: int) -> Floats:
    """Periodic lumps: minus the distance to the nearest of `count` random points."""
    from scipy.spatial import cKDTree  # loads slowly and is needed once a process

    tree = cKDTree(rng.random((count, 2)), boxsize=1.0)
    side = (np.arange(TILE // 2) + 0.5) / (TILE // 2)
    distance, _ = tree.query(np.stack(np.meshgrid(side, side), axis=-1), k=2)
    lumps = np.float32(distance[..., 1] - distance[..., 0])
    large = cv2.resize(np.pad(lumps, 8, mode="wrap"), None, fx=2, fy=2)[16:-16, 16:-16]
    return _unit(np.sqrt(np.maximum(large, 0)))


def _caustics(rng: np.random.Generator) -> Floats:
    """Bright nets: light bunches where a wavy surface focuses it, that is on its fold lines."""
    nets = [np.abs(_fractal(rng, 4, 22, 1.2)) for _ in range(2)]
    bright = np.exp(-np.minimum(nets[0], nets[1]) * 3.2) + 0.5 * np.exp(-1.5 * (nets[0] + nets[1]))
    bright *= np.clip(1 + 0.35 * _fractal(rng, 1, 4, 1.0), 0.2, 2)
    return np.asarray(bright / bright.mean(), dtype=np.float32)


def _difference(field: Floats, axis: int) -> Floats:
    return np.asarray((np.roll(field, -1, axis) - np.roll(field, 1, axis)) * 0.5)


def _unit(field: Arrays) -> Floats:
    return np.asarray((field - field.mean()) / field.std(), dtype=np.float32)
