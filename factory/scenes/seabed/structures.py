"""Things that people build: frames, blocks, anchors, chains, pipes, piles and quay walls.

Builders draw their own size and colours and return a mesh that rests on z = 0; `chain` and `pipe`
take the ground height as a function of (x, y) and come in world coordinates.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from .debris import PAINTS, RUST, STEEL, pick, tire
from .fields import Floats, smoothstep
from .meshes import (
    Colour,
    Mesh,
    bar,
    box,
    join,
    lathe,
    mesh,
    prism,
    rotation,
    rough,
    tube,
)
from .nature import coral

Points = npt.NDArray[np.float64]
GroundHeight = Callable[[Points, Points], Floats]

CONCRETE: tuple[Colour, ...] = ((0.42, 0.41, 0.38), (0.34, 0.34, 0.32), (0.50, 0.48, 0.43))
BARS: tuple[Colour, ...] = (PAINTS[1], PAINTS[3], PAINTS[5], RUST, STEEL)


def tinted(shape: Mesh, colour: Colour) -> Mesh:
    """The mesh in one colour."""
    return Mesh(shape.vertices, np.full_like(shape.colours, colour), shape.triangles)


def frame(rng: np.random.Generator) -> Mesh:
    """An open frame of bars: cube, pyramid, ladder tower or nursery table."""
    form = (_dice, _pyramid, _tower, _nursery)[int(rng.choice(4, p=[0.36, 0.26, 0.14, 0.24]))]
    return form(rng)


def _dice(rng: np.random.Generator) -> Mesh:
    """The twelve edges of a cube; sometimes with diagonals or standing on a corner."""
    side, radius = rng.uniform(0.5, 1.6), rng.uniform(0.018, 0.05)
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * side / 2
    edges = [
        (a, b)
        for a in range(8)
        for b in range(a + 1, 8)
        if int(np.sum(corners[a] != corners[b])) == 1
    ]
    if rng.random() < 0.4:
        edges += [(0, 3), (4, 7), (1, 4)]
    cube = join([bar(corners[a], corners[b], radius) for a, b in edges])
    if rng.random() < 0.25:
        cube = cube.moved(rotation("y", 0.62) @ rotation("x", 0.78))
    return tinted(cube, pick(rng, BARS)).standing()


def _pyramid(rng: np.random.Generator) -> Mesh:
    """A square or three-sided pyramid of bars with a belt half way up."""
    side, height, radius = rng.uniform(0.7, 1.9), rng.uniform(0.8, 1.8), rng.uniform(0.018, 0.045)
    count = int(rng.integers(3, 5))
    angle = np.arange(count) * 2 * np.pi / count
    foot = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(count)]) * side * 0.7
    apex = np.array([0, 0, height])
    belt = foot * 0.5 + apex * 0.5
    parts = [bar(point, apex, radius) for point in foot]
    for ring in (foot + np.array([0, 0, radius]), belt):
        parts += [bar(ring[k], ring[(k + 1) % count], radius) for k in range(count)]
    return tinted(join(parts), pick(rng, BARS))


def _tower(rng: np.random.Generator) -> Mesh:
    """A lattice mast, upright or fallen."""
    width, bays, radius = rng.uniform(0.4, 0.7), int(rng.integers(3, 6)), rng.uniform(0.015, 0.03)
    legs = np.array([[0, 0, 0], [width, 0, 0], [width / 2, width * 0.87, 0]], dtype=float)
    top = bays * width
    parts = [bar(leg, leg + np.array([0, 0, top]), radius) for leg in legs]
    for level in range(bays):
        low, high = [0, 0, level * width], [0, 0, (level + 1) * width]
        for k in range(3):
            after = (k + 1) % 3
            parts.append(bar(legs[k] + high, legs[after] + high, radius * 0.8))
            parts.append(bar(legs[k] + low, legs[after] + high, radius * 0.7))
    mast = tinted(join(parts), pick(rng, BARS)).moved(offset=(-width / 2, -width / 2, 0))
    if rng.random() < 0.5:
        mast = mast.moved(rotation("y", np.pi / 2 - 0.06)).moved(offset=(-top / 2, 0, 0))
    return mast.standing()


def _nursery(rng: np.random.Generator) -> Mesh:
    """A table of slats on legs, with corals planted on it."""
    length, width, height = rng.uniform(1.2, 2.2), rng.uniform(0.6, 1.0), rng.uniform(0.5, 0.9)
    parts = []
    for x in (-length / 2, length / 2):
        for y in (-width / 2, width / 2):
            parts.append(bar((x, y, 0), (x, y, height), 0.028))
        parts.append(bar((x, -width / 2, height * 0.45), (x, width / 2, height * 0.45), 0.02))
    for y in np.linspace(-width / 2, width / 2, 5):
        parts.append(box((length + 0.1, 0.06, 0.03), (0, y, height)))
    table = tinted(join(parts), pick(rng, (RUST, STEEL, (0.2, 0.18, 0.15))))
    planted = [table]
    for _ in range(int(rng.integers(5, 11))):
        place = (rng.uniform(-0.45, 0.45) * length, rng.uniform(-0.4, 0.4) * width, height)
        planted.append(coral(rng).moved(rotation("z", rng.uniform(0, 6)), place, 0.55))
    return join(planted)


def block(rng: np.random.Generator) -> Mesh:
    """Concrete: a cube, slab, cinder block with holes, tetrapod, ring or kerb stone."""
    colour = pick(rng, CONCRETE)
    form = int(rng.choice(6, p=[0.24, 0.14, 0.2, 0.16, 0.14, 0.12]))
    if form == 0:
        whole = box((rng.uniform(0.35, 1.0) * rng.uniform(0.8, 1.2, 3)).tolist(), colour=colour)
    elif form == 1:
        whole = box(rng.uniform([0.8, 0.5, 0.1], [1.8, 1.0, 0.2]).tolist(), colour=colour)
    elif form == 2:
        whole = _cinder(rng.uniform(0.4, 0.75), colour)
    elif form == 3:
        whole = _tetrapod(rng.uniform(0.45, 0.95), colour)
    elif form == 4:
        outer, height = rng.uniform(0.35, 0.75), rng.uniform(0.3, 0.6)
        ring = [[0.8, 0], [1, 0], [1, height], [0.8, height], [0.8, 0]]
        whole = lathe(np.array(ring) * [outer, 1], 36, colour, crease=True)
    else:
        kerb = [[-0.3, 0], [0.3, 0], [0.3, 0.12], [0.12, 0.35], [0.09, 0.8], [-0.09, 0.8]]
        outline = [*kerb, [-0.12, 0.35], [-0.3, 0.12]]
        length, size = rng.uniform(1.0, 2.0), rng.uniform(0.6, 1.0)
        whole = prism(np.array(outline) * size, length, colour).moved(rotation("x", np.pi / 2))
    if form in (0, 1, 2) and rng.random() < 0.4:
        turn = rotation("x", rng.uniform(-0.5, 0.5)) @ rotation("y", rng.uniform(0, 0.4))
        whole = whole.moved(turn).standing()
        # What stands on an edge has dug itself in.
        return whole.moved(offset=(0, 0, -0.25 * float(whole.vertices[:, 2].max())))
    return whole.standing()


def _cinder(length: float, colour: Colour) -> Mesh:
    """A hollow block: two side walls, three webs."""
    width, height, wall = length * 0.48, length * 0.48, length * 0.085
    sides = [
        box((length, wall, height), (0, s * (width - wall) / 2, 0), colour) for s in (-1.0, 1.0)
    ]
    webs = [
        box((wall, width - 2 * wall, height), (x, 0, 0), colour)
        for x in (-(length - wall) / 2, 0, (length - wall) / 2)
    ]
    return join([*sides, *webs])


def _tetrapod(size: float, colour: Colour) -> Mesh:
    """Four blunt legs toward the corners of a tetrahedron."""
    profile = np.array([[0.34, 0.0], [0.24, 0.92], [0.18, 1.0], [0, 1.0]]) * size
    leg = lathe(profile, 18, colour, crease=True)
    lean = np.arccos(-1 / 3)
    legs = [leg] + [
        leg.moved(rotation("z", k * 2 * np.pi / 3) @ rotation("y", lean)) for k in range(3)
    ]
    return join(legs).standing()


def anchor(rng: np.random.Generator) -> Mesh:
    """An admiralty anchor on its side, one fluke up, with stock and ring."""
    size, metal = rng.uniform(0.7, 1.7), pick(rng, (RUST, RUST, STEEL))
    shank = bar((0, 0, 0), (0, 0, 1.0), 0.045, 10)
    bend = np.linspace(-1.05, 1.05, 15)
    arms = np.column_stack([0.46 * np.sin(bend), np.zeros(15), 0.42 * (1 - np.cos(bend))])
    crown = tube(arms, 0.05 - 0.018 * np.abs(bend), 10)
    stock = bar((0, -0.42, 0.9), (0, 0.42, 0.9), 0.03, 8)
    ring = np.linspace(0, 2 * np.pi, 18, endpoint=False)
    eye = tube(
        np.column_stack([0.07 * np.cos(ring), 0 * ring, 1.06 + 0.07 * np.sin(ring)]),
        0.018,
        8,
        closed=True,
    )
    flukes = []
    for s in (-1.0, 1.0):
        palm = prism(np.array([[-0.13, -0.1], [0.13, -0.1], [0, 0.2]]), 0.025)
        turn = rotation("y", s * -0.62) @ rotation("x", np.pi / 2) @ rotation("z", 0.0)
        flukes.append(palm.moved(rotation("z", np.pi / 2)).moved(turn, (s * 0.37, 0, 0.2)))
    whole = tinted(join([shank, crown, stock, eye, *flukes]), metal).moved(scale=size)
    tip = rotation("x", rng.uniform(-0.25, 0.25)) @ rotation(
        "y", np.pi / 2 + rng.uniform(-0.2, 0.1)
    )
    laid = whole.moved(rotation("z", rng.uniform(0.9, 1.3))).moved(tip).standing()
    return laid.moved(offset=(-size / 2, 0, -0.06 * size))


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
