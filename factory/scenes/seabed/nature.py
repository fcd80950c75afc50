"""Things that grow or lie there: boulders, corals, sponges and sea grass."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from .debris import pick
from .fields import waves
from .meshes import (
    Colour,
    Mesh,
    grid_triangles,
    join,
    lathe,
    mesh,
    rock,
    rotation,
    rough,
    sphere,
    tube,
)

Points = npt.NDArray[np.float64]

STONES: tuple[Colour, ...] = (
    (0.34, 0.31, 0.26),
    (0.26, 0.25, 0.24),
    (0.40, 0.36, 0.29),
    (0.30, 0.24, 0.19),
)
CORALS: tuple[Colour, ...] = (
    (0.50, 0.30, 0.16),
    (0.46, 0.20, 0.30),
    (0.58, 0.48, 0.20),
    (0.30, 0.34, 0.16),
    (0.62, 0.52, 0.44),
    (0.36, 0.22, 0.40),
)
LEAVES: tuple[Colour, ...] = ((0.06, 0.14, 0.03), (0.10, 0.16, 0.04), (0.16, 0.14, 0.05))


def boulder(rng: np.random.Generator) -> Mesh:
    """A stone from 15 cm to 1.5 m across, small ones more often, its foot in the sand."""
    radius = 0.14 * (5.0 ** (rng.random() ** 1.7))
    shape = rock(rng, 5 if radius > 0.5 else 4 if radius > 0.2 else 3)
    proportions = radius * rng.uniform([0.9, 0.7, 0.5], [1.3, 1.1, 0.95])
    tilt = rotation("x", rng.uniform(-0.4, 0.4)) @ rotation("z", rng.uniform(0, 2 * np.pi))
    stone = shape.moved(None, (0, 0, 0), proportions.tolist()).moved(tilt)
    colours = np.full_like(stone.colours, pick(rng, STONES))
    stone = Mesh(stone.vertices, colours, stone.triangles).standing()
    return stone.moved(offset=(0, 0, -float(stone.vertices[:, 2].max()) * rng.uniform(0.15, 0.45)))


def pebble(rng: np.random.Generator) -> Mesh:
    """A small stone, 3 to 14 cm."""
    size = 0.03 * 4.5 ** float(rng.random())
    stone = rock(rng, 2).moved(scale=(size, size * rng.uniform(0.6, 1.0), size * 0.6))
    colours = np.full_like(stone.colours, pick(rng, STONES))
    return Mesh(stone.vertices, colours, stone.triangles).moved(offset=(0, 0, size * 0.2))


def coral(rng: np.random.Generator) -> Mesh:
    """A coral or sponge of one of five growth forms."""
    forms = (_branching, _table, _brain, _tubes, _fan)
    form = forms[int(rng.choice(len(forms), p=[0.32, 0.16, 0.24, 0.16, 0.12]))]
    return form(rng, pick(rng, CORALS))


def _branching(rng: np.random.Generator, colour: Colour) -> Mesh:
    """Branches that fork three times, pale at the tips."""
    size = rng.uniform(0.14, 0.4)
    parts: list[Mesh] = []

    def grow(start: Points, heading: Points, length: float, level: int) -> None:
        wobble = heading + rng.normal(0, 0.25, 3)
        middle = start + heading * length * 0.5
        end = middle + wobble / np.linalg.norm(wobble) * length * 0.5
        thick = size * 0.075 * 0.72**level
        pale = np.array(colour) * (1 + 0.28 * level)
        ends = np.array([pale, pale, pale * 1.3])
        radii = [thick, thick * 0.9, thick * 0.72]
        parts.append(tube(np.stack([start, middle, end]), radii, 6, colour=ends))
        if level < 3:
            for _ in range(int(rng.integers(2, 4))):
                turn = heading + rng.normal(0, 0.55, 3) + [0, 0, 0.2]
                grow(end, turn / np.linalg.norm(turn), length * rng.uniform(0.6, 0.85), level + 1)

    for _ in range(int(rng.integers(3, 6))):
        heading = np.array([rng.normal(0, 0.6), rng.normal(0, 0.6), 1.0])
        grow(np.zeros(3), heading / np.linalg.norm(heading), size * 0.5, 0)
    return join(parts)


def _table(rng: np.random.Generator, colour: Colour) -> Mesh:
    """A stalk under one or two thin plates with a ragged rim."""
    radius, height = rng.uniform(0.25, 0.7), rng.uniform(0.14, 0.4)
    profile = [[0.1, 0], [0.08, 0.5], [0.3, 0.82], [1.0, 0.98], [0.98, 1.06], [0.4, 1.0], [0, 0.97]]
    plate = lathe(np.array(profile) * [radius, height], 40, colour)
    # Both faces rise and fall together, or the thin plate would cut through itself.
    x, y, z = plate.vertices.T
    waviness, raggedness = (waves(rng, radius, radius * share) for share in (0.12, 0.25))
    lifted = z + np.float32(0.03 * radius) * waviness(x, y) * np.minimum(z / height, 1)
    outward = 1 + np.float32(0.06) * raggedness(x, y) * np.hypot(x, y) / np.float32(radius)
    points = np.stack([x * outward, y * outward, lifted], axis=-1).astype(np.float32)
    return Mesh(points, plate.colours, plate.triangles)


def _brain(rng: np.random.Generator, colour: Colour) -> Mesh:
    """A knobbly dome."""
    radius = rng.uniform(0.1, 0.45)
    dome = sphere(4, colour).moved(scale=(radius, radius, radius * rng.uniform(0.6, 0.95)))
    return rough(dome, rng, radius * 0.045, radius * 0.7, radius * 0.18)


def _tubes(rng: np.random.Generator, colour: Colour) -> Mesh:
    """A clump of open tube sponges."""
    parts = []
    for _ in range(int(rng.integers(3, 9))):
        height, radius = rng.uniform(0.12, 0.5), rng.uniform(0.025, 0.06)
        profile = [[0.7, 0], [0.8, 0.4], [1.0, 0.9], [1.05, 1.0], [0.75, 1.0], [0.5, 0.6], [0, 0.4]]
        sponge = lathe(np.array(profile) * [radius, height], 14, colour)
        lean = rotation("z", rng.uniform(0, 2 * np.pi)) @ rotation("x", rng.uniform(0, 0.5))
        parts.append(sponge.moved(lean, (rng.normal(0, 0.06), rng.normal(0, 0.06), 0)))
    return join(parts)


def _fan(rng: np.random.Generator, colour: Colour) -> Mesh:
    """A sea fan: twigs spread in one plane."""
    size = rng.uniform(0.25, 0.6)
    parts = [tube(np.array([[0, 0, 0], [0, 0, size * 0.3]]), size * 0.03, 6, colour=colour)]
    for angle in np.linspace(-1.1, 1.1, 13):
        reach = size * rng.uniform(0.65, 1.0)
        t = np.linspace(0, 1, 6)[:, None]
        bend = np.array([np.sin(angle) * reach, 0.05 * size, np.cos(angle) * reach])
        path = t * bend + [0, 0, size * 0.25] + rng.normal(0, 0.012, (6, 3)) * t
        parts.append(tube(path, np.linspace(0.02, 0.006, 6) * size * 1.4, 5, colour=colour))
    for reach in np.linspace(0.4, 0.9, 5):
        arc = np.linspace(-1.05, 1.05, 20)
        x, z = np.sin(arc) * size * reach * 0.85, np.cos(arc) * size * reach * 0.85 + size * 0.25
        path = np.column_stack([x, np.full(20, 0.05 * size * reach), z])
        parts.append(tube(path, size * 0.007, 4, colour=colour))
    return join(parts)


def plant(rng: np.random.Generator) -> Mesh:
    """A tuft of sea grass: bent blades, all leaning with the current."""
    blades, height = int(rng.integers(14, 34)), rng.uniform(0.18, 0.5)
    colour, parts = np.array(pick(rng, LEAVES)), []
    t = np.linspace(0, 1, 6)
    for _ in range(blades):
        length, heading = height * rng.uniform(0.6, 1.2), rng.uniform(0, 2 * np.pi)
        lean = rng.uniform(0.1, 0.7)
        out, up = length * lean * t**1.6, length * t * (1 - 0.35 * lean * t)
        spine = np.column_stack(
            [out * np.cos(heading) + 0.12 * t * height, out * np.sin(heading), up]
        )
        spine += [*rng.normal(0, 0.06, 2), 0]
        across = np.array([-np.sin(heading), np.cos(heading), 0.0]) * 0.007
        width = (1.1 - t**2)[:, None] * across
        grid = np.stack([spine - width, spine + width], axis=1).reshape(-1, 3)
        shade = np.repeat(np.linspace(0.6, 1.5, 6), 2)[:, None] * colour
        parts.append(mesh(grid, grid_triangles(6, 2), shade))
    return join(parts)
