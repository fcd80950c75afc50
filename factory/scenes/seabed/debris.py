"""Things that people drop: the object classes of the Marine Debris Dataset, and barrels.

Every builder draws its own size and colours and returns a mesh that rests on z = 0.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from .meshes import (
    Colour,
    Mesh,
    bar,
    box,
    grid_triangles,
    join,
    lathe,
    mesh,
    prism,
    rotation,
    tube,
)

GLASS: tuple[Colour, ...] = (
    (0.05, 0.16, 0.06),
    (0.16, 0.08, 0.03),
    (0.42, 0.50, 0.48),
    (0.62, 0.66, 0.66),
)
PAINTS: tuple[Colour, ...] = (
    (0.62, 0.06, 0.04),
    (0.72, 0.42, 0.04),
    (0.05, 0.16, 0.45),
    (0.70, 0.70, 0.66),
    (0.06, 0.30, 0.12),
    (0.66, 0.62, 0.10),
    (0.03, 0.03, 0.035),
)
RUST: Colour = (0.22, 0.10, 0.05)
BRONZE: Colour = (0.34, 0.25, 0.10)
STEEL: Colour = (0.34, 0.35, 0.36)


def pick(rng: np.random.Generator, colours: tuple[Colour, ...]) -> Colour:
    """One of the colours, a little lighter or darker."""
    red, green, blue = colours[int(rng.integers(len(colours)))]
    shade = float(rng.uniform(0.75, 1.2))
    return red * shade, green * shade, blue * shade


def lying(upright: Mesh) -> Mesh:
    """An upright thing laid on its side."""
    return upright.moved(rotation("y", np.pi / 2)).standing()


def standing_bottle(rng: np.random.Generator) -> Mesh:
    """A bottle, 22 to 42 cm high, often with a label."""
    height, radius = rng.uniform(0.22, 0.42), rng.uniform(0.036, 0.052)
    neck, shoulder = radius * rng.uniform(0.3, 0.42), rng.uniform(0.5, 0.64)
    glass = np.array(pick(rng, GLASS))
    label = np.array(pick(rng, PAINTS)) if rng.random() < 0.6 else glass
    levels = np.array([0, 0, 0.02, 0.14, 0.15, 0.4, 0.41, shoulder, shoulder + 0.09, 0.78, 0.94])
    radii = radius * np.array([0, 0.9, 1, 1, 1, 1, 1, 1, 0.8, 0, 0])
    radii[9:] = neck
    colours = np.repeat(glass[None], len(levels), axis=0)
    colours[4:6] = label
    rim = np.array([[neck * 1.25, 0.94], [neck * 1.25, 0.98], [neck * 0.7, 1.0], [0, 0.99]])
    profile = np.concatenate([np.column_stack([radii, levels]), rim]) * [1, height]
    return lathe(profile, 22, np.concatenate([colours, np.repeat(glass[None], 4, axis=0)]))


def bottle(rng: np.random.Generator) -> Mesh:
    """A bottle on its side."""
    return lying(standing_bottle(rng))


def can(rng: np.random.Generator) -> Mesh:
    """A tin or drink can, lying or upright, perhaps dented."""
    radius = rng.uniform(0.045, 0.09)
    height = radius * rng.uniform(1.8, 3.0)
    metal, paint = np.array(STEEL) * 1.3, np.array(pick(rng, PAINTS))
    profile = np.array([[0, 0.02], [0.86, 0.02], [0.9, 0], [1, 0.05], [1, 0.07], [1, 0.5]])
    above = profile[::-1] * [1, -1] + [0, 1]
    whole = np.concatenate([profile, above[1:]]) * [radius, height]
    colours = np.repeat(metal[None], len(whole), axis=0)
    colours[4:7] = paint
    shape = lathe(whole, 24, colours)
    if rng.random() < 0.4:  # a dent: pressed flat on one side
        points = shape.vertices.copy()
        middle = np.exp(-(((points[:, 2] / height - 0.5) / 0.25) ** 2))
        limit = radius * (1 - rng.uniform(0.2, 0.5) * middle)
        points[:, 0] = np.minimum(points[:, 0], limit)
        shape = Mesh(points, shape.colours, shape.triangles)
    return lying(shape) if rng.random() < 0.7 else shape


def drink_carton(rng: np.random.Generator) -> Mesh:
    """A gable-top carton, standing or lying."""
    width, depth = rng.uniform(0.07, 0.11), rng.uniform(0.07, 0.11)
    body = rng.uniform(0.16, 0.26)
    paint, pale = pick(rng, PAINTS), (0.72, 0.72, 0.70)
    ridge = body + width * 0.55
    gable = prism([[-width / 2, 0], [width / 2, 0], [0, ridge - body]], depth, pale)
    gable = gable.moved(rotation("x", np.pi / 2), (0, depth / 2, body))
    parts = [
        box((width, depth, body * 0.55), (0, 0, body * 0.275), paint),
        box((width, depth, body * 0.45), (0, 0, body * 0.775), pale),
        gable,
        box((0.008, depth, 0.03), (0, 0, ridge + 0.012), paint),
    ]
    carton = join(parts)
    return carton if rng.random() < 0.4 else lying(carton)


def shampoo_bottle(rng: np.random.Generator) -> Mesh:
    """A flat plastic bottle with a cap, on its side or upright."""
    height, width = rng.uniform(0.2, 0.32), rng.uniform(0.045, 0.06)
    paint, cap = np.array(pick(rng, PAINTS)), np.array(pick(rng, PAINTS))
    levels = np.array([0, 0, 0.03, 0.3, 0.6, 0.74, 0.78])
    radii = np.array([0, 0.8, 0.95, 1, 0.9, 0.62, 0.3])
    body = lathe(np.column_stack([radii * width, levels * height]), 20, paint).moved(
        scale=(1.0, 0.55, 1.0)
    )
    top = np.array([[0.34, 0.78], [0.34, 0.97], [0.28, 1.0], [0, 1.0]]) * [width, height]
    whole = join([body, lathe(top, 14, cap, crease=True)])
    return whole if rng.random() < 0.3 else lying(whole)


def hook(rng: np.random.Generator) -> Mesh:
    """A crane hook with its eye, lying on the ground."""
    size = rng.uniform(0.16, 0.4)
    angle = np.linspace(np.deg2rad(100), np.deg2rad(-170), 22)
    bend = np.column_stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)]) * 0.5
    shank = np.array([[bend[0, 0], 1.35, 0], [bend[0, 0], 0.95, 0], [bend[0, 0], 0.7, 0]])
    path = np.concatenate([shank, bend]) * size
    thickness = np.concatenate([[0.1, 0.11, 0.12], np.linspace(0.13, 0.17, 11)])
    thickness = np.concatenate([thickness, np.linspace(0.165, 0.045, 11)]) * size
    ring = np.linspace(0, 2 * np.pi, 18, endpoint=False)
    eye = np.column_stack([np.cos(ring), np.sin(ring), np.zeros_like(ring)]) * 0.24
    eye = (eye + np.array([float(bend[0, 0]), 1.55, 0.0])) * size
    paint = pick(rng, (RUST, STEEL, PAINTS[1], PAINTS[0]))
    whole = join(
        [
            tube(path, thickness, 12, colour=paint),
            tube(eye, 0.09 * size, 10, closed=True, colour=paint),
        ]
    )
    return whole.moved(rotation("x", rng.uniform(-0.2, 0.5))).standing()


def propeller(rng: np.random.Generator) -> Mesh:
    """A ship's propeller of three to five twisted blades, leaning or flat."""
    radius, blades = rng.uniform(0.22, 0.6), int(rng.integers(3, 6))
    metal = pick(rng, (BRONZE, STEEL, RUST))
    hub = np.array([[0, -0.2], [0.14, -0.2], [0.19, -0.1], [0.2, 0.12], [0.12, 0.25], [0, 0.3]])
    parts = [lathe(hub * radius, 20, metal)]
    along, across = np.meshgrid(np.linspace(0.12, 1, 12), np.linspace(-1, 1, 9), indexing="ij")
    width = 0.36 * np.sqrt(np.maximum(1 - ((along - 0.62) / 0.52) ** 2, 0)) + 0.04
    twist = np.deg2rad(62) * (1 - along) + np.deg2rad(20)
    thick = 0.025 * (1 - 0.7 * along) * (1 - across**2)
    x = along * np.cos(across * width * 0.6)
    y = across * width * np.cos(twist)
    z = across * width * np.sin(twist)
    for k in range(blades):
        faces = [
            _sheet(np.stack([x, y, z + side * thick], axis=-1) * radius, metal, side > 0)
            for side in (1.0, -1.0)
        ]
        parts.append(join(faces).moved(rotation("z", 2 * np.pi * k / blades)))
    whole = join(parts)
    return whole.moved(rotation("x", rng.choice([0.2, 1.2]) + rng.uniform(-0.2, 0.2))).standing()


