"""The catalogue of objects: what people drop and build, and what grows or lies there.

Every builder draws its own size and colours and returns a mesh that rests on z = 0; `chain` and
`pipe` take the ground height as a function of (x, y) and come in world coordinates.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable
from dataclasses import replace
from operator import itemgetter

import numpy as np

from ....common.array_types import Draws, Float32s, Float64s
from ....common.seeds import stream
from ...meshes.camera import WORLD_SEED
from ...meshes.triangle_mesh import (
    Mesh,
    bars,
    box,
    circle,
    join,
    lathe,
    prism,
    rough,
    sheet,
    sphere,
    tube,
)
from ...meshes.waves import Waves
from .terrain import catalogue, pick, smoothstep

GroundHeight = Callable[[Float64s, Float64s], Float32s]

GLASS, PAINTS, STONES, CORALS, LEAVES, CONCRETE, (RUST, BRONZE, STEEL) = itemgetter(
    "glass", "paint", "stone", "coral", "leaf", "concrete", "metal"
)(catalogue()["colours"])
BARS = (PAINTS[1], PAINTS[3], PAINTS[5], RUST, STEEL)


def lying(upright: Mesh) -> Mesh:
    """An upright thing laid on its side."""
    return upright.turned("y", np.pi / 2).standing()


def standing_bottle(rng: Draws) -> Mesh:
    """A bottle, 22 to 42 cm high, often with a label."""
    height = rng.uniform(0.22, 0.42)
    radius = rng.uniform(0.036, 0.052)
    neck = radius * rng.uniform(0.3, 0.42)
    shoulder = rng.uniform(0.5, 0.64)
    glass = pick(rng, GLASS)
    label = pick(rng, PAINTS) if rng.random() < 0.6 else glass
    levels = [0, 0, 0.02, 0.14, 0.15, 0.4, 0.41, shoulder, shoulder + 0.09, 0.78, 0.94]
    lower = radius * np.array([0, 0.9, 1, 1, 1, 1, 1, 1, 0.8])
    radii = [*lower, neck, neck, neck * 1.25, neck * 1.25, neck * 0.7, 0]
    colours = np.tile(glass, (15, 1))
    colours[4:6] = label
    return lathe(np.stack([radii, [*levels, 0.94, 0.98, 1, 0.99]], -1) * [1, height], 22, colours)


def can(rng: Draws) -> Mesh:
    """A tin or drink can, lying or upright, perhaps dented."""
    radius = rng.uniform(0.045, 0.09)
    height = radius * rng.uniform(1.8, 3.0)
    profile = np.array([[0, 0.02], [0.86, 0.02], [0.9, 0], [1, 0.05], [1, 0.07], [1, 0.5]])
    above = profile[-2::-1] * [1, -1] + [0, 1]
    colours = np.tile(np.array(STEEL) * 1.3, (11, 1))
    colours[4:7] = pick(rng, PAINTS)
    shape = lathe(np.concatenate([profile, above]) * [radius, height], 24, colours)
    if rng.random() < 0.4:  # a dent: pressed flat on one side
        points = shape.vertices.copy()
        middle = np.exp(-(((points[:, 2] / height - 0.5) / 0.25) ** 2))
        limit = radius * (1 - rng.uniform(0.2, 0.5) * middle)
        points[:, 0] = np.minimum(points[:, 0], limit)
        shape = replace(shape, vertices=points)
    return lying(shape) if rng.random() < 0.7 else shape


def drink_carton(rng: Draws) -> Mesh:
    """A gable-top carton, standing or lying."""
    width, depth, body = rng.uniform([0.07, 0.07, 0.16], [0.11, 0.11, 0.26]).tolist()
    paint = pick(rng, PAINTS)
    pale = (0.72, 0.72, 0.70)
    ridge = body + width * 0.55
    gable = prism([[-width / 2, 0], [width / 2, 0], [0, ridge - body]], depth, pale)
    gable = gable.turned("x", np.pi / 2).moved((0, depth / 2, body))
    lower = box((width, depth, body * 0.55), (0, 0, body * 0.275), paint)
    upper = box((width, depth, body * 0.45), (0, 0, body * 0.775), pale)
    carton = join([lower, upper, gable, box((0.008, depth, 0.03), (0, 0, ridge + 0.012), paint)])
    return carton if rng.random() < 0.4 else lying(carton)


def shampoo_bottle(rng: Draws) -> Mesh:
    """A flat plastic bottle with a cap, on its side or upright."""
    height = rng.uniform(0.2, 0.32)
    width = rng.uniform(0.045, 0.06)
    paint = pick(rng, PAINTS)
    cap = pick(rng, PAINTS)
    body = [[0, 0], [0.8, 0], [0.95, 0.03], [1, 0.3], [0.9, 0.6], [0.62, 0.74], [0.3, 0.78]]
    top = [[0.34, 0.78], [0.34, 0.97], [0.28, 1.0], [0, 1.0]]
    flat = lathe(np.array(body) * [width, height], 20, paint).moved(scale=(1.0, 0.55, 1.0))
    whole = join([flat, lathe(np.array(top) * [width, height], 14, cap, crease=True)])
    return whole if rng.random() < 0.3 else lying(whole)


def hook(rng: Draws) -> Mesh:
    """A crane hook with its eye, lying on the ground."""
    size = rng.uniform(0.16, 0.4)
    angle = np.linspace(np.deg2rad(100), np.deg2rad(-170), 22)
    bend = np.column_stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)]) * 0.5
    shank = [[bend[0, 0], y, 0] for y in (1.35, 0.95, 0.7)]
    upper = np.linspace(0.13, 0.17, 11)
    lower = np.linspace(0.165, 0.045, 11)
    thickness = np.array([0.1, 0.11, 0.12, *upper, *lower]) * size
    eye = (circle(18) * 0.24 + [bend[0, 0], 1.55, 0]) * size
    paint = pick(rng, (RUST, STEEL, PAINTS[1], PAINTS[0]))
    bent = tube(np.concatenate([shank, bend]) * size, thickness, 12, colour=paint)
    whole = join([bent, tube(eye, 0.09 * size, 10, closed=True, colour=paint)])
    return whole.turned("x", rng.uniform(-0.2, 0.5)).standing()


def propeller(rng: Draws) -> Mesh:
    """A ship's propeller of three to five twisted blades, leaning or flat."""
    radius = rng.uniform(0.22, 0.6)
    blades = int(rng.integers(3, 6))
    metal = pick(rng, (BRONZE, STEEL, RUST))
    hub = np.array([[0, -0.2], [0.14, -0.2], [0.19, -0.1], [0.2, 0.12], [0.12, 0.25], [0, 0.3]])
    along, across = np.meshgrid(np.linspace(0.12, 1, 12), np.linspace(-1, 1, 9), indexing="ij")
    width = 0.36 * np.sqrt(np.maximum(1 - ((along - 0.62) / 0.52) ** 2, 0)) + 0.04
    twist = np.deg2rad(62) * (1 - along) + np.deg2rad(20)
    thick = 0.025 * (1 - 0.7 * along) * (1 - across**2)
    x = along * np.cos(across * width * 0.6)
    y = across * width * np.cos(twist)
    z = across * width * np.sin(twist)
    blade = join(
        sheet(np.stack([x, y, z + side * thick], axis=-1) * radius, metal, turned=side < 0)
        for side in (1.0, -1.0)
    )
    turned = (blade.turned("z", 2 * np.pi * k / blades) for k in range(blades))
    whole = join([lathe(hub * radius, 20, metal), *turned])
    return whole.turned("x", rng.choice([0.2, 1.2]) + rng.uniform(-0.2, 0.2)).standing()


