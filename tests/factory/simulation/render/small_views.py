"""A view, and the configuration of a small seabed whose renders are kept in a folder."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from simnfnd.factory.simulation.config.root import FactoryConfig, from_mapping
from simnfnd.factory.simulation.render.base import Mount
from simnfnd.factory.simulation.render.view import View, view_of
from tests.frames import ground_and_post, plain_render

SMALL_SEABED = {"kind": "seabed", "locations": 1, "frames_per_location": 3}
SMALL_SEABED |= {"width": 240, "height": 160}


def some_view() -> View:
    frame = ground_and_post()
    return view_of(frame, plain_render(frame), Mount())


def config(folder: Path, **keys: object) -> FactoryConfig:
    small = {"scenes": SMALL_SEABED, "render": {"kind": "analytic"}, "cache": {"dir": str(folder)}}
    return from_mapping(small | keys)


def same(first: View, second: View) -> bool:
    a, b = first.unnamed_frame, second.unnamed_frame
    return (
        a.depth_m.tobytes() == b.depth_m.tobytes()
        and first.radiance.tobytes() == second.radiance.tobytes()
        and (a.intrinsics, first.mount) == (b.intrinsics, second.mount)
        and np.array_equal(
            np.asarray(a.world_from_camera, dtype=object),
            np.asarray(b.world_from_camera, dtype=object),
        )
    )
