"""How a location looks: colours of its ground, light, water, and the picture of a view."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .biomes import draw
from .fields import Floats, tiles
from .meshes import Colour
from .optics import Optics
from .rasterizer import Objects, Points, Pose, ZBuffer, in_sight, lens_of, pose
from .terrain import GroundMesh

Triple = tuple[float, float, float]

_SUN_M = 400.0  # how far away the camera in the sun is
_SHADE_M, _SHADE_CELLS = 14.0, 512  # side of the ground that it sees, and of its picture


@dataclass(frozen=True)
class Palette:
    """Albedo of a location's ground and growth, red, green, blue."""

    sand: Colour
    gravel: Colour
    rock: Colour
    algae: Colour
    crust: Colour
    turf: float  # how much of the rock is overgrown, 0 to 1

    @property
    def table(self) -> Floats:
        """(5, 3) sand, gravel, rock, algae, crust."""
        colours = (self.sand, self.gravel, self.rock, self.algae, self.crust)
        return np.array(colours, dtype=np.float32)


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


@dataclass(frozen=True)
class Water:
    """Water and light of a location; triples are red, green, blue.

    fade_per_m: attenuation.  haze: colour of open water.  sun, sky: light from the sun's direction
    and from all above.  sun_direction: unit, from the ground to the sun.  clear_m: beyond this
    range nothing has a depth.
    """

    fade_per_m: Triple
    haze: Triple
    sun: Triple
    sky: Triple
    sun_direction: Triple
    clear_m: float

    @property
    def table(self) -> Floats:
        """(4, 3) fade, haze, sun, sky."""
        return np.array((self.fade_per_m, self.haze, self.sun, self.sky), dtype=np.float32)


@dataclass(frozen=True)
class _Kind:
    """Ranges of a kind of water; fade is relative to that of green."""

    haze: Triple
    fade: Triple
    sun: tuple[float, float]
    sky: Triple
    clear_m: tuple[float, float]


_KINDS: dict[str, _Kind] = {
    "clear": _Kind((0.03, 0.24, 0.41), (3.2, 1.0, 0.75), (0.6, 1.0), (0.26, 0.60, 0.70), (10, 17)),
    "cyan": _Kind((0.07, 0.42, 0.48), (2.7, 1.0, 0.95), (0.6, 1.0), (0.34, 0.68, 0.70), (9, 15)),
    "deep": _Kind((0.01, 0.075, 0.19), (3.6, 1.0, 0.65), (0.2, 0.4), (0.13, 0.36, 0.52), (9, 15)),
    "green": _Kind((0.04, 0.15, 0.105), (2.0, 1.0, 1.35), (0.4, 0.8), (0.30, 0.52, 0.40), (8, 12)),
    "lake": _Kind((0.07, 0.085, 0.035), (1.25, 1.0, 1.9), (0.3, 0.6), (0.42, 0.44, 0.26),
                  (7.5, 11)),
    "dark": _Kind((0.012, 0.04, 0.045), (2.4, 1.0, 1.1), (0.08, 0.2), (0.24, 0.30, 0.30),
                  (7.5, 11)),
}  # fmt: skip


def draw_water(rng: np.random.Generator, kinds: tuple[str, ...]) -> Water:
    """Draw the water of a location from one of the named kinds."""
    kind = _KINDS[kinds[int(rng.integers(len(kinds)))]]
    clear = draw(rng, kind.clear_m)
    height, turn = rng.uniform(0.72, 0.92), rng.uniform(0, 2 * np.pi)
    flat = np.sqrt(1 - height**2)
    sun = draw(rng, kind.sun)
    return Water(
        fade_per_m=_triple([1.15 / clear * share for share in kind.fade]),
        haze=_triple([value * rng.uniform(0.85, 1.15) for value in kind.haze]),
        sun=_triple([sun * share for share in (0.62, 1.0, 0.92)]),
        sky=kind.sky,
        sun_direction=_triple([flat * np.cos(turn), flat * np.sin(turn), height]),
        clear_m=clear,
    )