def tire(rng: Draws) -> Mesh:
    """A tyre, flat, leaning or upright; hollow like a real one, with a tread."""
    outer = rng.uniform(0.28, 0.58)
    width = outer * rng.uniform(0.32, 0.5)
    rim = outer * rng.uniform(0.55, 0.66)
    # From the rim over the outside's half to its middle, and on the inside; both are mirrored.
    deep = outer - rim
    tread = 0.978 * outer
    radii = [rim, rim + 0.3 * deep, rim + 0.75 * deep, 0.985 * outer, outer, tread, tread, outer]
    outside = np.column_stack([radii, [-0.36, -0.49, -0.5, -0.4, -0.2, -0.18, -0.1, -0.08]])
    hollow = np.array([[rim + 0.1 * deep, 0.34], [rim + 0.7 * deep, 0.4], [outer * 0.94, 0.3]])
    mirror = [1, -1]
    parts = (outside, outside[::-1] * mirror, hollow, hollow[::-1] * mirror, outside[:1])
    rubber = np.array([0.035, 0.035, 0.038]) * rng.uniform(0.8, 1.6)
    shape = lathe(np.concatenate(parts) * [1, width], 44, rubber)
    lean = rng.choice([0.0, 0.3, 1.25, np.pi / 2], p=[0.45, 0.2, 0.15, 0.2])
    return shape.turned("x", lean + rng.uniform(-0.08, 0.08)).standing()


