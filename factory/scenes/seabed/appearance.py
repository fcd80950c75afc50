"""Colour and fine roughness of what a view sees: sand, gravel, rock and overgrown objects."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simnfnd.factory.scenes.seabed.casting import Hits
from simnfnd.factory.scenes.seabed.fields import Floats, dot, smoothstep, tiles, unwrap
from simnfnd.factory.scenes.seabed.objects.meshes import Colour
from simnfnd.factory.scenes.seabed.terrain import Terrain


@dataclass(frozen=True)
class Palette:
    """Albedo of a location's ground and growth, red, green, blue."""

    sand: Colour
    gravel: Colour
    rock: Colour
    algae: Colour
    crust: Colour
    turf: float  # how much of the rock is overgrown, 0 to 1


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


@dataclass(frozen=True, eq=False)
class Finishes:
    """(N,) float32 each, by object number: see `kinds.Kind`."""

    fouling: Floats
    silt: Floats
    bump: Floats


def appearance(
    hits: Hits, terrain: Terrain, palette: Palette, finishes: Finishes
) -> tuple[Floats, Floats]:
    """Albedo (H, W, 3) and normals roughened by detail finer than the meshes (H, W, 3)."""
    unwrapped = unwrap(hits.points, hits.normals, terrain.offset_m)
    # Detail that is finer than a pixel would only sparkle: fade it out with distance.
    near = np.clip(1.25 - hits.depth_m / 9, 0.0, 1.0)
    coarse = unwrapped(tiles().texture, 3.7)
    fine = unwrapped(tiles().texture, 0.83)
    slope = unwrapped.gradient(tiles().slope, 1.3)
    albedo, bump = _ground(hits, palette, coarse, fine, near)
    if hits.on_object.any():
        there = hits.on_object
        albedo[there], bump[there] = _objects(
            hits, palette, finishes, coarse[there], fine[there], near[there]
        )
    normals = _roughened(hits.normals, slope, bump * (0.25 + 0.75 * near))
    return albedo, normals


def _ground(
    hits: Hits, palette: Palette, coarse: Floats, fine: Floats, near: Floats
) -> tuple[Floats, Floats]:
    rock, gravel, tone = (hits.ground[..., k] for k in range(3))
    broad, grain, cells, speckle = (coarse[..., k] for k in range(4))
    rock = smoothstep(0.3, 0.7, rock + 0.22 * grain * near + 0.1 * cells)
    gravel = smoothstep(0.35, 0.65, gravel + 0.18 * cells)
    turf = smoothstep(0.9 - 1.6 * palette.turf, 1.7 - 1.6 * palette.turf, broad + 0.5 * cells)
    crust = smoothstep(0.9, 1.5, fine[..., 0] + 0.4 * speckle) * (1 - 0.6 * turf) * 0.7
    sand_shade = 1 + 0.07 * broad + 0.07 * tone
    sand_shade += near * (0.06 * fine[..., 1] + 0.05 * fine[..., 3] + 0.03 * speckle)
    gravel_shade = 1 + 0.10 * broad + 0.16 * tone + near * (0.22 * fine[..., 2] + 0.1 * speckle)
    rock_shade = 1 + 0.14 * tone + 0.12 * grain + near * (0.14 * fine[..., 2] + 0.12 * fine[..., 1])
    # Crevices are dark, edges are worn bright.
    rock_shade *= 0.75 + 0.5 * smoothstep(-2.0, 1.2, tone)
    albedo = np.empty((*rock.shape, 3), dtype=np.float32)
    for k in range(3):
        stone = palette.rock[k] + turf * np.float32(palette.algae[k] - palette.rock[k])
        stone = stone + crust * (np.float32(palette.crust[k]) - stone)
        loose = palette.sand[k] * sand_shade
        loose = loose + gravel * (np.float32(palette.gravel[k]) * gravel_shade - loose)
        albedo[..., k] = loose + rock * (stone * rock_shade - loose)
    bump = 0.10 + 0.35 * gravel + rock * (0.5 - 0.35 * gravel)
    return np.clip(albedo, 0.01, 0.95), bump


def _objects(
    hits: Hits, palette: Palette, finishes: Finishes, coarse: Floats, fine: Floats, near: Floats
) -> tuple[Floats, Floats]:
    """As `_ground`, for the N pixels on objects."""
    there = hits.on_object
    owner, up = hits.owner[there], hits.normals[there][:, 2]
    fouling, silt = finishes.fouling[owner], finishes.silt[owner]
    patchy = 0.6 * coarse[:, 0] + 0.5 * coarse[:, 2] + 0.4 * fine[:, 0]
    grown = smoothstep(0.0, 0.9, patchy + 2.2 * fouling - 1.3) * 0.85
    crust = smoothstep(1.0, 1.5, fine[:, 0] + 0.5 * coarse[:, 3]) * np.minimum(fouling * 1.5, 0.8)
    dusted = smoothstep(0.45, 0.95, up + 0.12 * coarse[:, 1] + 0.1 * coarse[:, 0]) * silt
    shade = 1 + 0.10 * coarse[:, 1] + near * (0.10 * fine[:, 1] + 0.10 * fine[:, 2])
    albedo = hits.colours[there].copy()
    for k in range(3):
        tint = albedo[:, k]
        tint = tint + grown * (np.float32(palette.algae[k]) - tint)
        tint = (tint + crust * (np.float32(palette.crust[k]) - tint)) * shade
        sand = np.float32(palette.sand[k] * 0.8) * (1 + 0.07 * fine[:, 1])
        albedo[:, k] = tint + dusted * (sand - tint)
    bump = finishes.bump[owner] * 0.55 * (1 - 0.5 * dusted)
    return np.clip(albedo, 0.01, 0.95), bump


def _roughened(normals: Floats, gradient: Floats, strength: Floats) -> Floats:
    """Tilt normals against the (H, W, 3) gradient of a rough surface."""
    along = dot(gradient, normals)
    tilted = normals - strength[..., None] * (gradient - along[..., None] * normals)
    length = np.sqrt(dot(tilted, tilted))
    return np.asarray(tilted / np.maximum(length, 1e-6)[..., None], dtype=np.float32)
