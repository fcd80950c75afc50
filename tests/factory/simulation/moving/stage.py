"""A wide plane far below a sonar, and objects of known shape that move before it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from simnfnd.factory.dataset.frame_ref import FrameRef
from simnfnd.factory.simulation.config.root import FactoryConfig, from_mapping
from simnfnd.factory.simulation.frames.frame import Frame, Intrinsics, Surroundings
from simnfnd.factory.simulation.meshes.camera import pose
from simnfnd.factory.simulation.meshes.triangle_mesh import Mesh, sphere
from simnfnd.factory.simulation.moving.cast import Actor
from simnfnd.factory.simulation.moving.compose import bodies_at
from simnfnd.factory.simulation.moving.course import Placement
from simnfnd.factory.simulation.moving.recordings import Moment
from simnfnd.factory.simulation.render.base import Rendered

NEAR_M = 2.0
FAR_M = 8.0
OFF = {
    name: {"enabled": False}
    for name in ("range_spreading", "multipath", "azimuth", "range_arc", "background")
}


def settings(**keys: Any) -> FactoryConfig:
    """The sonar equation without noise unless named: polar, a fixed window, one place at rest."""
    sonar = {
        "hfov_deg": 30, "vfov_deg": 40, "beams": 96, "range_bins": 300,
        "range": {"auto": False, "min_m": NEAR_M, "max_m": FAR_M},
        "image": {"layout": "polar"},
        "transfer": {"kind": "log"},
    }  # fmt: skip
    values = {
        "scenes": {"kind": "seabed", "frame_rate_hz": 10},
        "sonar": sonar | keys.pop("sonar", {}),
        "acoustics": {"formation": "coherent", **keys.pop("acoustics", {})},
        "noise": OFF | keys.pop("noise", {}),
    }
    return from_mapping(values | keys)


def plane(
    time_s: float = 0.0, height_m: float = 1.5, pitch_deg: float = 0.0, rows: int = 400
) -> tuple[Frame, Rendered]:
    """A level ground under a camera that looks along the world's x and down, and its render.

    rows: of the camera, which sees as much with more of them.
    """
    width = 480
    height = rows
    focal = 480.0
    camera = Intrinsics(focal, focal * rows / 400, (width - 1) / 2, (height - 1) / 2)
    below = ((np.arange(height) - camera.cy) / camera.fy)[:, None] + np.zeros(width)
    down = below * np.cos(np.deg2rad(pitch_deg)) + np.sin(np.deg2rad(pitch_deg))
    across = ((np.arange(width) - camera.cx) / focal)[None]
    with np.errstate(divide="ignore"):
        depth_m = np.where(down > 0, height_m / down, 0)
    depth_m[depth_m > 30] = 0
    ray = np.sqrt(1 + across**2 + below**2)
    range_m = np.maximum(depth_m * ray, 1e-6)
    radiance = np.where(depth_m > 0, 0.5 * (height_m / range_m) / range_m**2, 0)
    matrix = pose(np.zeros(3), 0, pitch_deg, 0).matrix
    ground = np.full((9, 9), -height_m, np.float32)
    frame = Frame(
        ref=FrameRef("made", "plane", f"{round(10 * time_s):04d}"),
        rgb=np.zeros((height, width, 3), np.uint8),
        depth_m=depth_m.astype(np.float32),
        intrinsics=camera,
        world_from_camera=matrix,
        segmentation=np.zeros((height, width), np.uint8),
        instance=np.zeros((height, width), np.uint16),
        time_s=time_s,
        surroundings=Surroundings(matrix, ground, 2.0),
    )
    return frame, Rendered(radiance.astype(np.float32), depth_m > 0)


class Line:
    """A course along a straight line, which can turn on the way."""

    def __init__(
        self,
        start_m: tuple[float, float, float],
        velocity_m_s: tuple[float, float, float] = (0, 0, 0),
        turn_rad_s: float = 0.0,
    ) -> None:
        self._start_m = np.array(start_m)
        self._velocity_m_s = np.array(velocity_m_s)
        self._turn_rad_s = turn_rad_s

    def at(self, time_s: float) -> Placement:
        """See `Course`."""
        angle = self._turn_rad_s * time_s
        cosine = np.cos(angle)
        sine = np.sin(angle)
        turn = np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1.0]])
        return Placement(self._start_m + time_s * self._velocity_m_s, turn)


def ball(course: Line, radius_m: float = 0.05, **fields: Any) -> Actor:
    """A ball of target strength -25 dB."""
    solid = sphere(3).moved(scale=radius_m)
    values: dict[str, Any] = {
        "number": 1,
        "label": 0,
        "class_name": "Ball",
        "mesh": solid,
        "wave": None,
        "course": course,
        "length_m": 2 * radius_m,
        "strength": -25.0,
    }
    return Actor(**(values | fields))


def moment(actors: list[Actor], time_s: float = 0.0, **ground: Any) -> Moment:
    """The object that moves over the plane at a time."""
    frame, rendered = plane(time_s, **ground)
    return Moment(frame, rendered, bodies_at(actors, frame, time_s), is_continuous=True)


def slab(size_m: tuple[float, float, float]) -> Mesh:
    """A box centred at its origin."""
    from simnfnd.factory.simulation.meshes.triangle_mesh import box

    return replace(box(size_m))
