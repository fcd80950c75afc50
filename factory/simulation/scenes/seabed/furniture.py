"""Walls of tanks, and fittings: ropes, rails, hoses and the like, which are no objects to be found.

Meshes rest on z = 0 and draw their own size and colours.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ....common.array_types import Draws
from ...meshes.triangle_mesh import Mesh, bars, box, circle, join, lathe, sheet, tube
from .terrain import pick
from .things import CONCRETE, PAINTS, RUST, STEEL, curve

_WALL_M = 0.25
_COLOURS = (*CONCRETE, *PAINTS[3:5], STEEL)
_METALS = (RUST, STEEL, *PAINTS[:3])


def square_walls(rng: Draws, half_sides_m: tuple[float, float], height_m: float) -> Mesh:
    """Four walls around the origin, of smooth concrete or steel, with a joint here and there."""
    half_x, half_y = half_sides_m
    colour = pick(rng, _COLOURS)
    parts = []
    for side in (-1.0, 1.0):
        middle = half_y + _WALL_M / 2
        size = (2 * half_x + 2 * _WALL_M, _WALL_M, height_m + 0.5)
        parts.append(box(size, (0, side * middle, height_m / 2 - 0.25), colour))
        middle = half_x + _WALL_M / 2
        size = (_WALL_M, 2 * half_y + 2 * _WALL_M, height_m + 0.5)
        parts.append(box(size, (side * middle, 0, height_m / 2 - 0.25), colour))
    for _ in range(int(rng.integers(0, 5))):
        side = float(rng.choice([-1.0, 1.0]))
        x = rng.uniform(-half_x, half_x)
        joint = ((x, side * (half_y - 0.01), 0.0), (x, side * (half_y - 0.01), height_m))
        parts.append(bars([joint], rng.uniform(0.01, 0.04), 6).tinted(colour * 0.8))
    return join(parts)


def round_wall(rng: Draws, radius_m: float, height_m: float) -> Mesh:
    """The wall of a round basin around the origin, seen from within."""
    colour = pick(rng, _COLOURS)
    angle = np.linspace(0, 2 * np.pi, 65)
    levels = np.linspace(-0.5, height_m, 6)
    grid_angle, grid_level = np.meshgrid(angle, levels, indexing="ij")
    x = radius_m * np.cos(grid_angle)
    y = radius_m * np.sin(grid_angle)
    return sheet(np.stack([x, y, grid_level], axis=-1), colour)


class Fitting(NamedTuple):
    """A fitting, and whether its place is at a wall."""

    mesh: Mesh
    stands_at_wall: bool = False


def drawn_fitting(rng: Draws) -> Fitting:
    """A fitting of a kind chosen at random."""
    builders: tuple[Callable[[Draws], Fitting], ...] = (
        _rope,
        _hanging_rope,
        _hose,
        _ladder,
        _rail,
        _weight,
        _stand,
        _plate,
        _grid,
    )
    builders += (_bits, _bits, _bits)
    return builders[int(rng.integers(len(builders)))](rng)


def _rope(rng: Draws) -> Fitting:
    """A rope that lies on the floor."""
    line = curve(rng, np.zeros(2), rng.uniform(0.6, 3.0), 1.2)
    radius = rng.uniform(0.004, 0.015)
    path = np.column_stack([line, np.full(len(line), radius)])
    return Fitting(tube(path, radius, 6, colour=pick(rng, PAINTS)))


def _hanging_rope(rng: Draws) -> Fitting:
    """A rope or cable from above, upright or slack, whose end may float above the floor."""
    levels = np.linspace(rng.choice([0.0, 0.0, rng.uniform(0.2, 0.8)]), 3.0, 24)
    sway = rng.uniform(0, 0.25) * np.sin(levels * rng.uniform(0.5, 2.0))
    path = np.column_stack([sway, np.zeros_like(sway), levels])
    return Fitting(tube(path, rng.uniform(0.004, 0.014), 6, colour=pick(rng, PAINTS)))


def _hose(rng: Draws) -> Fitting:
    """A hose, coiled or laid out."""
    radius = rng.uniform(0.012, 0.035)
    colour = pick(rng, PAINTS)
    if rng.random() < 0.5:
        line = curve(rng, np.zeros(2), rng.uniform(1.0, 3.5), 0.8)
        return Fitting(tube(np.column_stack([line, np.full(len(line), radius)]), radius, 8,
                            colour=colour))  # fmt: skip
    turns = rng.uniform(1.5, 4.0)
    angle = np.linspace(0, 2 * np.pi * turns, int(40 * turns))
    reach = rng.uniform(0.15, 0.4) * (1 + 0.04 * angle)
    level = radius + 0.3 * radius * angle / np.pi
    path = np.column_stack([reach * np.cos(angle), reach * np.sin(angle), level])
    return Fitting(tube(path, radius, 8, colour=colour))


def _ladder(rng: Draws) -> Fitting:
    """A ladder of two rails and rungs, upright."""
    half = rng.uniform(0.15, 0.3)
    height = rng.uniform(1.5, 3.0)
    rails = [((side * half, 0, 0), (side * half, 0, height)) for side in (-1, 1)]
    levels = np.arange(0.2, height, rng.uniform(0.22, 0.35))
    rungs = [((-half, 0, level), (half, 0, level)) for level in levels]
    radius = rng.uniform(0.012, 0.025)
    return Fitting(bars([*rails, *rungs], radius, 6).tinted(pick(rng, _METALS)), True)


def _rail(rng: Draws) -> Fitting:
    """A bar along the floor on low feet."""
    half = rng.uniform(0.4, 1.6)
    level = rng.uniform(0.03, 0.4)
    feet = [((x, 0, 0), (x, 0, level)) for x in (-half, 0, half)]
    bar = ((-half, 0, level), (half, 0, level))
    return Fitting(bars([bar, *feet], rng.uniform(0.012, 0.03), 7).tinted(pick(rng, _METALS)),
                   bool(rng.random() < 0.5))  # fmt: skip


def _weight(rng: Draws) -> Fitting:
    """A block or a disc that holds something down."""
    colour = pick(rng, (*CONCRETE, RUST))
    size = rng.uniform([0.08, 0.08, 0.04], [0.35, 0.3, 0.2])
    if rng.random() < 0.5:
        return Fitting(box(size.tolist(), (0, 0, size[2] / 2), colour))
    profile = np.array([[0, 0], [0.5, 0], [0.5, 1], [0, 1]]) * [size[0], size[2]]
    return Fitting(lathe(profile, 24, colour, crease=True))


def _stand(rng: Draws) -> Fitting:
    """A stand of three or four legs with a ring."""
    count = int(rng.integers(3, 5))
    foot = circle(count) * rng.uniform(0.2, 0.5)
    top = foot * rng.uniform(0.3, 1.0) + [0, 0, rng.uniform(0.3, 1.0)]
    ends = [*zip(foot, top, strict=True), *zip(top, np.roll(top, 1, axis=0), strict=True)]
    return Fitting(bars(ends, rng.uniform(0.01, 0.025), 7).tinted(pick(rng, _METALS)))


def _plate(rng: Draws) -> Fitting:
    """A plate, flat or leaning."""
    size = rng.uniform([0.25, 0.2, 0.008], [0.9, 0.6, 0.03])
    plate = box(size.tolist(), (0, 0, 0), pick(rng, _COLOURS))
    return Fitting(plate.turned("x", rng.choice([0.0, 0.0, 1.0, 1.3])).standing())


def _bits(rng: Draws) -> Fitting:
    """A few small hard things close together: screws, clamps, shells."""
    parts = []
    for _ in range(int(rng.integers(1, 7))):
        size = rng.uniform(0.008, 0.05)
        long = size * rng.uniform(1.0, 6.0)
        bit = box((long, size, size), (0, 0, size / 2)).turned("z", rng.uniform(0, 6.3))
        parts.append(bit.moved((*rng.normal(0, 0.12, 2), 0)))
    return Fitting(join(parts).tinted(pick(rng, _METALS)))


def _grid(rng: Draws) -> Fitting:
    """A grating of bars on the floor."""
    half = rng.uniform(0.2, 0.6)
    steps = np.linspace(-half, half, int(rng.integers(4, 10)))
    ends = [((x, -half, 0.02), (x, half, 0.02)) for x in steps]
    ends += [((-half, y, 0.02), (half, y, 0.02)) for y in (-half, half)]
    return Fitting(bars(ends, rng.uniform(0.006, 0.015), 6).tinted(pick(rng, _METALS)))
