"""Moving objects put into a rendered frame.

A frame is rendered without them.  Each object is drawn by a z-buffer from the same camera, shaded
as the renderers shade (albedo cos(incidence) / range^2 with the light at the sonar) and laid over
the render where it is nearer, so that it hides the ground behind it: its shadow.  What is done to
a frame depends on the frame, the objects and the time alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ...common.array_types import Bools, Float64s, Floats, Int32s, Int64s
from ...common.seeds import spawn_key
from ..frames.frame import Frame, MovingPixels, turned
from ..meshes.triangle_mesh import vertex_normals
from ..render.base import Mount, Rendered
from .cast import Actor
from .course import Placement

FIRST_INSTANCE = 10_000
"""Instance numbers of moving objects are this and the number of their track."""
_NEAREST_M = 0.05
_LARGEST_PX = 4096
_GRAZING_COSINE = 0.05
_WHOLE = np.eye(3)
_HERE = np.zeros(3)


@dataclass(frozen=True, eq=False)
class PosedBody:
    """An object at the time of a frame; a `simnfnd.factory.simulation.frames.frame.Body`."""

    actor: Actor
    placement: Placement
    camera_from_world: Float64s
    time_s: float

    @property
    def salt(self) -> int:
        """See `Body`."""
        return spawn_key("moving object", self.actor.number)[0]

    def camera_m(self, own_m: Floats) -> Float64s:
        """See `Body`."""
        bent = self.actor.bent(own_m, self.time_s)
        world = turned(self.placement.world_from_own, bent) + self.placement.position_m
        return turned(self.camera_from_world[:3, :3], world) + self.camera_from_world[:3, 3]


class Composed(NamedTuple):
    """A frame with its moving objects, and its render."""

    frame: Frame
    rendered: Rendered


class Echo(NamedTuple):
    """How surfaces of a class echo: backscatter coefficient and exponent of the cosine."""

    coefficient: float
    exponent: float


class _Drawn(NamedTuple):
    """The pixels of an object alone: (M,) each, and places (M, 3).

    inside: whether a pixel lies in the image; pixel: its flat number there.
    """

    pixel: Int64s
    inside: Bools
    depth_m: Float64s
    own_m: Float64s
    radiance: Float64s


def bodies_at(cast: Sequence[Actor], frame: Frame, time_s: float) -> list[PosedBody]:
    """The objects that are there at a time, as the camera of the frame sees them."""
    pose = frame.world_from_camera
    assert pose is not None
    turn = pose[:3, :3].T
    camera_from_world = np.eye(4)
    camera_from_world[:3, :3] = turn
    camera_from_world[:3, 3] = -turned(turn, pose[None, :3, 3])[0]
    bodies = []
    for actor in cast:
        placement = actor.course.at(time_s)
        if placement is not None:
            bodies.append(PosedBody(actor, placement, camera_from_world, time_s))
    return bodies


def compose(
    frame: Frame,
    rendered: Rendered,
    bodies: Sequence[PosedBody],
    mount: Mount,
    echoes: Sequence[Echo],
    frequency_khz: float,
) -> Composed:
    """Put the bodies into a frame, in front of what lies behind them.

    echoes: of each class.  frequency_khz: of the sonar, for target strengths.
    """
    shape = frame.depth_m.shape
    depth_m = frame.depth_m.reshape(-1).copy()
    radiance = rendered.radiance.reshape(-1).copy()
    surface = rendered.surface.reshape(-1).copy()
    labels = np.zeros(depth_m.size, np.uint8)
    if frame.segmentation is not None:
        labels = frame.segmentation.reshape(-1).copy()
    instances = np.zeros(depth_m.size, np.uint16)
    if frame.instance is not None:
        instances = frame.instance.reshape(-1).copy()
    # Number of the body that each pixel shows, or -1.
    owner = np.full(depth_m.size, -1, np.int32)

    drawn_bodies: dict[int, _Drawn] = {}
    for number, body in enumerate(bodies):
        drawn = _draw(body, frame, mount, echoes[body.actor.label], frequency_khz)
        if drawn is None:
            continue
        drawn_bodies[number] = drawn
        pixel = drawn.pixel[drawn.inside]
        near_m = drawn.depth_m[drawn.inside]
        behind = depth_m[pixel]
        nearer = (behind <= 0) | (near_m < behind)
        shown = pixel[nearer]
        depth_m[shown] = near_m[nearer]
        radiance[shown] = drawn.radiance[drawn.inside][nearer]
        surface[shown] = True
        labels[shown] = body.actor.label
        instances[shown] = FIRST_INSTANCE + body.actor.number
        owner[shown] = number

    composed = replace(
        frame,
        depth_m=depth_m.reshape(shape),
        segmentation=labels.reshape(shape),
        instance=instances.reshape(shape),
        moving=_moving_pixels(owner, drawn_bodies, bodies),
    )
    bounces = rendered.bounces
    if bounces is not None:
        # Moving objects hide what is behind them, and mirror nothing themselves.
        bounces = bounces.clear_of(owner >= 0)
    lit = Rendered(radiance.reshape(shape), surface.reshape(shape), bounces)
    return Composed(composed, lit)


def _moving_pixels(
    owner: Int32s, drawn_bodies: Mapping[int, _Drawn], bodies: Sequence[PosedBody]
) -> MovingPixels:
    """The pixels that show bodies, and how much of each body they hide.

    owner: (pixels,) number of the body that each pixel shows, or -1.
    """
    pixel = np.flatnonzero(owner >= 0)
    own_m = np.zeros((len(pixel), 3))
    alone_px, hidden_px = np.zeros((2, len(bodies)), np.int64)
    for number, drawn in drawn_bodies.items():
        inside = np.flatnonzero(drawn.inside)
        visible = inside[owner[drawn.pixel[inside]] == number]
        own_m[np.searchsorted(pixel, drawn.pixel[visible])] = drawn.own_m[visible]
        alone_px[number] = len(drawn.pixel)
        hidden_px[number] = len(inside) - len(visible)
    return MovingPixels(
        pixel=pixel.astype(np.int32),
        body=owner[pixel],
        own_m=own_m,
        bodies=tuple(bodies),
        alone_px=alone_px,
        hidden_px=hidden_px,
    )


def _draw(
    body: PosedBody, frame: Frame, mount: Mount, echo: Echo, frequency_khz: float
) -> _Drawn | None:
    """The pixels that an object alone covers; None where the camera sees nothing of it."""
    from ..meshes.kernels import rasterise_mesh  # loads numba

    solid = body.actor.mesh
    vertices_m = body.camera_m(solid.vertices)
    if vertices_m[:, 2].min() < _NEAREST_M:
        return None
    lens = frame.intrinsics
    height, width = frame.depth_m.shape
    columns = vertices_m[:, 0] / vertices_m[:, 2] * lens.fx + lens.cx
    rows = vertices_m[:, 1] / vertices_m[:, 2] * lens.fy + lens.cy
    left = int(np.floor(columns.min()))
    right = int(np.ceil(columns.max()))
    top = int(np.floor(rows.min()))
    bottom = int(np.ceil(rows.max()))
    is_outside = right < 0 or left >= width or bottom < 0 or top >= height
    if is_outside or max(right - left, bottom - top) > _LARGEST_PX:
        return None
    shape = bottom - top + 1, right - left + 1
    inverse = np.zeros(shape, np.float32)
    which = np.full(shape, -1, np.int32)
    camera = np.array([lens.fx, lens.fy, lens.cx - left, lens.cy - top])
    whole = np.array([[0, 0, len(vertices_m), len(solid.triangles)]], np.int64)
    points = np.ascontiguousarray(vertices_m, np.float32)
    rasterise_mesh(points, solid.triangles, whole, 0, (_HERE, _WHOLE, camera), (inverse, which))
    crop_rows, crop_columns = np.nonzero(which >= 0)
    if not len(crop_rows):
        return None
    row, column = crop_rows + top, crop_columns + left
    depth_m = 1 / inverse[crop_rows, crop_columns].astype(np.float64)
    ray = np.stack([(column - lens.cx) / lens.fx, (row - lens.cy) / lens.fy], axis=-1)
    place_m = np.concatenate([ray, np.ones((len(ray), 1))], axis=1) * depth_m[:, None]
    corner = solid.triangles[which[crop_rows, crop_columns]]
    shares = _shares(vertices_m, corner, place_m)
    own_m = _mixed(solid.vertices, corner, shares)
    normals = vertex_normals(points, solid.triangles)
    normal = _mixed(normals, corner, shares)
    albedo = _mixed(solid.colours.mean(axis=1, keepdims=True), corner, shares)[:, 0]
    radiance = _radiance(place_m, normal, albedo, mount)
    strength_db = body.actor.target_strength_db(frequency_khz)
    if strength_db is not None:
        section = _cross_section(place_m, normal, radiance, ray, frame, mount, echo)
        radiance *= 10 ** (strength_db / 10) / max(section, 1e-30)
    inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
    return _Drawn(row * width + column, inside, depth_m, own_m, radiance)


def _shares(vertices_m: Float64s, corner: Int32s, place_m: Float64s) -> Float64s:
    """(M, 3) weights of the corners of each pixel's triangle: the place is their weighted sum."""
    a, b, c = (vertices_m[corner[:, k]] for k in range(3))
    opposite = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=1)
    volumes = (opposite * place_m[:, None]).sum(axis=2)
    total = volumes.sum(axis=1, keepdims=True)
    return np.asarray(volumes / np.where(total == 0, 1, total))


