"""A view, and the configuration of a small seabed whose renders are kept in a folder."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from simnfnd.factory.config import FactoryConfig, from_mapping
from simnfnd.factory.render.base import Mount
from simnfnd.factory.render.view import View, view_of
from tests.frames import ground_and_post, plain_render

SMALL_SEABED = {"kind": "seabed", "locations": 1, "frames_per_location": 3}
SMALL_SEABED |= {"width": 240, "height": 160}


def some_view() -> View:
    frame = ground_and_post()
    return view_of(frame, plain_render(frame), Mount())


def config(folder: Path, **keys: object) -> FactoryConfig:
    small = {"scenes": SMALL_SEABED, "render": {"kind": "analytic"}, "cache": {"dir": str(folder)}}
    return from_mapping(small | keys)


def same(one: View, other: View) -> bool:
    a, b = one.unnamed_frame, other.unnamed_frame
    return (
        a.depth_m.tobytes() == b.depth_m.tobytes()
        and one.radiance.tobytes() == other.radiance.tobytes()
        and (a.intrinsics, one.mount) == (b.intrinsics, other.mount)
        and np.array_equal(
            np.asarray(a.world_from_camera, dtype=object),
            np.asarray(b.world_from_camera, dtype=object),
        )
    )
