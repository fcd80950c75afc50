"""The camera of procedural frames sees what the sonar hears, and pays for no more."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from simnfnd.factory.cli.compose import compose_config
from simnfnd.factory.config import FactoryConfig
from simnfnd.factory.errors import FactoryError
from simnfnd.factory.frame import Frame, FrameRef
from simnfnd.factory.scenes import open_reader
from simnfnd.factory.scenes.seabed import SeabedSettings
from simnfnd.factory.scenes.seabed.camera import camera

SMALL = ("scenes.width=320", "scenes.height=200")


@cache
def config_of(*words: str) -> FactoryConfig:
    return compose_config([*SMALL, *words])


@pytest.mark.parametrize(("hfov_deg", "vfov_deg"), [(60, 12), (90, 20), (130, 20)])
def test_a_sector_is_seen_whole_and_costs_its_solid_angle(hfov_deg: int, vfov_deg: int) -> None:
    optics = camera(968, 608, hfov_deg, vfov_deg)
    azimuth, elevation = np.deg2rad([hfov_deg / 2, vfov_deg / 2])
    x = optics.intrinsics.fx * np.tan(azimuth)
    y = optics.intrinsics.fy * np.tan(elevation) / np.cos(azimuth)
    assert optics.intrinsics.cx + x < optics.width - 1
    assert optics.intrinsics.cy + y < optics.height - 1
    angle = 2 * 2 * azimuth * np.sin(elevation)
    usual = 2 * np.deg2rad(45) * np.sin(np.deg2rad(29.2 / 2))
    assert optics.width * optics.height / (968 * 608) == pytest.approx(angle / usual, rel=0.02)


@cache
def frame_of(scenes: SeabedSettings) -> Frame:
    return open_reader(scenes).load(FrameRef("seabed", "seabed-0000", "0000"))


@pytest.mark.parametrize("sonar", ["aris_3000", "gemini_720is", "oculus_m750d_lf"])
def test_every_sonar_has_ground_all_over_its_sector(sonar: str) -> None:
    config = config_of(f"sonar={sonar}", "scenes.places=[sand]")
    assert isinstance(config.scenes, SeabedSettings)
    frame = frame_of(config.scenes)
    columns = np.flatnonzero((frame.depth_m > 0).any(axis=0))
    azimuth_deg = np.rad2deg(np.arctan((columns - frame.intrinsics.cx) / frame.intrinsics.fx))
    half = config.sonar.hfov_deg / 2
    inside = azimuth_deg[np.abs(azimuth_deg) <= half]
    assert inside.max() - inside.min() >= 0.95 * config.sonar.hfov_deg


def test_what_is_asked_for_wins_over_the_sonar() -> None:
    config = config_of("sonar=oculus_m750d_lf", "scenes.hfov_deg=50", "scenes.vfov_deg=30")
    assert isinstance(config.scenes, SeabedSettings)
    assert (config.scenes.hfov_deg, config.scenes.vfov_deg) == (50, 30)
    with pytest.raises(FactoryError, match="give hfov_deg and vfov_deg, or neither"):
        compose_config(["scenes.hfov_deg=50"])
