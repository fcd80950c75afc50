"""A scene whose mean echo is the same everywhere: what statistics of speckle are measured on."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from simnfnd.factory.common.array_types import Float64s
from simnfnd.factory.dataset.frame_ref import FrameRef
from simnfnd.factory.simulation.config.root import FactoryConfig, from_mapping
from simnfnd.factory.simulation.frames.frame import Frame, Intrinsics
from simnfnd.factory.simulation.imaging.coherent import CoherentScene
from simnfnd.factory.simulation.imaging.settings import CoherentSettings
from simnfnd.factory.simulation.imaging.signal import Ping
from simnfnd.factory.simulation.noise.draws import StreamNames, draw
from simnfnd.factory.simulation.pairs.pair_maker import ObservedFrame, observe
from simnfnd.factory.simulation.render.base import Rendered

NEAR_M = 4.0
FAR_M = 8.0


def constant_field(
    name: str = "0",
    pose: Float64s | None = None,
    power: float = 1.0,
    size: tuple[int, int] = (960, 640),
) -> tuple[Frame, Rendered]:
    """A frame of (rows, columns); slant range grows evenly upwards, all echoes have one power."""
    rows, columns = size
    camera = Intrinsics(columns / (2 * np.tan(np.deg2rad(12.2))), 40_000.0, columns / 2, rows / 2)
    across = (np.arange(columns) - camera.cx) / camera.fx
    down = ((np.arange(rows) - camera.cy) / camera.fy)[:, None]
    square = 1 + across**2 + down**2
    range_m = (FAR_M + (NEAR_M - FAR_M) * (np.arange(rows) + 0.5) / rows)[:, None]
    depth_m = (range_m / np.sqrt(square)).astype(np.float32)
    radiance = (power * square**1.5).astype(np.float32)
    rgb = np.zeros((*depth_m.shape, 3), np.uint8)
    frame = Frame(FrameRef("made", "constant", name), rgb, depth_m, camera, pose)
    return frame, Rendered(radiance, depth_m > 0)


def config(**keys: Any) -> FactoryConfig:
    """The physical profile without effects unless named: polar, 128 beams, a fixed window."""
    sonar = {
        "hfov_deg": 24, "vfov_deg": 20, "beams": 128, "range_bins": 192,
        "range": {"auto": False, "min_m": NEAR_M, "max_m": FAR_M},
        "image": {"layout": "polar"},
        "transfer": {"kind": "log"},
    }  # fmt: skip
    sonar |= keys.pop("sonar", {})
    acoustics = {"formation": "coherent", **keys.pop("acoustics", {})}
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


def coherent(settings: FactoryConfig) -> CoherentSettings:
    """Its image formation."""
    assert isinstance(settings.acoustics, CoherentSettings)
    return settings.acoustics


def observed(settings: FactoryConfig, **frame: Any) -> ObservedFrame:
    """The constant field as the device of `settings` observes it."""
    ideal, rendered = constant_field(**frame)
    return observe(ideal, rendered, settings)


def effects_of(settings: FactoryConfig, ideal: ObservedFrame, variant: int = 0) -> Any:
    """The effects of one sample of it, drawn."""
    names = StreamNames.of(ideal.ref, variant, ideal.has_pose)
    return draw(settings.noise, settings.seed, names).effects


def scene_of(ideal: ObservedFrame) -> CoherentScene:
    """Its scene."""
    assert isinstance(ideal.scene, CoherentScene)
    return ideal.scene


def ping_of(ideal: ObservedFrame) -> Ping:
    """Its ping."""
    return scene_of(ideal)


def slope(pose_m: tuple[float, float, float], name: str = "0") -> tuple[Frame, Rendered]:
    """A plane that is the same all along x; the camera at `pose_m`."""
    frame, rendered = constant_field(name)
    pose = np.eye(4)
    pose[:3, 3] = pose_m
    return replace(frame, world_from_camera=pose), rendered