def _sheet(grid: npt.NDArray[np.float64], colour: Colour, front: bool) -> Mesh:
    triangles = grid_triangles(*grid.shape[:2])
    return mesh(grid.reshape(-1, 3), triangles if front else triangles[:, ::-1], colour)


def tire(rng: np.random.Generator) -> Mesh:
    """A tyre, flat, leaning or upright; hollow like a real one, with a tread."""
    outer = rng.uniform(0.28, 0.58)
    width = outer * rng.uniform(0.32, 0.5)
    rim = outer * rng.uniform(0.55, 0.66)
    # From the rim over the outside's half to its middle, and on the inside; both are mirrored.
    outside = np.array(
        [[rim, -0.36], [rim + 0.3 * (outer - rim), -0.49], [rim + 0.75 * (outer - rim), -0.5],
         [0.985 * outer, -0.4], [outer, -0.2], [0.978 * outer, -0.18], [0.978 * outer, -0.1],
         [outer, -0.08]]
    )  # fmt: skip
    hollow = np.array(
        [[rim + 0.1 * (outer - rim), 0.34], [rim + 0.7 * (outer - rim), 0.4], [outer * 0.94, 0.3]]
    )
    mirror = np.array([1.0, -1.0])
    parts = (outside, outside[::-1] * mirror, hollow, hollow[::-1] * mirror, outside[:1])
    profile = np.concatenate(parts)
    rubber = np.array([0.035, 0.035, 0.038]) * rng.uniform(0.8, 1.6)
    shape = lathe(profile * [1, width], 44, rubber)
    lean = rng.choice([0.0, 0.3, 1.25, np.pi / 2], p=[0.45, 0.2, 0.15, 0.2])
    return shape.moved(rotation("x", lean + rng.uniform(-0.08, 0.08))).standing()


