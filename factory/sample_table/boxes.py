"""Boxes of the objects in sight, for detectors and for those who work in 3-D."""

from __future__ import annotations

import json
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from ..dataset.schema import Column
from ..errors import FrameError
from ..scenes.seabed.camera import oriented
from ..sonar.surface import LitSurface

_MOST_BYTES = 12288
COLUMNS = (
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


def row(lit: LitSurface, classes: Sequence[str]) -> dict[str, str]:
    """The value of `COLUMNS` for a frame.  Raises FrameError for one without boxes."""
    frame = lit.frame
    if frame.boxes is None or frame.instance is None:
        raise FrameError(f"{frame.ref.name}: has no boxes; leave boxes out of dataset.columns")
    echoes, pixel, _ = lit.insonified
    heard = echoes.strength > 0
    number = frame.instance.ravel()
    of, range_m = number[pixel[heard]], echoes.range_m[heard]
    bearing_deg = np.rad2deg(echoes.azimuth_rad[heard])
    dark = number[(lit.rendered.surface & (lit.rendered.radiance <= 0)).ravel()]
    found = []
    for instance, label, *box, alone_px, hidden_px in frame.boxes.tolist():
        own = of == instance
        count, shadowed = int(own.sum()), hidden_px + np.count_nonzero(dark == instance)
        entry = {
            "instance": int(instance),
            "class": classes[int(label)],
            **_of_sonar(np.array(box), lit),
            "range_m": _limits(range_m[own]),
            "bearing_deg": _limits(bearing_deg[own]),
            "insonified": round(min(count / max(alone_px, 1), 1.0), 3),
            "shadowed": round(min(shadowed / max(alone_px, 1), 1.0), 3),
        }
        found.append((-count, entry))
    kept = [entry for _, entry in sorted(found, key=lambda one: one[0])]
    while len(text := json.dumps(kept, separators=(",", ":"))) > _MOST_BYTES:
        kept.pop()
    return {"boxes": text}


def _limits(values: npt.NDArray[np.float32]) -> list[float] | None:
    return [round(float(v), 3) for v in (values.min(), values.max())] if len(values) else None


def _of_sonar(box: npt.NDArray[np.float64], lit: LitSurface) -> dict[str, object]:
    """Centre, size and yaw of a box in the camera's axes, see `Frame.boxes`, in the sonar's."""
    mount, (c, s) = lit.sonar.mount, (np.cos(box[6]), np.sin(box[6]))
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    corners = box[:3] + (signs * box[3:6] / 2) @ turn.T
    seen = (corners @ _LEVEL - mount.position_camera_m()) @ mount.rotation_sonar_from_camera().T
    *numbers, yaw = oriented(seen)
    centre, size = ([round(float(v), 3) for v in numbers[k : k + 3]] for k in (0, 3))
    return {"centre_m": centre, "size_m": size, "yaw_deg": round(float(np.rad2deg(yaw)), 1)}
