"""Renderers that are opened once in a test session, and where a sonar may be."""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from simnfnd.factory.frame import Frame
from simnfnd.factory.render import Rendered, Renderer, RenderSettings, open_renderer
from simnfnd.factory.render.base import Mount
from simnfnd.factory.settings import build

ABOVE, LEFT = Mount((0.0, 0.0, 1.0)), Mount((0.0, 0.8, 0.5))
HERE = Mount()
KINDS = ["analytic", "embree", "cycles", "points"]

_open: dict[RenderSettings, Renderer] = {}


def opened(kind: str, **keys: Any) -> Renderer:
    """One renderer for each setting: Blender starts once in a test session.

    Traced are all pixels, and by Cycles the mesh (or, as `points`, spheres), unless keys say else.
    """
    keys = {"stride": 1, **keys}
    if kind in ("cycles", "points"):
        kind, keys = "cycles", {"geometry": "mesh" if kind == "cycles" else "points", **keys}
    if kind in ("cycles", "embree"):
        pytest.importorskip({"cycles": "bpy", "embree": "open3d"}[kind])
    wanted: RenderSettings = build(RenderSettings, {"kind": kind, **keys})
    if wanted not in _open:
        _open[wanted] = open_renderer(wanted)
    return _open[wanted]


def render(kind: str, frame: Frame, mount: Mount = HERE, **keys: Any) -> Rendered:
    return opened(kind, **keys).render(frame, mount)


def relative_error(found: Rendered, expected: Rendered) -> npt.NDArray[np.float64]:
    lit = found.insonified & expected.insonified
    return np.asarray(np.abs(found.radiance[lit].astype(np.float64) / expected.radiance[lit] - 1))


def digest(rendered: Rendered) -> str:
    return hashlib.sha256(rendered.radiance.tobytes() + rendered.surface.tobytes()).hexdigest()