def valve(rng: Draws) -> Mesh:
    """A flanged gate valve with its hand wheel."""
    size = rng.uniform(0.16, 0.34)
    paint = pick(rng, (STEEL, RUST, PAINTS[2], PAINTS[4]))
    wheel = pick(rng, (PAINTS[0], RUST))
    half = np.array([[0, -1], [0.62, -1], [0.62, -0.84], [0.34, -0.84], [0.36, -0.5], [0.5, 0]])
    body = np.concatenate([half, half[-2::-1] * [1, -1]])
    bonnet = [[0.4, 0.3], [0.3, 0.7], [0.42, 0.72], [0.42, 0.84], [0.12, 0.9], [0.1, 1.5], [0, 1.5]]
    rim = circle(26) * 0.55 + [0, 0, 1.4]
    spokes = bars((((0, 0, 1.4), rim[k]) for k in (0, 6, 13, 19)), 0.045, 6)
    hand = join([tube(rim, 0.07, 8, closed=True), spokes]).tinted(wheel)
    run = lathe(body, 22, paint, crease=True).turned("y", np.pi / 2)
    whole = join([run, lathe(bonnet, 18, paint, crease=True), hand]).moved(scale=size)
    return whole.turned("x", rng.choice([0.0, 1.35]) + rng.uniform(-0.2, 0.2)).standing()


def barrel(rng: Draws) -> Mesh:
    """A steel drum, lying or upright."""
    radius = 0.29 * rng.uniform(0.8, 1.1)
    height = 0.86 * rng.uniform(0.85, 1.1)
    hoops = [0.3, 0.32, 0.34, 0.36, 0.64, 0.66, 0.68, 0.7]
    levels = [0.03, 0.03, 0, 0.02, *hoops, 0.98, 1, 0.97, 0.97]
    radii = [0, 0.94, 0.97, 1, 1, 1.04, 1.04, 1, 1, 1.04, 1.04, 1, 1, 0.97, 0.94, 0]
    paint = pick(rng, (RUST, PAINTS[2], PAINTS[0], PAINTS[1]))
    drum = lathe(np.stack([radii, levels], -1) * [radius, height], 32, paint, crease=True)
    return lying(drum) if rng.random() < 0.65 else drum


def _rock(rng: Draws, subdivisions: int) -> Mesh:
    """A boulder of radius about 1: a ball cut by random planes, then roughened."""
    ball = sphere(subdivisions)
    radius = np.full(len(ball.vertices), 1.15, dtype=np.float32)
    for _ in range(int(rng.integers(5, 12))):
        normal = rng.standard_normal(3)
        normal /= np.linalg.norm(normal)
        facing = np.einsum("vi,i->v", ball.vertices, normal.astype(np.float32))
        cut = rng.uniform(0.6, 1.0) / np.maximum(facing, 1e-3)
        radius = np.minimum(radius, np.where(facing > 0, cut, radius)).astype(np.float32)
    shape = replace(ball, vertices=ball.vertices * radius[:, None])
    return rough(shape, rng, rng.uniform(0.03, 0.07), 1.6, 0.5 if subdivisions < 4 else 0.12)


def boulder(rng: Draws) -> Mesh:
    """A stone from 15 cm to 1.5 m across, small ones more often, its foot in the sand."""
    radius = 0.14 * (5.0 ** (rng.random() ** 1.7))
    shape = _rock(rng, 5 if radius > 0.5 else 4 if radius > 0.2 else 3)
    proportions = radius * rng.uniform([0.9, 0.7, 0.5], [1.3, 1.1, 0.95])
    turn = rng.uniform(-0.4, 0.4), rng.uniform(0, 2 * np.pi)
    stone = shape.moved(scale=proportions.tolist()).turned("xz", *turn)
    stone = stone.tinted(pick(rng, STONES)).standing()
    return stone.moved((0, 0, -float(stone.vertices[:, 2].max()) * rng.uniform(0.15, 0.45)))


def pebble(rng: Draws) -> Mesh:
    """A small stone, 3 to 14 cm."""
    size = 0.03 * 4.5 ** float(rng.random())
    stone = _rock(rng, 2).moved(scale=(size, size * rng.uniform(0.6, 1.0), size * 0.6))
    return stone.tinted(pick(rng, STONES)).moved((0, 0, size * 0.2))


def coral(rng: Draws) -> Mesh:
    """A coral or sponge of one of five growth forms."""
    forms = (_branching, _table, _brain, _tubes, _fan)
    form = forms[int(rng.choice(len(forms), p=[0.32, 0.16, 0.24, 0.16, 0.12]))]
    return form(rng, pick(rng, CORALS))


