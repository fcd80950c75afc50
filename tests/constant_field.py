"""A scene whose mean echo is the same everywhere: what statistics of speckle are measured on."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from simnfnd.factory.config import FactoryConfig, from_mapping
from simnfnd.factory.frame import Frame
from simnfnd.factory.gallery.statistics import FAR_M, NEAR_M, constant_field
from simnfnd.factory.imaging.coherent.scene import FieldScene
from simnfnd.factory.imaging.coherent.signal import Ping
from simnfnd.factory.pairs import ObservedFrame, observe
from simnfnd.factory.render.base import Rendered

__all__ = [
    "FAR_M",
    "NEAR_M",
    "config",
    "constant_field",
    "observed",
    "ping_of",
    "scene_of",
    "slope",
]


def config(**keys: Any) -> FactoryConfig:
    """The physical profile without effects unless named: polar, 128 beams, a fixed window."""
    sonar = {
        "hfov_deg": 24, "vfov_deg": 20, "beams": 128, "range_bins": 192,
        "range": {"auto": False, "min_m": NEAR_M, "max_m": FAR_M},
        "image": {"layout": "polar"},
        "transfer": {"kind": "log"},
    }  # fmt: skip
    sonar |= keys.pop("sonar", {})
    acoustics = {"formation": "field", **keys.pop("acoustics", {})}
    off = ("range_spreading", "multipath", "azimuth", "range_arc", "background")
    noise = {name: {"enabled": False} for name in off} | keys.pop("noise", {})
    return from_mapping(
        {
            "scenes": {"kind": "seabed"},
            "sonar": sonar,
            "acoustics": acoustics,
            "noise": noise,
            **keys,
        }
    )


def observed(settings: FactoryConfig, **frame: Any) -> ObservedFrame:
    """The constant field as the device of `settings` observes it."""
    made, rendered = constant_field(**frame)
    return observe(made, rendered, settings)


def scene_of(made: ObservedFrame) -> FieldScene:
    """Its scene."""
    assert isinstance(made.scene, FieldScene)
    return made.scene


def ping_of(made: ObservedFrame) -> Ping:
    """Its ping."""
    return scene_of(made).ping


def slope(pose_m: tuple[float, float, float], name: str = "0") -> tuple[Frame, Rendered]:
    """A plane that is the same all along x; the camera at `pose_m`."""
    frame, rendered = constant_field(name)
    pose = np.eye(4)
    pose[:3, 3] = pose_m
    return replace(frame, world_from_camera=pose), rendered