def _triple(values: list[float]) -> Triple:
    red, green, blue = (float(value) for value in values)
    return red, green, blue


@dataclass(frozen=True, eq=False)
class Scene:
    """What one view looks at, and with what.  finishes: (N, 3), see `world.World`."""

    where: Pose
    optics: Optics
    ground: GroundMesh
    objects: Objects
    finishes: Floats
    palette: Palette
    water: Water
    offset_m: tuple[float, float]


def photograph(scene: Scene, seen: ZBuffer, exposure: float) -> npt.NDArray[np.uint8]:
    """The (H, W, 3) picture of what a z-buffer met.

    exposure: how bright its bright parts are, 0 to 1.  Colours are those of every second pixel.
    """
    from . import kernels

    height, width = seen.which.shape
    colour = np.empty((-(-height // 2), -(-width // 2), 3), np.float32)
    rgb = np.empty((height, width, 3), np.uint8)
    ground, mesh, where = scene.ground, scene.objects.mesh, scene.where
    sun, sun_lens, shade = _shade(scene)
    sight = _single(where.eye, where.rotation, lens_of(scene.optics))
    light = _single(sun.eye, sun.rotation, sun_lens)
    kernels.look(
        ground.points.reshape(-1, 3), ground.normals.reshape(-1, 3),
        ground.attributes.reshape(-1, 3), ground.points.shape[1],
        mesh.vertices, scene.objects.normals, mesh.colours, mesh.triangles, scene.objects.owner,
        *sight, seen.inverse, seen.which,
        scene.finishes, scene.palette.table, np.float32(scene.palette.turf),
        np.array(scene.offset_m, np.float32), tiles().texture,
        scene.water.table, np.array(scene.water.sun_direction, np.float32),
        *light, shade, colour,
    )  # fmt: skip
    # The camera sets its black level on the haze, as far as that has one colour, and lets the
    # bright parts of the picture fill most of the scale, whatever the water.
    some = colour[::4, ::4]
    haze = np.array(scene.water.haze, np.float32)
    black = haze * np.float32(0.6 * np.percentile(some.max(axis=-1), 1) / haze.max())
    bright = max(float(np.percentile((some - black).max(axis=-1), 97)), 1e-3)
    kernels.expose(colour, black, np.float32(exposure / bright), _gamma(), rgb)
    return rgb


def _shade(scene: Scene) -> tuple[Pose, Points, Floats]:
    """A camera in the sun, its lens (4,) and its z-buffer (S, S) of the objects in the light."""
    from .kernels import paint

    where, (x, y, z) = scene.where, scene.water.sun_direction
    ahead = where.rotation[:2, 2] / np.sqrt((where.rotation[:2, 2] ** 2).sum())
    middle = np.append(where.eye[:2] + 0.4 * _SHADE_M * ahead, where.eye[2] - 1)
    heading, pitch = np.rad2deg([np.arctan2(-y, -x), np.arcsin(z)])
    sun = pose(middle + _SUN_M * np.array([x, y, z]), heading, pitch, 0)
    half = (_SHADE_CELLS - 1) / 2
    lens = np.array([_SUN_M * _SHADE_CELLS / _SHADE_M] * 2 + [half, half])
    inverse = np.zeros((_SHADE_CELLS, _SHADE_CELLS), dtype=np.float32)
    which = np.empty(inverse.shape, dtype=np.int32)
    objects = scene.objects
    near = in_sight(sun, lens, inverse.shape, objects.balls, 1e6)
    mesh = objects.mesh
    paint(
        mesh.vertices, mesh.triangles, objects.parts(near), 0, sun.eye, sun.rotation, lens,
        inverse, which,
    )  # fmt: skip
    return sun, lens, inverse


def _single(eye: Points, rotation: Points, lens: Points) -> tuple[Floats, Floats, Floats]:
    return eye.astype(np.float32), rotation.astype(np.float32), lens.astype(np.float32)


@functools.cache
def _gamma() -> npt.NDArray[np.uint8]:
    level = np.arange(4096) / 4095
    return np.asarray(np.round(255 * level ** (1 / 2.2)), dtype=np.uint8)