def _branching(rng: Draws, colour: Float64s) -> Mesh:
    """Branches that fork three times, pale at the tips."""
    size = rng.uniform(0.14, 0.4)
    parts: list[Mesh] = []

    def grow(start: Float64s, heading: Float64s, length: float, level: int) -> None:
        heading = heading / np.linalg.norm(heading)
        wobble = heading + rng.normal(0, 0.25, 3)
        middle = start + heading * length * 0.5
        end = middle + wobble / np.linalg.norm(wobble) * length * 0.5
        radii = size * 0.075 * 0.72**level * np.array([1, 0.9, 0.72])
        pale = colour * (1 + 0.28 * level)
        path = np.stack([start, middle, end])
        ends = np.stack([pale, pale, pale * 1.3])
        parts.append(tube(path, radii, 6, colour=ends))
        for _ in range(int(rng.integers(2, 4)) if level < 3 else 0):
            turn = heading + rng.normal(0, 0.55, 3) + [0, 0, 0.2]
            grow(end, turn, length * rng.uniform(0.6, 0.85), level + 1)

    for _ in range(int(rng.integers(3, 6))):
        grow(np.zeros(3), np.array([*rng.normal(0, 0.6, 2), 1.0]), size * 0.5, 0)
    return join(parts)


def _table(rng: Draws, colour: Float64s) -> Mesh:
    """A stalk under one or two thin plates with a ragged rim."""
    radius = rng.uniform(0.25, 0.7)
    height = rng.uniform(0.14, 0.4)
    profile = [[0.1, 0], [0.08, 0.5], [0.3, 0.82], [1.0, 0.98], [0.98, 1.06], [0.4, 1.0], [0, 0.97]]
    plate = lathe(np.array(profile) * [radius, height], 40, colour)
    # Both faces rise and fall together, or the thin plate would cut through itself.
    x, y, z = plate.vertices.T
    waviness, raggedness = (Waves(rng, radius, radius * share, 1.0) for share in (0.12, 0.25))
    lifted = z + np.float32(0.03 * radius) * waviness(x, y) * np.minimum(z / height, 1)
    outward = 1 + np.float32(0.06) * raggedness(x, y) * np.hypot(x, y) / np.float32(radius)
    points = np.stack([x * outward, y * outward, lifted], axis=-1)
    return replace(plate, vertices=points.astype(np.float32))


def _brain(rng: Draws, colour: Float64s) -> Mesh:
    """A knobbly dome."""
    radius = rng.uniform(0.1, 0.45)
    dome = sphere(4).moved(scale=(radius, radius, radius * rng.uniform(0.6, 0.95)))
    return rough(dome.tinted(colour), rng, radius * 0.045, radius * 0.7, radius * 0.18)


def _tubes(rng: Draws, colour: Float64s) -> Mesh:
    """A clump of open tube sponges."""
    profile = [[0.7, 0], [0.8, 0.4], [1.0, 0.9], [1.05, 1.0], [0.75, 1.0], [0.5, 0.6], [0, 0.4]]
    parts = []
    for _ in range(int(rng.integers(3, 9))):
        height = rng.uniform(0.12, 0.5)
        radius = rng.uniform(0.025, 0.06)
        sponge = lathe(np.array(profile) * [radius, height], 14, colour)
        leaning = sponge.turned("zx", rng.uniform(0, 2 * np.pi), rng.uniform(0, 0.5))
        parts.append(leaning.moved((*rng.normal(0, 0.06, 2), 0)))
    return join(parts)


def _fan(rng: Draws, colour: Float64s) -> Mesh:
    """A sea fan: twigs spread in one plane."""
    size = rng.uniform(0.25, 0.6)
    parts = [tube(np.array([[0, 0, 0], [0, 0, size * 0.3]]), size * 0.03, 6, colour=colour)]
    t = np.linspace(0, 1, 6)[:, None]
    for angle in np.linspace(-1.1, 1.1, 13):
        reach = size * rng.uniform(0.65, 1.0)
        bend = np.array([np.sin(angle) * reach, 0.05 * size, np.cos(angle) * reach])
        path = t * bend + [0, 0, size * 0.25] + rng.normal(0, 0.012, (6, 3)) * t
        parts.append(tube(path, np.linspace(0.02, 0.006, 6) * size * 1.4, 5, colour=colour))
    arc = np.linspace(-1.05, 1.05, 20)
    for reach in np.linspace(0.4, 0.9, 5):
        x = np.sin(arc) * size * reach * 0.85
        z = np.cos(arc) * size * reach * 0.85 + size * 0.25
        path = np.column_stack([x, np.full(20, 0.05 * size * reach), z])
        parts.append(tube(path, size * 0.007, 4, colour=colour))
    return join(parts)


def plant(rng: Draws) -> Mesh:
    """A tuft of sea grass: bent blades, all leaning with the current."""
    blades = int(rng.integers(14, 34))
    height = rng.uniform(0.18, 0.5)
    colour = pick(rng, LEAVES)
    parts = []
    t = np.linspace(0, 1, 6)
    shade = np.repeat(np.linspace(0.6, 1.5, 6), 2)[:, None] * colour
    for _ in range(blades):
        length = height * rng.uniform(0.6, 1.2)
        heading = rng.uniform(0, 2 * np.pi)
        lean = rng.uniform(0.1, 0.7)
        out = length * lean * t**1.6
        up = length * t * (1 - 0.35 * lean * t)
        ahead = out * np.cos(heading) + 0.12 * t * height
        spine = np.column_stack([ahead, out * np.sin(heading), up])
        spine += [*rng.normal(0, 0.06, 2), 0]
        across = np.array([-np.sin(heading), np.cos(heading), 0.0]) * 0.007
        width = (1.1 - t**2)[:, None] * across
        parts.append(sheet(np.stack([spine - width, spine + width], axis=1), shade))
    return join(parts)


