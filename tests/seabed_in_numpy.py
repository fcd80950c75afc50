"""What the compiled passes of the procedural seabed compute, in plain numpy."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from simnfnd.factory.scenes.seabed.fields import STEPS, Floats, dither, smoothstep, tiles
from simnfnd.factory.scenes.seabed.photo import Scene
from simnfnd.factory.scenes.seabed.rasterizer import Hits, lens_of


def channels(words: npt.NDArray[np.int32]) -> Floats:
    """(..., 4) of packed channels, in standard deviations."""
    parts = [(words >> (8 * k) & 255).astype(np.uint8).view(np.int8) for k in range(4)]
    return np.stack(parts, axis=-1) * np.float32(1 / STEPS)


def between(tile: npt.NDArray[Any], u: Floats, v: Floats, period_m: float) -> Floats:
    """(N,) or (N, C) values of a periodic tile between its pixels."""
    side = tile.shape[0]
    where = []
    for axis_m in (u, v):
        turns = axis_m * np.float32(1 / period_m)
        where.append((turns - np.floor(turns)) * np.float32(side))
    (x, y), (left, top) = where, (part.astype(np.int64) for part in where)
    right, down = (part.reshape(-1, *[1] * (tile.ndim - 2)) for part in (x - left, y - top))
    left, top, beside, below = (k % side for k in (left, top, left + 1, top + 1))
    upper = tile[top, left] * (1 - right) + tile[top, beside] * right
    lower = tile[below, left] * (1 - right) + tile[below, beside] * right
    return np.asarray(upper * (1 - down) + lower * down, np.float32)


def plain_colour(scene: Scene, hits: Hits, lit: Floats, free: Floats) -> Floats:
    """(H, W, 3) what `colour_loops.photograph` makes of a view."""
    water, palette = scene.water, scene.palette.table
    height, width = hits.depth_m.shape
    fx, fy, cx, cy = lens_of(scene.optics)
    y0, x0 = np.meshgrid((np.arange(height) - cy) / fy, (np.arange(width) - cx) / fx, indexing="ij")
    toward = np.einsum("ij,hwj->hwi", scene.where.rotation, np.dstack([x0, y0, np.ones_like(x0)]))
    length = np.sqrt(1 + x0**2 + y0**2)
    seen = hits.depth_m * length < 3 * water.clear_m
    depth = np.where(seen, hits.depth_m, 0)
    near = np.where(seen, depth * length, 200.0)
    glow = 0.72 + 0.9 * np.clip(toward[..., 2] / length + 0.35, 0, 1) ** 2
    points = scene.where.eye + depth[..., None] * toward
    # The tile is laid on from one axis, by chance in proportion to the normal.
    shares = hits.normals.astype(np.float64) ** 4
    rows, columns = np.indices(depth.shape)
    chance = dither()[rows & 1023, columns & 1023] * shares.sum(axis=-1)
    first, second = shares[..., 0], shares[..., 0] + shares[..., 1]
    axis = np.where(chance < first, 0, np.where(chance < second, 1, 2))
    u = np.where(axis == 0, points[..., 1], points[..., 0]) + scene.offset_m[0]
    v = np.where(axis == 2, points[..., 1], points[..., 2]) + scene.offset_m[1]
    noise = tiles()
    found = between(channels(noise.texture), u.ravel(), v.ravel(), 3.7).reshape(*depth.shape, 4)
    broad, grain, cells, speckle = np.moveaxis(found, -1, 0)
    side = len(noise.fine)
    at = [(((k / 0.7) % 1) * side).astype(np.int64) % side for k in (v, u)]
    close_by, rough = (0.8 * channels(noise.fine[..., k])[at[0], at[1]] for k in range(2))
    fine_broad, fine_grain, fine_cells, fine_speckle = np.moveaxis(close_by, -1, 0)
    close = np.clip(1.25 - hits.depth_m / 9, 0, 1)
    sand, gravelly, bare, algae, growth = palette
    # Ground.
    tone, turf = hits.base[..., 2], scene.palette.turf
    rock = smoothstep(0.3, 0.7, hits.base[..., 0] + 0.22 * grain * close + 0.1 * cells)
    gravel = smoothstep(0.35, 0.65, hits.base[..., 1] + 0.18 * cells)
    fine = 0.06 * fine_grain + 0.05 * fine_speckle + 0.03 * speckle
    sand_shade = 1 + 0.07 * broad + 0.07 * tone + close * fine
    gravel_shade = 1 + 0.1 * broad + 0.16 * tone + close * (0.22 * fine_cells + 0.1 * speckle)
    grown = smoothstep(0.9 - 1.6 * turf, 1.7 - 1.6 * turf, broad + 0.5 * cells)
    crust = smoothstep(0.9, 1.5, fine_broad + 0.4 * speckle) * (1 - 0.6 * grown) * 0.7
    rock_shade = 1 + 0.14 * tone + 0.12 * grain + close * (0.14 * fine_cells + 0.12 * fine_grain)
    rock_shade = rock_shade * (0.75 + 0.5 * smoothstep(-2.0, 1.2, tone))

    def mixed(one: Any, other: Any, share: Any) -> Any:
        return one + share[..., None] * (other - one)

    stone = mixed(mixed(bare, algae, grown), growth, crust) * rock_shade[..., None]
    loose = mixed(sand * sand_shade[..., None], gravelly * gravel_shade[..., None], gravel)
    albedo = mixed(loose, stone, rock)
    bump = 0.1 + 0.35 * gravel + rock * (0.5 - 0.35 * gravel)
    # Objects.
    finish = scene.finishes[np.maximum(hits.owner, 1) - 1]
    fouling, silt, uneven = np.moveaxis(finish, -1, 0)
    patchy = 0.6 * broad + 0.5 * cells + 0.4 * fine_broad
    grown = smoothstep(0.0, 0.9, patchy + 2.2 * fouling - 1.3) * 0.85
    crust = smoothstep(1.0, 1.5, fine_broad + 0.5 * speckle) * np.minimum(1.5 * fouling, 0.8)
    dusted = smoothstep(0.45, 0.95, hits.normals[..., 2] + 0.12 * grain + 0.1 * broad) * silt
    shade = 1 + 0.1 * grain + close * (0.1 * fine_grain + 0.1 * fine_cells)
    tint = mixed(mixed(hits.base, algae, grown), growth, crust) * shade[..., None]
    thing = hits.owner > 0
    dust = sand * 0.8 * (1 + 0.07 * fine_grain)[..., None]
    albedo = np.clip(np.where(thing[..., None], mixed(tint, dust, dusted), albedo), 0.01, 0.95)
    bump = np.where(thing, uneven * 0.55 * (1 - 0.5 * dusted), bump) * (0.25 + 0.75 * close)
    # Light.
    zero, along_u, along_v = np.zeros_like(u), rough[..., 0], rough[..., 1]
    slope = np.stack(
        [
            np.where(axis == 0, zero, along_u),
            np.where(axis == 0, along_u, np.where(axis == 1, zero, along_v)),
            np.where(axis == 2, zero, along_v),
        ],
        axis=-1,
    )
    normals = hits.normals.astype(np.float64)
    level = slope - (slope * normals).sum(axis=-1, keepdims=True) * normals
    normals = normals - bump[..., None] * level
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-6)

    def spread(halves: Floats) -> Any:
        wider = np.pad(halves, ((0, 1), (0, 1)), mode="edge").astype(np.float64)
        rows_at, columns_at = np.arange(height) / 2, np.arange(width) / 2
        return ndimage.map_coordinates(
            wider, np.meshgrid(rows_at, columns_at, indexing="ij"), order=1
        )

    sun = np.array(water.sun_direction)
    bright = np.maximum(normals @ sun, 0) * spread(lit)
    net_at = (points[..., :2] - points[..., 2:] * sun[:2] / sun[2]) / water.caustic_period_m
    pixel = ((net_at % 1) * len(noise.caustics)).astype(np.int64) % len(noise.caustics)
    bright *= 1 + water.caustics * (noise.caustics[pixel[..., 1], pixel[..., 0]] - 1)
    room = spread(free)
    above = room * (0.55 + 0.45 * normals[..., 2])
    facing = np.maximum(-(normals * toward).sum(axis=-1) / length, 0)
    beam = np.exp((1 - length) / 0.11) / np.maximum(near, 0.5) ** 2
    lamp = facing * (0.4 + 0.6 * room) * beam
    fade = np.exp(-near[..., None] * np.array(water.fade_per_m))
    haze = 1 - np.exp(-near[..., None] * np.array(water.veil_per_m))
    coming = bright[..., None] * water.sun + above[..., None] * water.sky
    coming = (coming + lamp[..., None] * water.lamp * fade) * seen[..., None]
    return np.asarray(albedo * coming * fade + np.array(water.veil) * haze * glow[..., None])
