"""Things that fit their place: chains and pipes along the ground, piles, braces and quay walls.

`chain` and `pipe` take the ground height as a function of (x, y) and come in world coordinates.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from ..fields import Floats, smoothstep
from .debris import PAINTS, RUST, STEEL, pick, tire
from .meshes import (
    Mesh,
    box,
    join,
    mesh,
    rotation,
    rough,
    tube,
)
from .structures import CONCRETE, tinted

Points = npt.NDArray[np.float64]
GroundHeight = Callable[[Points, Points], Floats]


def curve(rng: np.random.Generator, start: Points, length_m: float, wander: float) -> Points:
    """(N, 2) points every 5 cm from `start` along a heading that wanders."""
    count = max(int(length_m / 0.05), 8)
    turns = np.interp(np.arange(count), np.linspace(0, count, 9), rng.normal(0, wander, 9))
    heading = rng.uniform(0, 2 * np.pi) + np.cumsum(turns * 0.05)
    steps = 0.05 * np.column_stack([np.cos(heading), np.sin(heading)])
    return np.asarray(start + np.cumsum(steps, axis=0) - steps.sum(axis=0) / 2)


def chain(rng: np.random.Generator, line: Points, ground: GroundHeight) -> Mesh:
    """Studless links along a line on the ground, every second one on edge."""
    wire = float(rng.uniform(0.016, 0.04))
    pitch, metal = wire * 3.9, pick(rng, (RUST, RUST, STEEL))
    bend = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    flat = np.column_stack(
        [1.5 * wire * np.cos(bend) + 1.25 * wire * np.sign(np.cos(bend)), 1.3 * wire * np.sin(bend)]
    )
    link = tube(np.column_stack([flat, np.zeros(16)]), wire / 2, 7, closed=True, colour=metal)
    where = np.arange(0, 0.05 * (len(line) - 1), pitch) / 0.05
    steps = np.arange(len(line))
    x, y = np.interp(where, steps, line[:, 0]), np.interp(where, steps, line[:, 1])
    z = np.asarray(ground(x, y), dtype=np.float64) + 0.6 * wire
    heading = np.arctan2(np.gradient(y), np.gradient(x))
    climb = np.arctan2(np.gradient(z), pitch)
    links = []
    for k in range(len(where)):
        roll = (np.pi / 2 if k % 2 else 0.0) + rng.normal(0, 0.25)
        turn = rotation("z", heading[k]) @ rotation("y", -climb[k]) @ rotation("x", roll)
        links.append(link.moved(turn, (x[k], y[k], z[k])))
    return join(links)


def pipe(rng: np.random.Generator, line: Points, ground: GroundHeight) -> Mesh:
    """A pipe along a line, part buried, bridging hollows, with flanges."""
    radius = float(rng.uniform(0.07, 0.3))
    paint = pick(rng, (RUST, STEEL, PAINTS[3], PAINTS[1], (0.3, 0.3, 0.28)))
    x, y = line[::3, 0], line[::3, 1]
    z = np.asarray(ground(x, y), dtype=np.float64)
    stiff = min(max(int(1.2 / 0.15), 3), max(len(z) // 2, 1))
    padded = np.pad(z, stiff, mode="edge")
    bridged = np.convolve(padded, np.ones(2 * stiff + 1) / (2 * stiff + 1), mode="valid")
    z = np.maximum(bridged, z - radius) + radius * rng.uniform(0.3, 1.0)
    path = np.column_stack([x, y, z])
    parts = [rough(tube(path, radius, 24, colour=paint), rng, 0.03 * radius, 1.0, 0.15)]
    for k in range(int(rng.integers(6, 14)), len(path) - 2, int(rng.integers(18, 30))):
        along = path[k + 1] - path[k]
        along /= np.linalg.norm(along)
        shade = np.array(paint) * 0.8
        for side in (-0.02, 0.05):
            ends = np.stack([path[k] + along * side, path[k] + along * (side + 0.05)])
            parts.append(tube(ends, radius * 1.32, 24, colour=shade))
    return join(parts)


def pile(rng: np.random.Generator, height_m: float, radius_m: float) -> Mesh:
    """A round pile with marine growth, from 1 m below the ground to `height_m`."""
    levels = np.linspace(-1.0, height_m, 90)
    path = np.column_stack([np.zeros((90, 2)), levels])
    bare, grown = np.array(pick(rng, (*CONCRETE, RUST))), np.array([0.16, 0.15, 0.09])
    growth = smoothstep(0.3, 1.2, levels * rng.uniform(0.4, 1.2))[:, None]
    shaft = tube(path, radius_m, 40, colour=np.concatenate([bare * (1 - growth) + grown * growth]))
    return rough(shaft, rng, 0.06 * radius_m + 0.006, 0.7, 0.09)


def brace(rng: np.random.Generator, start: Points, end: Points) -> Mesh:
    """A beam between two piles, overgrown."""
    path = start + np.linspace(0, 1, 30)[:, None] * (end - start)
    beam = tube(path, rng.uniform(0.07, 0.12), 14, colour=pick(rng, (RUST, STEEL, CONCRETE[1])))
    return rough(beam, rng, 0.012, 0.6, 0.08)


def quay(rng: np.random.Generator, length_m: float, height_m: float) -> Mesh:
    """A wall along the x axis, facing -y: courses of blocks, buttresses, and tyres as fenders."""
    colour, parts = np.array(pick(rng, CONCRETE)), []
    course, width = rng.uniform(0.5, 0.9), rng.uniform(1.0, 2.0)
    rows, columns = int(np.ceil((height_m + 1) / course)), int(np.ceil(length_m / width))
    for row in range(rows):
        for column in range(-1, columns):
            x = (column + 0.5 * (row % 2)) * width - length_m / 2
            shade = tuple(colour * rng.uniform(0.75, 1.15))
            size = (width - 0.025, 0.6, course - 0.025)
            y = 0.3 + rng.uniform(-0.025, 0.025)
            centre = (x + width / 2, y, -1 + (row + 0.5) * course)
            parts.append(box(size, centre, (shade[0], shade[1], shade[2])))
    back = box((length_m + width, 0.5, height_m + 1), (0, 0.56, height_m / 2 - 0.5))
    parts.append(tinted(back, (0.05, 0.05, 0.05)))
    for x in np.arange(-length_m / 2 + rng.uniform(1, 3), length_m / 2, rng.uniform(4, 6)):
        if rng.random() < 0.5:
            centre = (x, -0.2, height_m / 2 - 0.5)
            shade = tuple(colour * 0.9)
            parts.append(box((0.5, 0.6, height_m + 1), centre, (shade[0], shade[1], shade[2])))
    return join(parts)


def fender(rng: np.random.Generator) -> Mesh:
    """A tyre hung flat against a wall that faces -y, centred on its hub."""
    shape = tire(rng)
    centred = shape.moved(offset=-0.5 * (shape.vertices.min(axis=0) + shape.vertices.max(axis=0)))
    # The thinnest direction is the hub's axis, whatever way the tyre lay.
    thin = int(np.argmin(np.ptp(centred.vertices, axis=0)))
    turns = {0: rotation("z", np.pi / 2), 1: np.eye(3), 2: rotation("x", np.pi / 2)}
    return centred.moved(turns[thin])


def sheet_pile(rng: np.random.Generator, length_m: float, height_m: float) -> Mesh:
    """A steel sheet-pile wall along the x axis, facing -y: a folded face."""
    pitch, depth = rng.uniform(0.8, 1.4), rng.uniform(0.2, 0.4)
    x = np.arange(-length_m / 2, length_m / 2, pitch / 4)
    y = np.where(np.arange(len(x)) % 4 < 2, 0.0, depth)
    levels = np.linspace(-1, height_m, 20)
    parts = []
    for k in range(len(x) - 1):
        low = np.column_stack([np.full(20, x[k]), np.full(20, y[k]), levels])
        high = np.column_stack([np.full(20, x[k + 1]), np.full(20, y[k + 1]), levels])
        grid = np.stack([low, high], axis=1).reshape(-1, 3)
        steps = np.arange(19)[:, None] * 2
        quads = np.concatenate([steps + np.array(corners) for corners in ([0, 1, 3], [0, 3, 2])])
        parts.append(mesh(grid, quads, RUST))
    return join(parts)