def frame(rng: Draws) -> Mesh:
    """An open frame of bars: cube, pyramid, ladder tower or nursery table."""
    form = (_dice, _pyramid, _tower, _nursery)[int(rng.choice(4, p=[0.36, 0.26, 0.14, 0.24]))]
    return form(rng)


def _dice(rng: Draws) -> Mesh:
    """The twelve edges of a cube; sometimes with diagonals or standing on a corner."""
    side = rng.uniform(0.5, 1.6)
    radius = rng.uniform(0.018, 0.05)
    corners = np.array(list(itertools.product((-1, 1), repeat=3))) * side / 2
    pairs = itertools.combinations(range(8), 2)
    edges = [(a, b) for a, b in pairs if int(np.sum(corners[a] != corners[b])) == 1]
    if rng.random() < 0.4:
        edges += [(0, 3), (4, 7), (1, 4)]
    cube = bars(((corners[a], corners[b]) for a, b in edges), radius)
    if rng.random() < 0.25:
        cube = cube.turned("yx", 0.62, 0.78)
    return cube.tinted(pick(rng, BARS)).standing()


def _pyramid(rng: Draws) -> Mesh:
    """A square or three-sided pyramid of bars with a belt half way up."""
    side = rng.uniform(0.7, 1.9)
    height = rng.uniform(0.8, 1.8)
    radius = rng.uniform(0.018, 0.045)
    count = int(rng.integers(3, 5))
    angle = np.arange(count) * 2 * np.pi / count
    foot = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(count)]) * side * 0.7
    apex = np.array([0, 0, height])
    rings = foot + np.array([0, 0, radius]), foot * 0.5 + apex * 0.5
    ends = [(point, apex) for point in foot]
    ends += [(ring[k], ring[(k + 1) % count]) for ring in rings for k in range(count)]
    return bars(ends, radius).tinted(pick(rng, BARS))


def _tower(rng: Draws) -> Mesh:
    """A lattice mast, upright or fallen."""
    width = rng.uniform(0.4, 0.7)
    bays = int(rng.integers(3, 6))
    radius = rng.uniform(0.015, 0.03)
    legs = np.array([[0, 0, 0], [width, 0, 0], [width / 2, width * 0.87, 0]])
    top = bays * width
    parts = [bars(zip(legs, legs + np.array([0, 0, top]), strict=True), radius)]
    for level, k in itertools.product(range(bays), range(3)):
        low, high = (legs + np.array([0, 0, up * width]) for up in (level, level + 1))
        parts.append(bars([(high[k], high[k - 2])], radius * 0.8))
        parts.append(bars([(low[k], high[k - 2])], radius * 0.7))
    mast = join(parts).tinted(pick(rng, BARS)).moved((-width / 2, -width / 2, 0))
    if rng.random() < 0.5:
        mast = mast.turned("y", np.pi / 2 - 0.06).moved((-top / 2, 0, 0))
    return mast.standing()


def _nursery(rng: Draws) -> Mesh:
    """A table of slats on legs, with corals planted on it."""
    length, width, height = rng.uniform([1.2, 0.6, 0.5], [2.2, 1.0, 0.9]).tolist()
    parts = []
    left = -width / 2
    right = width / 2
    for x in (-length / 2, length / 2):
        parts.append(bars((((x, y, 0), (x, y, height)) for y in (left, right)), 0.028))
        parts.append(bars([((x, left, height * 0.45), (x, right, height * 0.45))], 0.02))
    parts += [box((length + 0.1, 0.06, 0.03), (0, y, height)) for y in np.linspace(left, right, 5)]
    parts = [join(parts).tinted(pick(rng, (RUST, STEEL, (0.2, 0.18, 0.15))))]
    for _ in range(int(rng.integers(5, 11))):
        place = (rng.uniform(-0.45, 0.45) * length, rng.uniform(-0.4, 0.4) * width, height)
        parts.append(coral(rng).moved(scale=0.55).turned("z", rng.uniform(0, 6)).moved(place))
    return join(parts)


