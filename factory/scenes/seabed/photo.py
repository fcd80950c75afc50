"""From a view's hits to its colour picture: light, shade, water, lens and sensor."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING

import cv2
import numpy as np
import numpy.typing as npt

from simnfnd.factory.scenes.seabed.casting import Hits, blocked, rays_from
from simnfnd.factory.scenes.seabed.fields import TILE, WORLD_SEED, Floats, dot, lookup, tiles
from simnfnd.factory.scenes.seabed.water import Water, seen_through
from simnfnd.factory.seeds import stream

if TYPE_CHECKING:
    from open3d.t.geometry import RaycastingScene

_OCCLUSION_REACH_M = 0.45


def photograph(
    rng: np.random.Generator,
    hits: Hits,
    albedo: Floats,
    normals: Floats,
    toward: Floats,
    water: Water,
    scenes: tuple[RaycastingScene, ...],
) -> npt.NDArray[np.uint8]:
    """The (H, W, 3) picture; scenes are what casts shadows."""
    distance = np.sqrt(dot(toward, toward))
    range_m = hits.depth_m * distance
    seen = range_m < 3 * water.clear_m
    # Clear of the surface's own facets, which are coarser far away, or they would shade themselves.
    lift = 0.004 + 0.004 * np.minimum(hits.depth_m, np.float32(20))
    start = hits.points + lift[..., None] * hits.normals
    sun = np.asarray(water.sun_direction, dtype=np.float32)
    lit = _lit(scenes, start, sun, seen)
    facing_sun = np.maximum(dot(normals, sun), 0) * lit
    if water.caustics > 0:
        facing_sun *= _caustics(hits.points, sun, water)
    open_above = _openness(scenes, start, hits.normals, seen)
    facing_up = open_above * (0.55 + 0.45 * normals[..., 2])
    facing_lamp = np.zeros_like(facing_up)
    if any(water.lamp):
        facing_lamp = -dot(normals, toward) / distance
        facing_lamp = np.maximum(facing_lamp, 0) * (0.4 + 0.6 * open_above) * _beam(distance)
    upward = toward[..., 2] / distance
    glow = np.asarray(0.72 + 0.9 * np.clip(upward + 0.35, 0, 1) ** 2, dtype=np.float32)
    colour = seen_through(
        water,
        albedo,
        facing_sun,
        facing_up,
        np.asarray(facing_lamp, dtype=np.float32),
        np.where(seen, range_m, np.float32(np.inf)),
        glow,
    )
    _add_motes(rng, colour, water)
    # The camera sets its black level on the haze, as far as the haze has one colour.
    veil = np.asarray(water.veil, dtype=np.float32) / max(water.veil)
    haze = np.percentile(colour[::4, ::4].max(axis=-1), 1)
    return develop(rng, np.maximum(colour - np.float32(0.6 * haze) * veil, 0))


def _lit(
    scenes: tuple[RaycastingScene, ...], start: Floats, sun: Floats, seen: npt.NDArray[np.bool_]
) -> Floats:
    """1 where sunlight arrives; at half resolution, because water scatters light into shadows."""
    rays = rays_from(np.ascontiguousarray(start[::2, ::2]), sun)
    dark = ~seen[::2, ::2]
    for scene in scenes:
        dark |= blocked(scene, rays, 12.0)
    return _enlarged((~dark).astype(np.float32), seen.shape)


def _enlarged(half: Floats, shape: tuple[int, ...]) -> Floats:
    """A picture of every second pixel back at full size."""
    where_x = np.arange(shape[1], dtype=np.float32) / 2
    where_y = np.arange(shape[0], dtype=np.float32) / 2
    grid = np.meshgrid(where_x, where_y)
    full = cv2.remap(half, grid[0], grid[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(full)


@functools.cache
def _cap(count: int) -> Floats:
    """(count, 3) unit directions spread evenly over the upper half of a sphere about +z."""
    k = np.arange(count)
    z = 1 - (k + 0.5) / count * 0.93
    turn = k * np.pi * (3 - np.sqrt(5))
    flat = np.sqrt(1 - z**2)
    cap = np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=-1)
    return np.asarray(cap, dtype=np.float32)


def _openness(
    scenes: tuple[RaycastingScene, ...],
    start: Floats,
    normals: Floats,
    seen: npt.NDArray[np.bool_],
) -> Floats:
    """Share of the near surroundings that is open, (H, W): dark in corners and under things.

    Each pixel of a 4 x 4 patch looks another way, and a blur joins them.
    """
    small = start[::2, ::2], normals[::2, ::2], seen[::2, ::2]
    rows, columns = small[2].shape
    pattern = np.arange(16).reshape(4, 4)
    which = np.tile(pattern, (rows // 4 + 1, columns // 4 + 1))[:rows, :columns]
    free = np.zeros((rows, columns), dtype=np.float32)
    picks = 2
    for turn in range(picks):
        toward = _cap(16 * picks)[which * picks + turn] + np.float32(0.9) * small[1]
        rays = rays_from(small[0], toward)
        dark = np.zeros((rows, columns), dtype=bool)
        for scene in scenes:
            dark |= blocked(scene, rays, _OCCLUSION_REACH_M)
        free += (~dark).astype(np.float32)
    blurred: Floats = cv2.blur(free / picks, (4, 4)).astype(np.float32, copy=False)
    return _enlarged(blurred, seen.shape)


def _caustics(points: Floats, sun: Floats, water: Water) -> Floats:
    """Brightness of the sun's light, mean 1: nets of light that follow the sun's rays down."""
    x = points[..., 0] - points[..., 2] * (sun[0] / sun[2])
    y = points[..., 1] - points[..., 2] * (sun[1] / sun[2])
    net = lookup(tiles().caustics, x, y, water.caustic_period_m)
    return np.asarray(1 + np.float32(water.caustics) * (net - 1))


def _beam(distance: Floats) -> Floats:
    """A lamp's beam: bright in the middle of the picture."""
    return np.asarray(np.exp(-((distance - 1) / 0.11)), dtype=np.float32)


