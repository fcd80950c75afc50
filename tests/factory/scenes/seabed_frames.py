"""Small frames of the procedural seabed, and a digest of all that is in one."""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np

from simnfnd.factory.frame import Frame, FrameRef
from simnfnd.factory.scenes.seabed import SeabedReader, SeabedSettings


def small_reader(**keys: Any) -> SeabedReader:
    """A reader of pictures a quarter as wide and high as FLSea's."""
    return SeabedReader(SeabedSettings(**{"width": 242, "height": 152, **keys}))


def ref(location: int, pose: int) -> FrameRef:
    return FrameRef("seabed", f"seabed-{location:04d}", f"{pose:04d}")


def fingerprint(frame: Frame) -> str:
    digest = hashlib.sha256()
    arrays = (frame.rgb, frame.depth_m, frame.world_from_camera, frame.segmentation, frame.instance)
    for array in arrays:
        assert array is not None
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()
