"""The column `boxes`: the objects in sight of a frame, in the axes of the sonar."""

from __future__ import annotations

import json
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from ...common.errors import FrameError
from ...dataset.schema import Column
from ..meshes.camera import oriented
from ..sonar.surface import LitSurface

_MOST_BYTES = 12288
BOXES = (
    Column(
        "boxes",
        f"S{_MOST_BYTES}",
        "",
        "JSON list of the objects in sight, most echoes first: instance, class; centre_m "
        "(ahead, left, up), size_m (length, width, height) and yaw_deg (from ahead to the left) in "
        "the sonar's axes; range_m and bearing_deg (right is positive) around its echoes, null "
        "without any; insonified and shadowed, parts of the outline that it would have alone",
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
                "insonified": round(min(echo_count / outline_px, 1.0), 3),
                "shadowed": round(min(shadow_px / outline_px, 1.0), 3),
            }
        )

    most_echoes_first = sorted(range(len(entries)), key=lambda index: -echo_counts[index])
    entries = [entries[index] for index in most_echoes_first]
    while len(text := json.dumps(entries, separators=(",", ":"))) > _MOST_BYTES:
        entries.pop()
    return {"boxes": text}


def _limits(values: npt.NDArray[np.float32]) -> list[float] | None:
    """Return the smallest and largest value to 3 decimals, None for no values."""
    if not len(values):
        return None
    return [round(float(limit), 3) for limit in (values.min(), values.max())]


def _box_in_sonar_axes(box: npt.NDArray[np.float64], lit: LitSurface) -> dict[str, object]:
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