def _add_motes(rng: np.random.Generator, colour: Floats, water: Water) -> None:
    """Specks that drift before the lens, out of focus."""
    height, width = colour.shape[:2]
    for _ in range(int(rng.integers(0, water.motes + 1))):
        radius = float(rng.uniform(0.6, 2.6)) * width / 968
        x, y = rng.uniform(0, width), rng.uniform(0, height)
        reach = int(3 * radius) + 1
        left, top = max(int(x) - reach, 0), max(int(y) - reach, 0)
        patch = colour[top : int(y) + reach + 1, left : int(x) + reach + 1]
        dy = np.arange(top, top + patch.shape[0])[:, None] - y
        dx = np.arange(left, left + patch.shape[1])[None, :] - x
        spot = np.exp(-(dx**2 + dy**2) / (2 * radius**2)) * rng.uniform(0.02, 0.14)
        patch += (spot[..., None] * (np.asarray(water.veil) + 0.25)).astype(np.float32)


def develop(rng: np.random.Generator, colour: Floats) -> npt.NDArray[np.uint8]:
    """Lens blur and vignette, exposure, sensor noise and sRGB-like gamma."""
    height, width = colour.shape[:2]
    colour = np.asarray(cv2.GaussianBlur(colour, (0, 0), 0.55), dtype=np.float32)
    y = np.linspace(-1, 1, height, dtype=np.float32)[:, None] ** 2
    x = np.linspace(-1, 1, width, dtype=np.float32)[None, :] ** 2
    colour *= (1 - 0.16 * (x + y))[..., None]
    # Exposure: the bright parts of the picture fill most of the scale, whatever the water.
    bright = np.percentile(colour[::4, ::4].max(axis=-1), 97)
    colour *= np.float32(rng.uniform(0.68, 0.92)) / max(float(bright), 1e-3)
    dx, dy = rng.integers(0, TILE, 2)
    noise = _sensor_noise()
    noise = np.roll(noise, (int(dy), int(dx)), axis=(0, 1))
    repeat = (-(-height // TILE), -(-width // TILE), 1)
    noise = np.tile(noise, repeat)[:height, :width] if max(repeat) > 1 else noise[:height, :width]
    colour += np.sqrt(np.maximum(colour, 0) * 2.2e-4 + 4e-6) * noise
    colour = colour / (1 + np.maximum(colour - 0.75, 0))  # highlights roll off, they do not clip
    levels = np.clip(colour * 4095, 0, 4095).astype(np.uint16)
    return _gamma()[levels]


@functools.cache
def _gamma() -> npt.NDArray[np.uint8]:
    level = np.arange(4096) / 4095
    return np.asarray(np.round(255 * level ** (1 / 2.2)), dtype=np.uint8)


@functools.cache
def _sensor_noise() -> Floats:
    rng = stream(WORLD_SEED, "seabed", "sensor")
    return rng.standard_normal((TILE, TILE, 3), dtype=np.float32)
