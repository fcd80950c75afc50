"""Labels cover what the image shows: a sphere, a plate and a tyre at the edge of the beam."""

from __future__ import annotations

import json
from functools import cache
from typing import Any

import numpy as np
import pytest

from simnfnd.factory.dataset.frame_ref import FrameRef
from simnfnd.factory.dataset.meaning import CLASSES
from simnfnd.factory.dataset.schema import Pair
from simnfnd.factory.production.export.object_boxes import (
    box_of_object,
    box_with_shadow,
    parse_places,
)
from simnfnd.factory.production.export.objects import echo_box
from simnfnd.factory.simulation.config.root import FactoryConfig, from_mapping
from simnfnd.factory.simulation.frames.frame import Frame, Intrinsics
from simnfnd.factory.simulation.imaging.settings import CoherentSettings
from simnfnd.factory.simulation.meshes.camera import Objects, Optics, ZBuffer, centred, pose
from simnfnd.factory.simulation.meshes.triangle_mesh import Mesh, box, sphere
from simnfnd.factory.simulation.noise.registry import EFFECTS
from simnfnd.factory.simulation.pairs import pair_maker
from simnfnd.factory.simulation.render.base import RenderSettings
from simnfnd.factory.simulation.render.renderers import ClosedFormRenderer
from simnfnd.factory.simulation.scenes.seabed.detailed import car_tyre

ALTITUDE_M = 1.2
TILT_DEG = 22.0
VFOV_DEG = 14.0
HALF_RAD = np.deg2rad(VFOV_DEG / 2)
LABEL = CLASSES.index("Tire")


def settings(**sonar: object) -> FactoryConfig:
    """A coherent image without noise, of a narrow vertical beam."""
    return from_mapping(
        {
            "scenes": {"kind": "seabed"},
            "noise": {name: {"enabled": False} for name in EFFECTS},
            "acoustics": {
                "formation": "coherent",
                "reflectivity_db": {"Background": -30.0, "Tire": -10.0},
            },
            "sonar": {
                "hfov_deg": 30,
                "vfov_deg": VFOV_DEG,
                "beams": 96,
                "range_bins": 256,
                "sector": "whole",
                "range": {"auto": False, "min_m": 1.0, "max_m": 6.0},
                "transfer": {"kind": "log", "dynamic_range_db": 80, "full_scale_db": -35},
                "array": {"vertical": {"window": "hann"}},
                **sonar,
            },
            "dataset": {
                "layers": ["segmentation", "elevation"],
                "columns": ["boxes", "visibility"],
            },
        }
    )


def optics() -> Optics:
    return centred(420.0, 260, 220)


def frame_of(shape: Mesh, elevation_deg: float, range_m: float) -> Frame:
    """A mesh at an elevation from the axis of the beam, over a wide floor."""
    viewpoint = pose(np.array([0, 0, ALTITUDE_M]), 0, TILT_DEG, 0)
    down_rad = np.deg2rad(TILT_DEG - elevation_deg)
    middle = np.array([range_m * np.cos(down_rad), 0, ALTITUDE_M - range_m * np.sin(down_rad)])
    extent = (shape.vertices.min(axis=0) + shape.vertices.max(axis=0)) / 2
    solid = shape.moved(middle - extent)
    floor = box((40.0, 40.0, 0.1), (0, 0, -0.05))
    objects = Objects([floor, solid], np.array([0, LABEL], np.uint8))
    z_buffer = ZBuffer(viewpoint, optics(), objects)
    segmentation, instance = z_buffer.shown
    depth_m = np.where(z_buffer.which < 0, np.float32(0), z_buffer.depth_m)
    return Frame(
        ref=FrameRef("here", "edge", "0"),
        rgb=np.full((*depth_m.shape, 3), 128, np.uint8),
        depth_m=depth_m.astype(np.float32),
        intrinsics=Intrinsics(*optics().lens),
        world_from_camera=viewpoint.matrix,
        segmentation=segmentation,
        instance=instance,
        altitude_m=ALTITUDE_M,
        boxes=z_buffer.boxes(instance),
    )


def image_of(frame: Frame, config: FactoryConfig) -> Pair:
    rendered = ClosedFormRenderer(RenderSettings(kind="analytic")).render(frame, config.sonar.mount)
    return pair_maker.make_pair(pair_maker.observe(frame, rendered, config), 0, config)


@cache
def shapes() -> dict[str, Mesh]:
    plate = box((0.02, 0.5, 0.5)).turned("y", np.deg2rad(TILT_DEG))
    tyre = next(
        mesh
        for mesh in (car_tyre(np.random.default_rng(seed)) for seed in range(20))
        if mesh.vertices[:, 2].max() < 0.3
    )
    return {"sphere": sphere(3).moved(scale=0.2), "plate": plate, "tyre": tyre}


