"""The column `boxes`: the objects in sight of a frame, in the axes of the sonar."""

from __future__ import annotations

import json
from collections.abc import Sequence

import numpy as np

from ...common.array_types import Float32s, Float64s
from ...common.errors import FrameError
from ...dataset.schema import Column
from ..meshes.camera import oriented
from ..sonar.surface import LitSurface

_MOST_BYTES = 12288
_FARTHEST_QUANTILE = 0.995
_LEAST_SHADOW_M = 0.02
BOXES = (
    Column(
        "boxes",
        f"S{_MOST_BYTES}",
        "",
        "JSON list of the objects in sight, most echoes first: instance, class; centre_m "
        "(ahead, left, up), size_m (length, width, height) and yaw_deg (from ahead to the left) in "
        "the sonar's axes; range_m and bearing_deg (right is positive) around its echoes, null "
        "without any; shadow_m, where its shadow ends along range, null where none is seen; "
        "insonified and shadowed, parts of the outline that it would have alone",
    ),
)
# Ahead, left and up of the camera, from its right, down, ahead.
_LEVEL = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])


def boxes_row(lit: LitSurface, classes: Sequence[str]) -> dict[str, float | str]:
    """Return the value of `boxes`: the frame's objects as JSON, those with most echoes first.

    Objects with the fewest echoes are left out where the text would exceed the column.
    Raises FrameError for a frame without boxes.
    """
    frame = lit.frame
    if frame.boxes is None or frame.instance is None:
        raise FrameError(f"{frame.ref.name}: has no boxes; leave boxes out of dataset.columns")

    instance_of_pixel = frame.instance.ravel()
    echoes, pixel, _ = lit.shown
    has_echo = echoes.strength > 0
    instance_of_echo = instance_of_pixel[pixel[has_echo]]
    range_m = echoes.range_m[has_echo]
    bearing_deg = np.rad2deg(echoes.azimuth_rad[has_echo])
    is_shadowed = lit.rendered.surface & (lit.rendered.radiance <= 0)
    instance_of_shadow = instance_of_pixel[is_shadowed.ravel()]

    shadows_m = _shadow_ends_m(lit)
    echo_counts: list[int] = []
    entries: list[dict[str, object]] = []
    for instance, label, *box, alone_px, hidden_px in frame.boxes.tolist():
        is_own = instance_of_echo == instance
        echo_count = int(is_own.sum())
        shadow_px = hidden_px + np.count_nonzero(instance_of_shadow == instance)
        outline_px = max(alone_px, 1)
        echo_counts.append(echo_count)
        entries.append(
            {
                "instance": int(instance),
                "class": classes[int(label)],
                **_box_in_sonar_axes(np.array(box), lit),
                "range_m": _limits(range_m[is_own]),
                "bearing_deg": _limits(bearing_deg[is_own]),
                "shadow_m": shadows_m.get(int(instance)),
                "insonified": round(min(echo_count / outline_px, 1.0), 3),
                "shadowed": round(min(shadow_px / outline_px, 1.0), 3),
            }
        )

    most_echoes_first = sorted(range(len(entries)), key=lambda index: -echo_counts[index])
    entries = [entries[index] for index in most_echoes_first]
    while len(text := json.dumps(entries, separators=(",", ":"))) > _MOST_BYTES:
        entries.pop()
    return {"boxes": text}


def _shadow_ends_m(lit: LitSurface) -> dict[int, float]:
    """Instance -> range at which its shadow ends, metres; of objects that throw one.

    What is seen right over the upper edge of an object lies where its shadow ends.  A shadow is
    seen as far as something around it echoes, hence no farther than the farthest echo.
    """
    frame = lit.frame
    assert frame.instance is not None
    echoes = lit.shown.echoes
    if not len(echoes.range_m):
        return {}
    farthest_m = float(np.quantile(echoes.range_m, _FARTHEST_QUANTILE))
    range_m = _range_of_pixels_m(lit)
    below = frame.instance[1:]
    is_edge = (below > 0) & (frame.instance[:-1] != below)
    number = below[is_edge]
    edge_m = range_m[1:][is_edge]
    end_m = np.minimum(range_m[:-1][is_edge], farthest_m)
    ends_m: dict[int, float] = {}
    for instance in np.unique(number):
        is_own = number == instance
        # An edge before which something nearer lies throws no shadow of its own.
        throws = is_own & (end_m > edge_m + _LEAST_SHADOW_M)
        if throws.any():
            ends_m[int(instance)] = round(float(np.quantile(end_m[throws], 0.9)), 3)
    return ends_m


def _range_of_pixels_m(lit: LitSurface) -> Float32s:
    """(H, W) distance of each pixel from the sonar, inf where nothing is."""
    frame = lit.frame
    across, down = frame.intrinsics.directions(*frame.depth_m.shape)
    z = np.where(frame.depth_m > 0, frame.depth_m, np.float32(np.inf))
    if lit.sonar.mount.colocated:
        lengths = np.sqrt(1 + across[None] ** 2 + down[:, None] ** 2)
        return np.asarray(z * lengths, np.float32)
    finite = np.where(np.isfinite(z), z, 0)
    camera_m = np.stack([across[None] * finite, down[:, None] * finite, finite], axis=-1)
    apart_m = np.linalg.norm(camera_m - lit.sonar.mount.position_camera_m(), axis=-1)
    return np.asarray(np.where(np.isfinite(z), apart_m, np.inf), np.float32)


def _limits(values: Float32s) -> list[float] | None:
    """Return the smallest and largest value to 3 decimals, None for no values."""
    if not len(values):
        return None
    return [round(float(limit), 3) for limit in (values.min(), values.max())]


def _box_in_sonar_axes(box: Float64s, lit: LitSurface) -> dict[str, object]:
    """Return centre, size and yaw, in the sonar's axes, of a box in the camera's.

    box: (7,) centre, size (metres) and yaw (radians); see `Frame.boxes`.
    """
    cosine = np.cos(box[6])
    sine = np.sin(box[6])
    yaw_rotation = np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])
    corner_signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    corners_level_m = box[:3] + (corner_signs * box[3:6] / 2) @ yaw_rotation.T

    corners_sonar_m = lit.sonar.mount.in_sonar_axes(corners_level_m @ _LEVEL)
    *centre_and_size_m, yaw_rad = oriented(corners_sonar_m)
    rounded_m = [round(float(length_m), 3) for length_m in centre_and_size_m]
    return {
        "centre_m": rounded_m[:3],
        "size_m": rounded_m[3:],
        "yaw_deg": round(float(np.rad2deg(yaw_rad)), 1),
    }