def valve(rng: np.random.Generator) -> Mesh:
    """A flanged gate valve with its hand wheel."""
    size = rng.uniform(0.16, 0.34)
    paint, wheel = pick(rng, (STEEL, RUST, PAINTS[2], PAINTS[4])), pick(rng, (PAINTS[0], RUST))
    body = np.array(
        [[0, -1], [0.62, -1], [0.62, -0.84], [0.34, -0.84], [0.36, -0.5], [0.5, 0.0]], dtype=float
    )
    body = np.concatenate([body, body[-2::-1] * [1, -1]])
    bonnet = [[0.4, 0.3], [0.3, 0.7], [0.42, 0.72], [0.42, 0.84], [0.12, 0.9], [0.1, 1.5], [0, 1.5]]
    ring = np.linspace(0, 2 * np.pi, 26, endpoint=False)
    circle = np.column_stack([0.55 * np.cos(ring), 0.55 * np.sin(ring), np.full(26, 1.4)])
    spokes = [bar((0, 0, 1.4), circle[k], 0.045, 6) for k in (0, 6, 13, 19)]
    hand = [tube(circle, 0.07, 8, closed=True), *spokes]
    hand = [Mesh(p.vertices, np.full_like(p.colours, wheel), p.triangles) for p in hand]
    run = lathe(body, 22, paint, crease=True).moved(rotation("y", np.pi / 2))
    whole = join([run, lathe(bonnet, 18, paint, crease=True), *hand]).moved(scale=size)
    return whole.moved(rotation("x", rng.choice([0.0, 1.35]) + rng.uniform(-0.2, 0.2))).standing()


def barrel(rng: np.random.Generator) -> Mesh:
    """A steel drum, lying or upright."""
    radius, height = 0.29 * rng.uniform(0.8, 1.1), 0.86 * rng.uniform(0.85, 1.1)
    hoops = [0.3, 0.32, 0.34, 0.36, 0.64, 0.66, 0.68, 0.7]
    levels = [0.03, 0.03, 0, 0.02, *hoops, 0.98, 1, 0.97, 0.97]
    radii = [0, 0.94, 0.97, 1, 1, 1.04, 1.04, 1, 1, 1.04, 1.04, 1, 1, 0.97, 0.94, 0]
    profile = np.column_stack([np.array(radii) * radius, np.array(levels) * height])
    paint = pick(rng, (RUST, PAINTS[2], PAINTS[0], PAINTS[1]))
    drum = lathe(profile, 32, paint, crease=True)
    return lying(drum) if rng.random() < 0.65 else drum