def block(rng: Draws) -> Mesh:
    """Concrete: a cube, slab, cinder block with holes, tetrapod, ring or kerb stone."""
    colour = pick(rng, CONCRETE)
    form = int(rng.choice(6, p=[0.24, 0.14, 0.2, 0.16, 0.14, 0.12]))
    if form == 0:
        whole = box((rng.uniform(0.35, 1.0) * rng.uniform(0.8, 1.2, 3)).tolist())
    elif form == 1:
        whole = box(rng.uniform([0.8, 0.5, 0.1], [1.8, 1.0, 0.2]).tolist())
    elif form == 2:  # two side walls, three webs
        length = rng.uniform(0.4, 0.75)
        width = length * 0.48
        wall = length * 0.085
        apart = (width - wall) / 2
        along = (length - wall) / 2
        walls = [box((length, wall, width), (0, y, 0)) for y in (-apart, apart)]
        web = wall, width - 2 * wall, width
        whole = join([*walls, *(box(web, (x, 0, 0)) for x in (-along, 0, along))])
    elif form == 3:  # four blunt legs toward the corners of a tetrahedron
        profile = np.array([[0.34, 0.0], [0.24, 0.92], [0.18, 1.0], [0, 1.0]])
        leg = lathe(profile * rng.uniform(0.45, 0.95), 18, crease=True)
        turns = ((k * 2 * np.pi / 3, np.arccos(-1 / 3)) for k in range(3))
        whole = join([leg, *(leg.turned("zy", *turn) for turn in turns)]).standing()
    elif form == 4:
        outer = rng.uniform(0.35, 0.75)
        height = rng.uniform(0.3, 0.6)
        ring = [[0.8, 0], [1, 0], [1, height], [0.8, height], [0.8, 0]]
        whole = lathe(np.array(ring) * [outer, 1], 36, crease=True)
    else:
        outline = [[-0.3, 0], [0.3, 0], [0.3, 0.12], [0.12, 0.35], [0.09, 0.8], [-0.09, 0.8],
                   [-0.12, 0.35], [-0.3, 0.12]]  # fmt: skip
        length = rng.uniform(1.0, 2.0)
        size = rng.uniform(0.6, 1.0)
        whole = prism(np.array(outline) * size, length).turned("x", np.pi / 2)
    whole = whole.tinted(colour)
    if form in (0, 1, 2) and rng.random() < 0.4:
        whole = whole.turned("xy", rng.uniform(-0.5, 0.5), rng.uniform(0, 0.4)).standing()
        # What stands on an edge has dug itself in.
        return whole.moved((0, 0, -0.25 * float(whole.vertices[:, 2].max())))
    return whole.standing()


def anchor(rng: Draws) -> Mesh:
    """An admiralty anchor on its side, one fluke up, with stock and ring."""
    size = rng.uniform(0.7, 1.7)
    metal = pick(rng, (RUST, RUST, STEEL))
    shank = bars([((0, 0, 0), (0, 0, 1.0))], 0.045, 10)
    bend = np.linspace(-1.05, 1.05, 15)
    arms = np.column_stack([0.46 * np.sin(bend), np.zeros(15), 0.42 * (1 - np.cos(bend))])
    crown = tube(arms, 0.05 - 0.018 * np.abs(bend), 10)
    stock = bars([((0, -0.42, 0.9), (0, 0.42, 0.9))], 0.03)
    eye = tube(circle(18)[:, [0, 2, 1]] * 0.07 + [0, 0, 1.06], 0.018, 8, closed=True)
    palm = prism([[-0.13, -0.1], [0.13, -0.1], [0, 0.2]], 0.025).turned("z", np.pi / 2)
    flukes = [
        palm.turned("yx", side * -0.62, np.pi / 2).moved((side * 0.37, 0, 0.2))
        for side in (-1.0, 1.0)
    ]
    whole = join([shank, crown, stock, eye, *flukes]).tinted(metal).moved(scale=size)
    roll = rng.uniform(-0.25, 0.25)
    lean = np.pi / 2 + rng.uniform(-0.2, 0.1)
    laid = whole.turned("z", rng.uniform(0.9, 1.3)).turned("xy", roll, lean).standing()
    return laid.moved((-size / 2, 0, -0.06 * size))


def curve(rng: Draws, start: Float64s, length_m: float, wander: float) -> Float64s:
    """(N, 2) points every 5 cm from `start` along a heading that wanders."""
    count = max(int(length_m / 0.05), 8)
    turns = np.interp(np.arange(count), np.linspace(0, count, 9), rng.normal(0, wander, 9))
    heading = rng.uniform(0, 2 * np.pi) + np.cumsum(turns * 0.05)
    steps = 0.05 * np.column_stack([np.cos(heading), np.sin(heading)])
    return np.asarray(start + np.cumsum(steps, axis=0) - steps.sum(axis=0) / 2)