def _mixed(values: Floats, corner: Int32s, shares: Float64s) -> Float64s:
    """(M, K) weighted means of the values of the corners."""
    return np.asarray((values[corner].astype(np.float64) * shares[:, :, None]).sum(axis=1))


def _radiance(place_m: Float64s, normal: Float64s, albedo: Float64s, mount: Mount) -> Float64s:
    """(M,) albedo * |cos(incidence)| / range^2, as `Rendered` has it."""
    toward = mount.position_camera_m() - place_m
    square_m2 = (toward**2).sum(axis=1)
    cosine = np.abs(_cosine(normal, toward))
    return np.asarray(albedo * cosine / np.maximum(square_m2, 1e-6))


def _cosine(normal: Float64s, toward: Float64s) -> Float64s:
    lengths = np.sqrt((normal**2).sum(axis=1) * (toward**2).sum(axis=1))
    return np.asarray((normal * toward).sum(axis=1) / np.maximum(lengths, 1e-12))


def _cross_section(
    place_m: Float64s,
    normal: Float64s,
    radiance: Float64s,
    ray: Float64s,
    frame: Frame,
    mount: Mount,
    echo: Echo,
) -> float:
    """Backscattering cross section of an object as its pixels stand, m^2.

    A pixel's echo over the source level is radiance mu dO b / ..., see `imaging.scatterers`; times
    r^4 it is the cross section of what the pixel covers.
    """
    toward = mount.position_camera_m() - place_m
    square_m2 = (toward**2).sum(axis=1)
    solid_angle = (1 + (ray**2).sum(axis=1)) ** -1.5 / (frame.intrinsics.fx * frame.intrinsics.fy)
    power = radiance * echo.coefficient * solid_angle
    if echo.exponent != 2 or not mount.colocated:
        cosine_sonar = np.maximum(np.abs(_cosine(normal, toward)), _GRAZING_COSINE)
        cosine_camera = np.maximum(np.abs(_cosine(normal, place_m)), _GRAZING_COSINE)
        nearer = (place_m**2).sum(axis=1) / square_m2
        power *= cosine_sonar ** (echo.exponent - 1) / cosine_camera * nearer
    return float((power * square_m2**2).sum())
