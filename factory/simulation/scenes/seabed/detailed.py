"""Detailed models of the classes that detectors look for: several builders of each.

A builder draws size and colours and returns a mesh that rests on z = 0, plain geometry in metres,
so that other places and moving objects can use it.  Sizes are those of real things; edges, ribs,
links and slats are modelled where a sonar of high frequency resolves them.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ....common.array_types import Draws, Float64s
from ....common.seeds import stream
from ...meshes.camera import WORLD_SEED
from ...meshes.triangle_mesh import (
    Mesh,
    bars,
    box,
    circle,
    join,
    lathe,
    rough,
    sheet,
    sphere,
    tube,
)
from ...meshes.waves import Waves
from . import things
from .terrain import pick
from .things import BRONZE, GLASS, PAINTS, RUST, STEEL, curve, lying

Builder = Callable[[Draws], Mesh]

_PALE = (0.72, 0.72, 0.70)
_METALS = (RUST, RUST, STEEL)
_MODELS = 96
"""Models of a class, each turned, scaled and tinted anew wherever it lies."""


# --- tyres ------------------------------------------------------------------------------------


def car_tyre(rng: Draws) -> Mesh:
    """A tyre with blocks of tread and ribs on its sidewalls; with or without its rim."""
    outer = 0.1 * 3.2 ** float(rng.random())
    width = outer * rng.uniform(0.4, 0.75)
    rim = outer * rng.uniform(0.5, 0.68)
    rubber = np.array([0.05, 0.05, 0.053]) * rng.uniform(0.8, 1.6)
    shape = _ribbed(rng, _carcass(outer, rim, width, rubber), outer, rim, width)
    if rng.random() < 0.35:
        shape = join([shape, _rim(rng, rim, width)])
    lean = rng.choice([0.0, 0.25, 1.2, np.pi / 2], p=[0.6, 0.16, 0.1, 0.14])
    return shape.turned("x", lean + rng.uniform(-0.06, 0.06)).standing()


def _carcass(outer: float, rim: float, width: float, colour: Float64s) -> Mesh:
    """The hollow body: outside, tread and inside, 96 segments around."""
    deep = outer - rim
    radii = [rim, rim + 0.12 * deep, rim + 0.45 * deep, rim + 0.8 * deep, 0.97 * outer, outer]
    half = np.column_stack([radii, [-0.34, -0.44, -0.5, -0.48, -0.42, -0.34]])
    tread = np.array([[outer, -0.17], [outer, 0.0]])
    hollow = np.array([[rim + 0.1 * deep, 0.36], [rim + 0.7 * deep, 0.43], [outer * 0.93, 0.3]])
    mirror = [1, -1]
    profile = [half, tread, tread[:1] * mirror, half[::-1] * mirror]
    profile += [hollow, hollow[::-1] * mirror, half[:1]]
    return lathe(np.concatenate(profile) * [1, width], 96, colour)


def _ribbed(rng: Draws, carcass: Mesh, outer: float, rim: float, width: float) -> Mesh:
    """The carcass with grooves across its tread and radial ribs on its sidewalls."""
    x, y, z = carcass.vertices.T.astype(np.float64)
    radius = np.hypot(x, y)
    angle = np.arctan2(y, x)
    blocks = int(rng.integers(12, 24))
    groove = np.sin(blocks * angle + 3 * np.sign(z) * np.abs(z) / width) > 0.55
    is_tread = radius > 0.96 * outer
    depth = rng.uniform(0.01, 0.035) * outer
    radius = radius - depth * (groove & is_tread)
    ribs = int(rng.integers(16, 40))
    is_side = (radius > rim) & (radius < 0.96 * outer) & (np.abs(z) > 0.4 * width)
    height = rng.uniform(0.0, 0.02) * outer
    z = z + np.sign(z) * height * is_side * (np.cos(ribs * angle) > 0.3)
    points = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), z])
    return replace(carcass, vertices=points.astype(np.float32))


def _rim(rng: Draws, rim: float, width: float) -> Mesh:
    """A steel wheel in a tyre: a dished disc with holes, or spokes."""
    level = rng.uniform(-0.2, 0.3) * width
    metal = pick(rng, _METALS)
    profile = [[0.16, 0.1], [0.3, 0.06], [0.5, -0.02], [0.86, 0.0], [0.98, 0.22], [1.02, 0.34]]
    dish = np.array(profile) * [rim, width] + [0, level * 0.5]
    if rng.random() < 0.5:
        return lathe(dish, 40, metal)
    hub = lathe(
        np.array([[0, 0.2], [0.22, 0.2], [0.22, -0.2], [0, -0.2]]) * [rim, width], 18, metal
    )
    count = int(rng.integers(4, 9))
    spokes = bars([((0, 0, level), tuple(end)) for end in circle(count) * rim + [0, 0, level]],
                  0.07 * rim, 7)  # fmt: skip
    hoop = tube(circle(30) * rim * 0.98, 0.05 * rim, 7, closed=True)
    return join([hub, spokes.tinted(metal), hoop.tinted(metal)])


def inner_tube(rng: Draws) -> Mesh:
    """A smooth tube or a ring buoy, slightly squashed."""
    radius = rng.uniform(0.08, 0.22)
    thick = radius * rng.uniform(0.16, 0.34)
    ring = tube(
        circle(48) * radius, thick, 14, closed=True, colour=pick(rng, (PAINTS[6], PAINTS[1]))
    )
    return ring.moved(scale=(1.0, rng.uniform(0.8, 1.0), rng.uniform(0.6, 1.0))).standing()


# --- chains -----------------------------------------------------------------------------------


def _link(wire: float, long: float, wide: float, stud: bool, colour: Float64s) -> Mesh:
    """A link along x: an oval of round wire, perhaps with a stud across; sizes in wires."""
    bend = np.linspace(0, 2 * np.pi, 18, endpoint=False)
    straight = (long - wide) / 2
    x = wide / 2 * np.cos(bend) + straight * np.sign(np.cos(bend))
    ring = np.column_stack([x, wide / 2 * np.sin(bend), np.zeros(18)]) * wire
    parts = [tube(ring, wire / 2, 7, closed=True, colour=colour)]
    if stud:
        end = 0.5 * wide * wire
        parts.append(tube(np.array([[0, -end, 0], [0, end, 0]]), 0.4 * wire, 6, colour=colour))
    return join(parts)


def _linked(rng: Draws, line: Float64s, wire: float) -> Mesh:
    """Links along an (N, 3) line of points 5 cm apart, every second one on edge."""
    colour = pick(rng, _METALS)
    long = rng.uniform(3.6, 4.6)
    wide = rng.uniform(2.2, 2.8)
    link = _link(wire, long, wide, bool(rng.random() < 0.3), colour)
    pitch = wire * (long - 1.0)
    steps = np.sqrt((np.diff(line, axis=0) ** 2).sum(axis=1))
    travelled = np.append(0, np.cumsum(steps))
    at = np.arange(0, travelled[-1], pitch)
    places = np.stack([np.interp(at, travelled, axis) for axis in line.T], axis=-1)
    heading = np.arctan2(np.gradient(places[:, 1]), np.gradient(places[:, 0]))
    links = []
    for number, place in enumerate(places):
        roll = (np.pi / 2 if number % 2 else 0.0) + rng.normal(0, 0.35)
        jitter = rng.normal(0, 0.06, 2)
        turned = link.turned("zyx", heading[number] + jitter[0], jitter[1], roll)
        links.append(turned.moved(place))
    return join(links)


def laid_chain(rng: Draws) -> Mesh:
    """A chain in one or several bends, laid beside itself now and then."""
    wire = float(rng.uniform(0.012, 0.034))
    runs = []
    for number in range(int(rng.choice([1, 1, 2, 3]))):
        line = curve(rng, np.zeros(2), rng.uniform(0.5, 1.8), rng.uniform(0.8, 3.0))
        line = line - line.mean(axis=0) + rng.normal(0, 0.05, 2) * number
        runs.append(_linked(rng, np.column_stack([line, np.full(len(line), 1.3 * wire)]), wire))
    return join(runs).standing()


def loose_chain(rng: Draws) -> Mesh:
    """A heavy chain as it falls: it runs to and fro, with ground between the runs."""
    wire = float(rng.uniform(0.014, 0.032))
    headings = []
    heading = 0.0
    for number in range(int(rng.integers(2, 5))):
        heading = number * np.pi + rng.normal(0, 0.35)
        steps = int(rng.integers(10, 34))
        wander = np.interp(np.arange(steps), np.linspace(0, steps, 5), rng.normal(0, 0.35, 5))
        headings.append(heading + wander)
    # Bends are as wide as a chain lets them be.
    turned = np.convolve(np.pad(np.concatenate(headings), 2, mode="edge"), np.ones(5) / 5, "valid")
    line = np.cumsum(0.05 * np.column_stack([np.cos(turned), np.sin(turned)]), axis=0)
    line = line - (line.min(axis=0) + line.max(axis=0)) / 2
    level = np.full(len(line), 1.3 * wire)
    return _linked(rng, np.column_stack([line, level]), wire).standing()


def tailed_chain(rng: Draws) -> Mesh:
    """A long heavy chain, doubled, whose end lies aside: a broad band with a tail."""
    wire = float(rng.uniform(0.013, 0.028))
    length = rng.uniform(0.7, 1.7)
    apart = wire * rng.uniform(1.4, 3.5)
    bend = rng.uniform(-0.25, 0.25) * length
    count = int(length / 0.05)
    points = []
    for lane in range(int(rng.integers(1, 4))):
        along = np.linspace(-0.5, 0.5, count) * (1 if lane % 2 else -1)
        sway = np.interp(np.arange(count), np.linspace(0, count, 6), rng.normal(0, 1.2 * wire, 6))
        across = lane * apart + 4 * bend * along**2 + sway
        points.append(np.column_stack([along * length, across]))
    middle = points[-1][int(rng.integers(count // 3, count))]
    tail = curve(rng, np.zeros(2), rng.uniform(0.25, 0.6) * length, 0.8)
    tail = tail - tail[0]
    points.append(tail * np.where(rng.random() < 0.5, 1, -1) + middle)
    line = np.concatenate(points)
    level = np.full(len(line), 1.3 * wire)
    return _linked(rng, np.column_stack([line, level]), wire).standing()


def branched_chain(rng: Draws) -> Mesh:
    """A long heavy chain in two or three arms, of one or two strands, that meet in a knot."""
    wire = float(rng.uniform(0.014, 0.03))
    first = rng.uniform(0, 2 * np.pi)
    points = []
    for arm in range(int(rng.integers(2, 4))):
        length = rng.uniform(0.35, 1.0)
        count = int(length / 0.05)
        heading = first + arm * rng.uniform(1.4, 2.6)
        turns = np.interp(np.arange(count), np.linspace(0, count, 5), rng.normal(0, 0.3, 5))
        steps = 0.05 * np.column_stack([np.cos(heading + turns), np.sin(heading + turns)])
        outward = np.cumsum(steps, axis=0)
        strand_side = np.array([-np.sin(heading), np.cos(heading)]) * wire * rng.uniform(1.5, 4)
        # The chain runs out along an arm and back beside itself.
        points += [outward, outward[::-1] + strand_side * (rng.random() < 0.6)]
    line = np.concatenate(points)
    return _linked(rng, np.column_stack([line, np.full(len(line), 1.3 * wire)]), wire).standing()


def chain_heap(rng: Draws) -> Mesh:
    """A heap of chain: turns on top of each other."""
    wire = float(rng.uniform(0.012, 0.03))
    turns = rng.uniform(2.0, 4.5)
    angle = np.linspace(0, 2 * np.pi * turns, int(28 * turns))
    reach = rng.uniform(0.1, 0.28) * (1 + 0.25 * np.sin(2.3 * angle + rng.uniform(0, 6)))
    level = 1.3 * wire + wire * angle / (2 * np.pi) * rng.uniform(0.4, 1.4)
    path = np.column_stack([reach * np.cos(angle), reach * np.sin(angle), level])
    return _linked(rng, path, wire).standing()


# --- propellers -------------------------------------------------------------------------------


def screw(rng: Draws) -> Mesh:
    """A propeller whose blades are helicoids of one pitch, flat on its hub or leaning."""
    radius = rng.uniform(0.13, 0.34)
    blades = int(rng.integers(3, 6))
    metal = pick(rng, (BRONZE, BRONZE, STEEL, RUST))
    pitch = rng.uniform(0.7, 1.3)  # over the diameter
    hub = rng.uniform(0.16, 0.24)
    blade = _helicoid_blade(rng, pitch, hub, rng.uniform(0.5, 0.95) * np.pi / blades)
    parts = [blade.turned("z", 2 * np.pi * k / blades) for k in range(blades)]
    profile = [[0, -0.2], [0.9, -0.2], [1, -0.12], [1, 0.14], [0.7, 0.24], [0, 0.3]]
    parts.append(lathe(np.array(profile) * [hub, 1], 22))
    if rng.random() < 0.3:
        parts.append(tube(np.array([[0, 0, -0.2], [0, 0, rng.uniform(-1.4, -0.5)]]), 0.07, 10))
    whole = join(parts).moved(scale=radius).tinted(metal)
    lean = rng.choice([0.0, np.pi, 1.2, np.pi / 2], p=[0.35, 0.2, 0.25, 0.2])
    return whole.turned("xz", lean + rng.uniform(-0.15, 0.15), rng.uniform(0, 6.3)).standing()


def _helicoid_blade(rng: Draws, pitch: float, hub: float, half_angle: float) -> Mesh:
    """One blade of a propeller of radius 1: z = pitch / pi times the angle around the axis.

    pitch: advance in one turn over the diameter.  half_angle: of the sector that it fills, rad.
    """
    along, across = np.meshgrid(np.linspace(0, 1, 14), np.linspace(-1, 1, 11), indexing="ij")
    radius = hub * 0.8 + (1 - hub * 0.8) * along
    fullness = rng.uniform(0.5, 0.8)  # where the blade is widest
    outline = np.sqrt(np.maximum(1 - ((along - fullness) / (1.001 - fullness)) ** 2, 0))
    inner = 0.45 + 0.55 * np.sin(np.pi / 2 * np.minimum(along / fullness, 1))
    width = np.where(along > fullness, outline, inner)
    skew = rng.uniform(0, 0.5) * half_angle * along**2
    angle = across * width * half_angle + skew
    thick = (0.035 - 0.022 * along) * (1 - across**2) + 0.006
    x = radius * np.cos(angle)
    y = radius * np.sin(angle)
    z = pitch / np.pi * angle
    return join(
        sheet(np.stack([x, y, z + side * thick], axis=-1), turned=side < 0) for side in (1.0, -1.0)
    )


def outlined_screw(rng: Draws) -> Mesh:
    """A propeller as its hub and the rims of its blades.

    A smooth blade throws sound away from the sonar; its rim and its root echo, as oval loops.
    """
    radius = rng.uniform(0.11, 0.2)
    blades = int(rng.choice([2, 3, 3, 3, 4]))
    thick = rng.uniform(0.025, 0.055)
    angle = circle(26)
    loop = np.column_stack(
        [0.62 + 0.4 * angle[:, 0], rng.uniform(0.2, 0.32) * angle[:, 1], 0.25 * angle[:, 1]]
    )
    parts = [
        tube(loop, thick, 6, closed=True).turned("z", 2 * np.pi * k / blades) for k in range(blades)
    ]
    hub = rng.uniform(0.14, 0.24)
    profile = [[0, -0.3], [0.8, -0.3], [1, 0], [0.7, 0.3], [0, 0.4]]
    parts.append(lathe(np.array(profile) * [hub, rng.uniform(0.8, 1.6)], 14))
    if rng.random() < 0.5:
        parts.append(tube(np.array([[0, 0, 0], [0, 0, -rng.uniform(0.5, 1.5)]]), 0.08, 8))
    whole = join(parts).moved(scale=radius).tinted(pick(rng, (BRONZE, STEEL, RUST)))
    lean = rng.choice([0.0, 0.3, 1.2, np.pi / 2], p=[0.4, 0.2, 0.15, 0.25])
    return whole.turned("zx", rng.uniform(0, 6.3), lean + rng.uniform(-0.15, 0.15)).standing()


def outboard(rng: Draws) -> Mesh:
    """The lower end of an outboard motor: a small screw on a torpedo with a leg and a fin."""
    small = _helicoid_blade(rng, 0.9, 0.3, 0.8).moved(scale=0.12)
    parts = [small.turned("z", 2 * np.pi * k / 3) for k in range(3)]
    profile = np.array(
        [[0, -0.06], [0.04, -0.05], [0.055, 0.1], [0.05, 0.28], [0.02, 0.36], [0, 0.37]]
    )
    parts.append(lathe(profile, 18))
    parts.append(box((0.04, 0.4, 0.12), (0, 0.22, 0.16)))
    parts.append(box((0.02, 0.12, 0.1), (0, -0.09, 0.2)))
    whole = join(parts).tinted(pick(rng, (PAINTS[6], STEEL, PAINTS[3])))
    return whole.turned("xz", np.pi / 2 + rng.uniform(-0.3, 0.3), rng.uniform(0, 6.3)).standing()


# --- bottles ----------------------------------------------------------------------------------


def _bottle(rng: Draws, slender: bool) -> Mesh:
    """A glass bottle, upright: of wine or beer."""
    height = rng.uniform(0.27, 0.34) if slender else rng.uniform(0.2, 0.28)
    radius = rng.uniform(0.034, 0.046)
    neck = radius * rng.uniform(0.3, 0.42)
    shoulder = rng.uniform(0.5, 0.66)
    radii = [0, 0.9, 1, 1, 1, 0.85, 0.55]
    levels = [0.02, 0, 0.03, 0.2, shoulder, shoulder + 0.07, shoulder + 0.13]
    body = np.column_stack([np.array(radii) * radius, levels])
    top = [
        [neck, 0.82],
        [neck, 0.94],
        [neck * 1.3, 0.95],
        [neck * 1.3, 0.98],
        [neck, 1.0],
        [0, 0.99],
    ]
    return lathe(np.concatenate([body, top]) * [1, height], 26, pick(rng, GLASS))


def lying_bottle(rng: Draws) -> Mesh:
    """A smooth bottle on its side."""
    return lying(_bottle(rng, bool(rng.random() < 0.6)))


def lined_bottle(rng: Draws) -> Mesh:
    """A bottle on its side as an open cage of staves.

    A glass bottle full of water echoes from its front and back walls and between them, in lines
    along its axis one behind the other.  Staves around the same cylinder stand at these ranges.
    """
    length = rng.uniform(0.2, 0.33)
    radius = rng.uniform(0.032, 0.05)
    neck = length * rng.uniform(0.25, 0.4)
    count = int(rng.integers(7, 12))
    thick = radius * rng.uniform(0.1, 0.2)
    glass = pick(rng, GLASS)
    staves = []
    for k in range(count):
        turn = 2 * np.pi * k / count
        outward = np.array([0, np.cos(turn), np.sin(turn)])
        body = [
            [-length / 2, 0, 0] + outward * radius,
            [length / 2 - neck, 0, 0] + outward * radius,
        ]
        end = [length / 2, 0, 0] + outward * radius * 0.35
        staves.append(tube(np.array([*body, end]), thick, 6))
    hoops = [_hoop(x, radius, thick) for x in (-length / 2, length / 2 - neck)]
    return join([*staves, *hoops]).tinted(glass).turned("z", rng.uniform(0, 6.3)).standing()


def striped_bottle(rng: Draws) -> Mesh:
    """A large bottle on its side as a few bars side by side, which lie on an arch.

    Like `lined_bottle`, with lines farther apart: sound that went through the glass to and fro
    arrives later, as if from lines behind the bottle.
    """
    length = rng.uniform(0.22, 0.42)
    count = int(rng.integers(3, 7))
    apart = rng.uniform(0.022, 0.045)
    thick = rng.uniform(0.004, 0.01)
    height = rng.uniform(0.03, 0.07)
    bars_of_glass = []
    for number in range(count):
        y = (number - (count - 1) / 2) * apart
        z = height * np.sin(np.pi * (number + 0.5) / count)
        first = -length / 2 * rng.uniform(0.6, 1.0)
        last = length / 2 * rng.uniform(0.6, 1.0)
        bars_of_glass.append(tube(np.array([[first, y, z], [last, y, z]]), thick, 6))
    whole = join(bars_of_glass).tinted(pick(rng, GLASS))
    return whole.turned("z", rng.uniform(0, 6.3)).standing()


def outlined_bottle(rng: Draws) -> Mesh:
    """A large bottle on its side as its outline: two long edges that meet at the neck."""
    length = rng.uniform(0.2, 0.36)
    radius = rng.uniform(0.035, 0.075)
    thick = rng.uniform(0.004, 0.009)
    neck = radius * rng.uniform(0.15, 0.4)
    shoulder = length * rng.uniform(0.15, 0.6)
    sides = []
    for side in (-1.0, 1.0):
        edge = [[0, side * radius, 0], [shoulder, side * radius, 0], [length, side * neck, 0]]
        sides.append(tube(np.array(edge), thick, 6))
    ends = [((0, -radius, 0), (0, radius, 0)), ((length, -neck, 0), (length, neck, 0))]
    parts = [*sides, bars(ends[: int(rng.integers(1, 3))], thick, 6)]
    if rng.random() < 0.4:
        parts.append(bars([((0.1 * length, 0, radius), (0.8 * length, 0, radius))], thick, 6))
    whole = join(parts).tinted(pick(rng, GLASS))
    return whole.turned("x", rng.uniform(-0.3, 0.3)).turned("z", rng.uniform(0, 6.3)).standing()


def _hoop(x: float, radius: float, thick: float) -> Mesh:
    """A ring around the x axis."""
    ring = circle(20)[:, [2, 0, 1]] * radius
    return tube(ring + np.array([x, 0, 0]), thick, 6, closed=True)


def flask(rng: Draws) -> Mesh:
    """A plastic bottle with rings, on its side, perhaps crushed."""
    length = rng.uniform(0.18, 0.34)
    radius = rng.uniform(0.03, 0.055)
    levels = np.linspace(0, 0.75, 25)
    rings = 1 - rng.uniform(0.03, 0.1) * (np.sin(levels * rng.uniform(30, 60)) > 0.2)
    body = np.column_stack([rings * radius, levels])
    top = [[0.8 * radius, 0.82], [0.35 * radius, 0.9], [0.35 * radius, 1.0], [0, 1.0]]
    whole = lathe(np.concatenate([[[0, 0]], body, top]) * [1, length], 24, pick(rng, PAINTS))
    squash = rng.uniform(0.5, 1.0)
    return lying(whole).moved(scale=(1.0, 1.0, squash)).standing()


def upright_bottle(rng: Draws) -> Mesh:
    """A bottle that stands."""
    return _bottle(rng, bool(rng.random() < 0.5))


def upright_jar(rng: Draws) -> Mesh:
    """A jar or flask that stands, with its lid."""
    height = rng.uniform(0.14, 0.26)
    radius = rng.uniform(0.035, 0.06)
    profile = [[0, 0], [1, 0], [1, 0.75], [0.7, 0.84], [0.72, 0.86], [0.72, 1], [0, 1]]
    return lathe(
        np.array(profile) * [radius, height], 26, pick(rng, (*GLASS, PAINTS[3])), crease=True
    )


def slender_bottle(rng: Draws) -> Mesh:
    """A narrow plastic bottle that stands or leans: it echoes little and casts a long shadow."""
    height = rng.uniform(0.19, 0.32)
    radius = height * rng.uniform(0.09, 0.14)
    profile = [[0, 0], [1, 0], [1, 0.7], [0.8, 0.82], [0.4, 0.88], [0.4, 1], [0, 1]]
    whole = lathe(np.array(profile) * [radius, height], 24, pick(rng, PAINTS))
    flat = whole.moved(scale=(1, rng.uniform(0.5, 1.0), 1))
    return flat.turned("y", rng.normal(0, 0.1)).standing()


def shampoo(rng: Draws) -> Mesh:
    """A flat bottle with shoulders and a cap or pump; upright more often than not."""
    height = rng.uniform(0.16, 0.28)
    half = rng.uniform(0.03, 0.05)
    flat = rng.uniform(0.45, 0.75)
    body = [[0, 0], [0.9, 0], [1, 0.03], [1, 0.62], [0.85, 0.72], [0.3, 0.78]]
    lower = lathe(np.array(body) * [half, height], 26, pick(rng, PAINTS)).moved(scale=(1, flat, 1))
    top = [[0.3, 0.78], [0.3, 0.86], [0.38, 0.86], [0.38, 1.0], [0, 1.0]]
    parts = [lower, lathe(np.array(top) * [half, height], 16, pick(rng, PAINTS), crease=True)]
    if rng.random() < 0.35:
        spout = [
            ((0, 0, height), (0, 0, height * 1.15)),
            ((0, 0, height * 1.15), (half, 0, height * 1.12)),
        ]
        parts.append(bars(spout, 0.006, 8))
    whole = join(parts)
    return whole if rng.random() < 0.8 else lying(whole)


# --- cans and cartons -------------------------------------------------------------------------


def tin(rng: Draws) -> Mesh:
    """An open tin or bucket with ribs, its inside hollow; lying, upright or leaning."""
    radius = rng.uniform(0.045, 0.11)
    height = radius * rng.uniform(1.7, 3.0)
    levels = np.linspace(0.03, 0.97, 19)
    ribbed = 1 + 0.025 * (np.sin(levels * rng.uniform(20, 50)) > 0.4)
    wall = np.column_stack([ribbed, levels])
    outside = np.concatenate([[[0, 0.02], [0.95, 0.0], [1.03, 0.0], [1.03, 0.02]], wall])
    rim = [[1.05, 0.98], [1.05, 1.0], [0.97, 1.0]]
    inside = [[0.95, 0.96], [0.95, 0.05], [0, 0.05]]
    profile = np.concatenate([outside, rim, inside]) * [radius, height]
    whole = lathe(profile, 30, pick(rng, (STEEL, STEEL, PAINTS[3], PAINTS[0])))
    lean = rng.choice([0.0, np.pi / 2, 0.35], p=[0.25, 0.6, 0.15])
    return whole.turned("y", lean + rng.uniform(-0.05, 0.05)).standing()


def lined_tin(rng: Draws) -> Mesh:
    """A tin on its side as hoops and staves: edges and ribs echo, and the plain wall hardly does.

    A smooth wall throws sound away from the sonar, unless it faces it.
    """
    radius = rng.uniform(0.045, 0.1)
    length = radius * rng.uniform(1.6, 2.8)
    thick = radius * rng.uniform(0.06, 0.14)
    levels = np.linspace(-length / 2, length / 2, int(rng.integers(2, 5)))
    parts = [_hoop(x, radius, thick) for x in levels]
    count = int(rng.integers(5, 11))
    for outward in circle(count)[:, [2, 0, 1]] * radius:
        ends = np.array([[-length / 2, 0, 0], [length / 2, 0, 0]]) + outward
        parts.append(tube(ends, thick, 6))
    whole = join(parts).tinted(pick(rng, (STEEL, PAINTS[3], PAINTS[0])))
    turn = rng.choice([0.0, np.pi / 2, rng.uniform(0, 0.6)], p=[0.6, 0.2, 0.2])
    return whole.turned("y", turn).standing()


def barred_tin(rng: Draws) -> Mesh:
    """A tin on its side as two to four bars across: its front, its back and seams between."""
    width = rng.uniform(0.09, 0.19)
    depth = rng.uniform(0.06, 0.17)
    thick = rng.uniform(0.004, 0.01)
    count = int(rng.integers(2, 5))
    across = []
    for number in range(count):
        y = depth * (number / (count - 1) - 0.5)
        z = rng.uniform(0, 0.4) * width * np.sin(np.pi * (number + 0.5) / count)
        half = width / 2 * rng.uniform(0.85, 1.0)
        across.append(((-half, y, z), (half, y, z)))
    parts = [bars(across, thick, 6)]
    if rng.random() < 0.6:
        corners = [((x, -depth / 2, 0), (x, depth / 2, 0)) for x in (-width / 2, width / 2)]
        parts.append(bars(corners[: int(rng.integers(1, 3))], 0.6 * thick, 6))
    # Seen broadside more often than not: the bars lie across the view.
    return join(parts).tinted(pick(rng, (STEEL, PAINTS[3]))).standing()


def drink_can(rng: Draws) -> Mesh:
    """A can of a drink, dented, lying more often than not."""
    radius = rng.uniform(0.03, 0.038)
    height = rng.uniform(0.11, 0.17)
    profile = [
        [0, 0.03],
        [0.75, 0.03],
        [0.8, 0],
        [1, 0.06],
        [1, 0.9],
        [0.8, 0.98],
        [0.8, 1],
        [0, 0.97],
    ]
    shape = lathe(np.array(profile) * [radius, height], 24, pick(rng, PAINTS))
    points = shape.vertices.copy()
    squeezed = np.exp(-(((points[:, 2] / height - rng.uniform(0.35, 0.65)) / 0.2) ** 2))
    points[:, 0] *= 1 - rng.uniform(0, 0.45) * squeezed
    shape = replace(shape, vertices=points)
    return lying(shape) if rng.random() < 0.75 else shape


def gable_carton(rng: Draws) -> Mesh:
    """A drink carton whose corners have been pushed in a little."""
    return _pushed(rng, things.drink_carton(rng), 0.008)


def brick_carton(rng: Draws) -> Mesh:
    """A brick of a drink, in the sizes of a portion and of a litre."""
    size = rng.choice([0.6, 1.0]) * np.array([0.095, 0.06, rng.uniform(0.16, 0.21)])
    brick = box(size.tolist(), (0, 0, size[2] / 2), pick(rng, PAINTS))
    fold = box((size[0], 0.004, 0.012), (0, 0, size[2] + 0.005), _PALE)
    cap = np.array([[0, 0], [0.014, 0], [0.014, 0.015], [0, 0.015]])
    lid = lathe(cap, 12, _PALE, crease=True)
    whole = _pushed(rng, join([brick, fold, lid.moved((0.25 * size[0], 0, size[2]))]), 0.006)
    turn = rng.choice([0.0, np.pi / 2], p=[0.35, 0.65])
    return whole.turned("y", turn).standing()


def cornered_carton(rng: Draws) -> Mesh:
    """A brick that stands on an edge or leans on a corner: two bright faces, as of an arrowhead."""
    size = rng.uniform([0.07, 0.05, 0.1], [0.11, 0.08, 0.19])
    brick = box(size.tolist(), (0, 0, 0), pick(rng, PAINTS))
    whole = _pushed(rng, brick, 0.006)
    turned = whole.turned("xy", rng.uniform(0.3, 1.2), rng.choice([0.0, np.pi / 2, 0.6]))
    return turned.standing()


def open_carton(rng: Draws) -> Mesh:
    """A carton cut open: four walls around a hollow, on their edges."""
    length, width, height = rng.uniform([0.09, 0.07, 0.04], [0.15, 0.12, 0.09]).tolist()
    wall = 0.006
    parts = [box((length, wall, height), (0, y, height / 2)) for y in (-width / 2, width / 2)]
    parts += [box((wall, width, height), (x, 0, height / 2)) for x in (-length / 2, length / 2)]
    whole = join(parts).tinted(pick(rng, PAINTS))
    return whole.turned("x", rng.uniform(-0.4, 0.4)).standing()


def _pushed(rng: Draws, shape: Mesh, depth_m: float) -> Mesh:
    """The mesh pulled and pushed smoothly, as a thing that is trodden on."""
    moves = [Waves(rng, 0.4, 0.12, 1.0, dimensions=3)(*shape.vertices.T) for _ in range(3)]
    offset = np.stack(moves, axis=-1) * np.float32(depth_m)
    return replace(shape, vertices=(shape.vertices + offset).astype(np.float32)).standing()


# --- hooks ------------------------------------------------------------------------------------


def crane_hook(rng: Draws) -> Mesh:
    """A forged hook below its block: thick, with sheaves, bolts and an eye."""
    size = rng.uniform(0.1, 0.2)
    angle = np.linspace(np.deg2rad(95), np.deg2rad(-165), 24)
    bend = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(24)]) * 0.55
    shank = [[bend[0, 0], y, 0] for y in (1.15, 0.85, 0.7)]
    thick = np.concatenate(
        [[0.16, 0.16, 0.17], np.linspace(0.18, 0.25, 12), np.linspace(0.25, 0.07, 12)]
    )
    parts = [tube(np.concatenate([shank, bend]) * size, thick * size, 12)]
    if rng.random() < 0.6:
        wheel = [[0, -0.1], [0.42, -0.1], [0.36, -0.03], [0.36, 0.03], [0.42, 0.1], [0, 0.1]]
        for level in rng.choice([-0.14, 0.14], int(rng.integers(1, 3)), replace=False):
            sheave = lathe(np.array(wheel) * size, 24, crease=True)
            parts.append(sheave.moved((bend[0, 0] * size, 1.4 * size, level * size)))
        for side in (-0.28, 0.28):
            parts.append(box((0.75 * size, 0.9 * size, 0.05 * size),
                             (bend[0, 0] * size, 1.35 * size, side * size)))  # fmt: skip
    else:
        eye = (circle(20) * 0.28 + [bend[0, 0], 1.35, 0]) * size
        parts.append(tube(eye, 0.11 * size, 10, closed=True))
    paint = pick(rng, (RUST, STEEL, PAINTS[1], PAINTS[0]))
    whole = rough(join(parts).tinted(paint), rng, 0.004, 0.2, 0.03)
    return whole.turned("x", rng.choice([0.0, 0.4, 1.2]) + rng.uniform(-0.2, 0.2)).standing()


def grapnel(rng: Draws) -> Mesh:
    """A small grapnel: a shank with three to five bent flukes."""
    size = rng.uniform(0.18, 0.4)
    bend = np.linspace(0, 2.3, 10)
    fluke = np.column_stack([0.25 * (1 - np.cos(bend)), np.zeros(10), -0.25 * np.sin(bend)])
    arm = tube(fluke, np.linspace(0.035, 0.02, 10), 8)
    count = int(rng.integers(3, 6))
    parts = [arm.turned("z", 2 * np.pi * k / count) for k in range(count)]
    parts.append(bars([((0, 0, 0), (0, 0, 0.75))], 0.035, 9))
    ring = circle(16)[:, [0, 2, 1]] * 0.07 + [0, 0, 0.82]
    parts.append(tube(ring, 0.02, 7, closed=True))
    whole = join(parts).tinted(pick(rng, _METALS)).moved(scale=size)
    return whole.turned("y", np.pi / 2 + rng.uniform(-0.2, 0.1)).standing()


def snap_hook(rng: Draws) -> Mesh:
    """A large snap hook with its gate, flat on the ground."""
    size = rng.uniform(0.08, 0.18)
    angle = np.linspace(0.3, 2 * np.pi, 26)
    oval = np.column_stack([0.5 * np.cos(angle), np.sin(angle), np.zeros(26)]) * size
    gate = np.array([oval[0], oval[-1]])
    parts = [tube(oval, 0.11 * size, 9), tube(gate, 0.08 * size, 8)]
    swivel = circle(18) * 0.3 * size + [0, -1.35 * size, 0]
    parts.append(tube(swivel, 0.1 * size, 8, closed=True))
    return join(parts).tinted(pick(rng, (STEEL, RUST, BRONZE))).standing()


def lumpy_hook(rng: Draws) -> Mesh:
    """A hook with its tackle: a thick bend with shackles, bolts and links all along it."""
    size = rng.uniform(0.09, 0.17)
    angle = np.linspace(0, rng.uniform(2.2, 4.0), 18)
    bend = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(18)]) * 0.6
    straight = np.linspace(rng.uniform(0.8, 1.8), 0, 8)[:, None] * [[0.15, -1.0, 0]] + bend[0]
    line = np.concatenate([straight[:-1], bend]) * size
    parts = [tube(line, size * rng.uniform(0.12, 0.2), 9)]
    for place in rng.integers(0, len(line), int(rng.integers(3, 9))):
        knob = sphere(1).moved(scale=size * rng.uniform(0.15, 0.3))
        parts.append(knob.moved(line[place] + rng.normal(0, 0.12 * size, 3)))
    whole = join(parts).tinted(pick(rng, _METALS))
    return whole.turned("x", rng.choice([0.0, 0.5, 1.3]) + rng.uniform(-0.2, 0.2)).standing()


# --- valves -----------------------------------------------------------------------------------


def hand_wheel(rng: Draws) -> Mesh:
    """A hand wheel on its stem, on its back or on its edge."""
    radius = rng.uniform(0.09, 0.2)
    count = int(rng.integers(3, 7))
    thick = radius * rng.uniform(0.07, 0.13)
    wavy = 1 + 0.04 * np.cos(np.arange(36) * 2 * np.pi / 36 * 2 * count)
    rim = circle(36) * radius * wavy[:, None]
    spokes = bars([((0, 0, -0.1 * radius), tuple(end)) for end in circle(count) * radius], thick, 7)
    stem = tube(
        np.array([[0, 0, 0.2 * radius], [0, 0, -rng.uniform(0.4, 1.4) * radius]]), 1.4 * thick, 10
    )
    parts = [tube(rim, 1.2 * thick, 9, closed=True), spokes, stem]
    whole = join(parts).tinted(pick(rng, (PAINTS[0], PAINTS[2], RUST, STEEL)))
    return whole.turned("x", rng.choice([np.pi, 0.0, 1.3]) + rng.uniform(-0.2, 0.2)).standing()


def cross_valve(rng: Draws) -> Mesh:
    """A valve body with thin arms that end in knobs: seen from above a star."""
    reach = rng.uniform(0.1, 0.2)
    count = int(rng.integers(4, 9))
    thick = reach * rng.uniform(0.04, 0.09)
    ends = circle(count) * reach * rng.uniform(0.75, 1.15, (count, 1))
    ends[:, 2] = rng.uniform(-0.15, 0.25, count) * reach
    parts = [bars([((0, 0, 0.1 * reach), tuple(end)) for end in ends], thick, 7)]
    knob = sphere(2).moved(scale=1.9 * thick)
    parts += [knob.moved(end) for end in ends]
    profile = [[0, -0.3], [0.26, -0.3], [0.3, -0.1], [0.2, 0.1], [0.28, 0.3], [0, 0.34]]
    parts.append(lathe(np.array(profile) * reach, 18))
    return join(parts).tinted(pick(rng, (STEEL, RUST, BRONZE))).standing()


def crossed_bars(rng: Draws) -> Mesh:
    """The handle of a valve: two or three thin bars that cross over a short stem."""
    reach = rng.uniform(0.1, 0.19)
    thick = rng.uniform(0.004, 0.009)
    count = int(rng.integers(2, 4))
    level = rng.uniform(0.03, 0.1)
    first = rng.uniform(0, np.pi)
    ends = []
    for number in range(count):
        angle = first + (number + rng.normal(0, 0.15)) * np.pi / count
        along = np.array([np.cos(angle), np.sin(angle), 0.0]) * reach * rng.uniform(0.85, 1.15)
        droop = np.array([0, 0, level * rng.uniform(0, 0.8)])
        middle = np.array([0, 0, level])
        ends += [(middle, middle + along - droop), (middle, middle - along - droop)]
    stem = np.array([[0.9, 0], [1, 0.3], [0.6, 0.5], [0.6, 1.1], [0, 1.15]])
    hub = lathe(stem * [rng.uniform(0.02, 0.04), level], 16)
    return join([bars(ends, thick, 7), hub]).tinted(pick(rng, (STEEL, RUST, BRONZE))).standing()


def hubbed_cross(rng: Draws) -> Mesh:
    """Two thin bars that cross at a thick hub, their ends bent up; flat, or upright on two ends."""
    reach = rng.uniform(0.1, 0.19)
    thick = rng.uniform(0.004, 0.009)
    opening = rng.uniform(0.6, 1.6)
    first = rng.uniform(0, np.pi)
    parts = [sphere(2).moved(scale=reach * rng.uniform(0.14, 0.28))]
    for angle in (first, first + opening):
        along = np.array([np.cos(angle), np.sin(angle), 0.0]) * reach
        upward = np.array([0, 0, rng.uniform(0, 0.2) * reach])
        line = np.array([upward - 1.08 * along, -along, along, upward + 1.08 * along])
        parts.append(tube(line, thick, 7))
    whole = join(parts).tinted(pick(rng, (STEEL, RUST, BRONZE)))
    return whole.turned("x", rng.choice([0.0, 0.0, 0.3, np.pi / 2])).standing()


def ball_valve(rng: Draws) -> Mesh:
    """A ball valve between flanges, with its lever."""
    size = rng.uniform(0.05, 0.11)
    flange = [[0, -1.5], [0.95, -1.5], [0.95, -1.3], [0.5, -1.3], [0.5, -0.9], [0.75, -0.5]]
    half = np.array([*flange, [0.85, 0]])
    body = lathe(np.concatenate([half, half[-2::-1] * [1, -1]]) * size, 24, crease=True)
    body = body.turned("y", np.pi / 2)
    stem = tube(np.array([[0, 0, 0.7], [0, 0, 1.2]]) * size, 0.18 * size, 9)
    lever = box(
        (2.6 * size, 0.3 * size, 0.1 * size), (1.0 * size, 0, 1.25 * size), pick(rng, PAINTS)
    )
    whole = join([join([body, stem]).tinted(pick(rng, (STEEL, BRONZE))), lever])
    return whole.turned("x", rng.uniform(-0.6, 0.6)).standing()


BUILDERS: dict[str, tuple[Builder, ...]] = {
    "Bottle": (*[striped_bottle] * 5, *[outlined_bottle] * 2, lined_bottle, lying_bottle, flask),
    "Standing-bottle": (upright_bottle, upright_bottle, slender_bottle, upright_jar),
    "Shampoo-bottle": (*[slender_bottle] * 4, shampoo, shampoo, things.shampoo_bottle),
    "Can": (*[barred_tin] * 4, lined_tin, lined_tin, lined_tin, tin, drink_can, things.can),
    "Drink-carton": (gable_carton, brick_carton, *[cornered_carton] * 3, open_carton),
    "Hook": (crane_hook, crane_hook, crane_hook, *[lumpy_hook] * 3, grapnel, snap_hook),
    "Propeller": (*[outlined_screw] * 4, screw, screw, screw, outboard),
    "Tire": (car_tyre, car_tyre, car_tyre, car_tyre, inner_tube),
    "Valve": (*[hubbed_cross] * 5, crossed_bars, crossed_bars, cross_valve, hand_wheel, ball_valve),
    "Chain": (
        *[branched_chain] * 5, *[tailed_chain] * 3, *[loose_chain] * 3, laid_chain, chain_heap,
    ),
}  # fmt: skip
"""Class -> its builders; a builder that is listed twice is drawn twice as often."""


@functools.cache
def model(kind: str, number: int) -> Mesh:
    """One of the detailed models of a class, at rest on z = 0; drawn once a process."""
    rng = stream(WORLD_SEED, "seabed", "detailed", kind, number)
    builders = BUILDERS[kind]
    return builders[int(rng.integers(len(builders)))](rng)


def drawn_model(rng: Draws, kind: str) -> Mesh:
    """A detailed model of a class, or a plain one of a class without; turned, scaled, tinted."""
    if kind not in BUILDERS:
        return things.drawn_model(rng, kind)
    shape = model(kind, int(rng.integers(_MODELS)))
    turned = shape.moved(scale=rng.uniform(0.85, 1.2)).turned("z", rng.uniform(0, 2 * np.pi))
    shade = np.float32(rng.uniform(0.85, 1.15))
    return replace(turned, colours=turned.colours * shade)