def chain(rng: Draws, line: Float64s, ground: GroundHeight) -> Mesh:
    """Studless links along a line on the ground, every second one on edge."""
    wire = float(rng.uniform(0.016, 0.04))
    pitch = wire * 3.9
    metal = pick(rng, (RUST, RUST, STEEL))
    bend = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    long = 1.5 * wire * np.cos(bend) + 1.25 * wire * np.sign(np.cos(bend))
    ring = np.column_stack([long, 1.3 * wire * np.sin(bend), np.zeros(16)])
    link = tube(ring, wire / 2, 7, closed=True, colour=metal)
    position = np.arange(0, 0.05 * (len(line) - 1), pitch) / 0.05
    x, y = (np.interp(position, np.arange(len(line)), axis) for axis in line.T)
    z = np.asarray(ground(x, y), dtype=np.float64) + 0.6 * wire
    heading = np.arctan2(np.gradient(y), np.gradient(x))
    climb = np.arctan2(np.gradient(z), pitch)
    links = []
    for k, place in enumerate(zip(x, y, z, strict=True)):
        roll = (np.pi / 2 if k % 2 else 0.0) + rng.normal(0, 0.25)
        links.append(link.turned("zyx", heading[k], -climb[k], roll).moved(place))
    return join(links)


def pipe(rng: Draws, line: Float64s, ground: GroundHeight) -> Mesh:
    """A pipe along a line, part buried, bridging hollows, with flanges."""
    radius = float(rng.uniform(0.07, 0.3))
    paint = pick(rng, (RUST, STEEL, PAINTS[3], PAINTS[1], (0.3, 0.3, 0.28)))
    x, y = line[::3].T
    z = np.asarray(ground(x, y), dtype=np.float64)
    stiff = min(8, max(len(z) // 2, 1))
    padded = np.pad(z, stiff, mode="edge")
    bridged = np.convolve(padded, np.ones(2 * stiff + 1) / (2 * stiff + 1), mode="valid")
    z = np.maximum(bridged, z - radius) + radius * rng.uniform(0.3, 1.0)
    path = np.column_stack([x, y, z])
    parts = [rough(tube(path, radius, 24, colour=paint), rng, 0.03 * radius, 1.0, 0.15)]
    for k in range(int(rng.integers(6, 14)), len(path) - 2, int(rng.integers(18, 30))):
        along = path[k + 1] - path[k]
        along /= np.linalg.norm(along)
        for side in (-0.02, 0.05):
            ends = path[k] + np.outer([side, side + 0.05], along)
            parts.append(tube(ends, radius * 1.32, 24, colour=paint * 0.8))
    return join(parts)


def pile(rng: Draws, height_m: float, radius_m: float) -> Mesh:
    """A round pile with marine growth, from 1 m below the ground to `height_m`."""
    levels = np.linspace(-1.0, height_m, 90)
    bare = pick(rng, (*CONCRETE, RUST))
    grown = np.array([0.16, 0.15, 0.09])
    growth = smoothstep(0.3, 1.2, levels * rng.uniform(0.4, 1.2))[:, None]
    path = np.column_stack([np.zeros((90, 2)), levels])
    shaft = tube(path, radius_m, 40, colour=bare * (1 - growth) + grown * growth)
    return rough(shaft, rng, 0.06 * radius_m + 0.006, 0.7, 0.09)


def brace(rng: Draws, start: Float64s, end: Float64s) -> Mesh:
    """A beam between two piles, overgrown."""
    path = start + np.linspace(0, 1, 30)[:, None] * (end - start)
    beam = tube(path, rng.uniform(0.07, 0.12), 14, colour=pick(rng, (RUST, STEEL, CONCRETE[1])))
    return rough(beam, rng, 0.012, 0.6, 0.08)


def quay(rng: Draws, length_m: float, height_m: float) -> Mesh:
    """A wall along the x axis, facing -y: courses of blocks, and buttresses."""
    colour = pick(rng, CONCRETE)
    parts = []
    course = rng.uniform(0.5, 0.9)
    width = rng.uniform(1.0, 2.0)
    rows = int(np.ceil((height_m + 1) / course))
    columns = int(np.ceil(length_m / width))
    for row, column in itertools.product(range(rows), range(-1, columns)):
        x = (column + 0.5 * (row % 2)) * width - length_m / 2
        shade = colour * rng.uniform(0.75, 1.15)
        y = 0.3 + rng.uniform(-0.025, 0.025)
        centre = (x + width / 2, y, -1 + (row + 0.5) * course)
        parts.append(box((width - 0.025, 0.6, course - 0.025), centre, shade))
    back = (length_m + width, 0.5, height_m + 1), (0, 0.56, height_m / 2 - 0.5)
    parts.append(box(*back, (0.05, 0.05, 0.05)))
    for x in np.arange(-length_m / 2 + rng.uniform(1, 3), length_m / 2, rng.uniform(4, 6)):
        if rng.random() < 0.5:
            centre = (x, -0.2, height_m / 2 - 0.5)
            parts.append(box((0.5, 0.6, height_m + 1), centre, colour * 0.9))
    return join(parts)


def fender(rng: Draws) -> Mesh:
    """A tyre hung flat against a wall that faces -y, centred on its hub."""
    shape = tire(rng)
    centred = shape.moved(-0.5 * (shape.vertices.min(axis=0) + shape.vertices.max(axis=0)))
    # The thinnest direction is the hub's axis, whatever way the tyre lay.
    thin = int(np.argmin(np.ptp(centred.vertices, axis=0)))
    return centred.turned("zyx"[thin], (np.pi / 2, 0, np.pi / 2)[thin])


def sheet_pile(rng: Draws, length_m: float, height_m: float) -> Mesh:
    """A steel sheet-pile wall along the x axis, facing -y: a folded face."""
    pitch = rng.uniform(0.8, 1.4)
    depth = rng.uniform(0.2, 0.4)
    x = np.arange(-length_m / 2, length_m / 2, pitch / 4)
    y = np.where(np.arange(len(x)) % 4 < 2, 0.0, depth)
    levels = np.linspace(-1, height_m, 20)
    parts = []
    steps = np.arange(19, dtype=np.int32)[:, None] * 2
    quads = np.concatenate([steps + np.array(to, np.int32) for to in ([0, 1, 3], [0, 3, 2])])
    for k in range(len(x) - 1):
        edges = [np.column_stack([np.full((20, 2), (x[n], y[n])), levels]) for n in (k, k + 1)]
        parts.append(replace(sheet(np.stack(edges, axis=1), RUST), triangles=quads))
    return join(parts)


_BUILD: dict[str, Callable[[Draws], Mesh]] = {
    "Bottle": lambda rng: lying(standing_bottle(rng)), "Standing-bottle": standing_bottle,
    "Shampoo-bottle": shampoo_bottle, "Can": can, "Drink-carton": drink_carton, "Barrel": barrel,
    "Hook": hook, "Propeller": propeller, "Tire": tire, "Valve": valve, "Anchor": anchor,
    "Boulder": boulder, "Pebble": pebble, "Block": block, "Frame": frame, "Coral": coral,
    "Plant": plant,
}  # fmt: skip
_MODELS = 24  # of a kind, each turned, scaled and tinted anew wherever it lies


@functools.cache
def model(kind: str, number: int) -> Mesh:
    """One of the models of a kind of object, at rest on z = 0; drawn once a process."""
    return _BUILD[kind](stream(WORLD_SEED, "seabed", "model", kind, number))


def drawn_moving_model(rng: Draws, kind: str) -> Mesh:
    """A model of any built-in object that moves by itself, as `drawn_model` gives those that lie.

    Chains, pipes, pillars and walls are pieces of 1 to 3 m, not parts of a place.
    """
    build_piece = _PIECES.get(kind)
    return drawn_model(rng, kind) if build_piece is None else build_piece(rng)


def _chain_piece(rng: Draws) -> Mesh:
    line = curve(rng, np.zeros(2), float(rng.uniform(1.0, 2.0)), wander=1.5)
    return chain(rng, line, _flat_ground)


def _pipe_piece(rng: Draws) -> Mesh:
    line = curve(rng, np.zeros(2), float(rng.uniform(1.5, 3.0)), wander=0.0)
    return pipe(rng, line, _flat_ground)


def _pillar_piece(rng: Draws) -> Mesh:
    height_m = float(rng.uniform(0.5, 1.5))
    return pile(rng, height_m, float(rng.uniform(0.1, 0.25)))


def _wall_piece(rng: Draws) -> Mesh:
    length_m = float(rng.uniform(1.0, 2.5))
    height_m = float(rng.uniform(0.6, 1.5))
    thickness_m = float(rng.uniform(0.12, 0.3))
    return box((length_m, thickness_m, height_m), colour=pick(rng, CONCRETE))


def _flat_ground(x: Float64s, y: Float64s) -> Float32s:
    return np.zeros(x.shape, np.float32)


_PIECES: dict[str, Callable[[Draws], Mesh]] = {
    "Chain": _chain_piece,
    "Pipe": _pipe_piece,
    "Pillar": _pillar_piece,
    "Wall": _wall_piece,
}


def drawn_model(rng: Draws, kind: str) -> Mesh:
    """A model of a kind, chosen at random, a little larger or smaller, lighter or darker."""
    shape = model(kind, int(rng.integers(_MODELS)))
    size = rng.uniform(0.9, 1.1)
    shade = np.float32(rng.uniform(0.85, 1.15))
    turned = shape.moved(scale=size).turned("z", rng.uniform(0, 2 * np.pi))
    return replace(turned, colours=turned.colours * shade)