def brighter_db(pair: Pair, empty: Pair, config: FactoryConfig) -> Any:
    """By how much an image is brighter than the same without the object, dB."""
    step_db = config.sonar.transfer.dynamic_range_db / 255
    return (pair.clean.astype(float) - empty.clean.astype(float)) * step_db


def widened(mask: np.ndarray, pixels: int = 2) -> np.ndarray:
    from scipy.ndimage import binary_dilation

    return np.asarray(binary_dilation(mask, iterations=pixels))


@pytest.mark.parametrize("name", ["sphere", "plate", "tyre"])
@pytest.mark.parametrize("elevation_deg", [0.0, -6.5, 8.5])
def test_labels_cover_what_the_image_shows(name: str, elevation_deg: float) -> None:
    """Also of what lies beyond half of the opening angle, where the beam still reaches."""
    config = settings()
    frame = frame_of(shapes()[name], elevation_deg, 2.6)
    pair = image_of(frame, config)
    nothing = frame_of(shapes()[name].moved((0, 0, 0)), 80.0, 2.6)
    brighter = brighter_db(pair, image_of(nothing, config), config)
    labelled = _instances(pair) > 0
    shown = brighter > 6
    assert shown.sum() > 40
    assert (widened(labelled) & shown).sum() > 0.9 * shown.sum()
    assert (widened(brighter > 2) & labelled).sum() > 0.9 * labelled.sum()
    assert not (pair.shadow & labelled).any()


def test_what_only_sidelobes_reach_has_no_label() -> None:
    pair = image_of(frame_of(shapes()["sphere"], 24.0, 2.6), settings())
    assert not pair.layers["instance"].any()


def test_labels_know_the_elevations_of_their_echoes() -> None:
    pair = image_of(frame_of(shapes()["sphere"], 8.5, 2.6), settings())
    elevation_rad = pair.layers["elevation"][_instances(pair) > 0]
    assert np.nanmax(elevation_rad) > 1.1 * HALF_RAD


def _instances(pair: Pair) -> Any:
    """The object of each pixel, (H, W)."""
    return pair.layers["instance"]


def visibility_db(pair: Pair) -> float:
    values = json.loads(str(pair.record["visibility"]))
    assert list(values) == ["1"]
    return float(values["1"])


def test_visibility_is_the_contrast_of_the_echoes() -> None:
    """A material that echoes 10 dB less stands out 10 dB less, as long as the display shows it."""
    frame = frame_of(shapes()["sphere"], 0.0, 2.6)
    bright, dull = (
        settings() if level is None else _with_reflectivity(level) for level in (None, -20.0)
    )
    bright_db = visibility_db(image_of(frame, bright))
    dull_db = visibility_db(image_of(frame, dull))
    assert bright_db > 12
    assert bright_db - dull_db == pytest.approx(10, abs=2)


def _with_reflectivity(tire_db: float) -> FactoryConfig:
    from dataclasses import replace

    config = settings()
    assert isinstance(config.acoustics, CoherentSettings)
    acoustics = replace(config.acoustics, reflectivity_db={"Background": -30.0, "Tire": tire_db})
    return replace(config, acoustics=acoustics)


def test_boxes_by_convention() -> None:
    """The echoes alone; these and the dark pixels behind; all of the object."""
    config = settings()
    frame = frame_of(shapes()["tyre"], -2.0, 2.6)
    pair = image_of(frame, config)
    nothing = image_of(frame_of(shapes()["tyre"], 80.0, 2.6), config)
    assert pair.geometry is not None
    place = parse_places(str(pair.record["boxes"]), "here")[1]
    mask = _instances(pair) > 0
    echo = echo_box(mask)
    shape = (pair.clean.shape[0], pair.clean.shape[1])
    shadow = box_with_shadow(echo, place, pair.geometry, shape)
    whole = box_of_object(echo, place, pair.geometry, shape)

    brighter = brighter_db(pair, nothing, config)
    behind = np.zeros(shape, np.bool_)
    left, top, right, _ = (int(edge) for edge in echo.corners)
    behind[:top, left:right] = True
    dark = (brighter < -8) & behind
    rows = np.flatnonzero(dark.sum(axis=1) > 0.4 * echo.width)
    assert len(rows) > 5
    assert shadow.top == pytest.approx(rows.min(), abs=6)
    assert shadow.corners[3] == echo.corners[3]
    # Its far side does not echo.
    assert whole.top <= echo.top
    assert whole.height > echo.height or whole.width > echo.width
    assert whole.top > shadow.top
