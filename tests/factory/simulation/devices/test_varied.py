"""`devices=varied`: the configured sonar, set anew for each image, with labels and its geometry."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.dataset.fan_geometry import FanGeometry, recorded_sonar
from simnfnd.factory.dataset.schema import Pair
from simnfnd.factory.simulation.config.compose import compose_config
from simnfnd.factory.simulation.config.identity import identity
from simnfnd.factory.simulation.config.root import FactoryConfig
from simnfnd.factory.simulation.devices import draw as devices
from simnfnd.factory.simulation.imaging.settings import CoherentSettings
from simnfnd.factory.simulation.pairs.pair_maker import PairMaker
from simnfnd.factory.simulation.pairs.views import Views
from simnfnd.factory.simulation.render.view import view_of
from tests.frames import labelled, plain_render

WORDS = (
    *("devices=varied", "noise=objects", "acoustics=coherent", "render=analytic"),
    *("sonar.image.width_px=96", "sonar.image.height_px=128"),
    *("dataset.layers=[segmentation]", "dataset.columns=[visibility]"),
    *("devices.range_min_m=1.2", "devices.range_max_m={uniform: [4, 8]}", "sonar.sector=whole"),
)


def config(*words: str) -> FactoryConfig:
    return compose_config([*WORDS, *words])


def pairs(settings: FactoryConfig, count: int = 3) -> list[Pair]:
    frame = labelled(world_from_camera=np.eye(4))
    view = view_of(frame, plain_render(frame), settings.sonar.mount)
    maker = PairMaker(settings, Views({frame.ref: view}))
    drawn = maker.pairs(frame.ref, tuple(range(count)))
    names = {column.name for column in maker.columns()}
    assert all(set(pair.record) == names for pair in drawn)
    return drawn


def test_images_of_drawn_devices_have_labels_and_a_geometry_of_their_own() -> None:
    settings = config("devices.hfov_deg={uniform: [24, 40]}")
    drawn = pairs(settings)
    assert len({pair.record["device.hfov_deg"] for pair in drawn}) == 3
    assert len({pair.record["range_max_m"] for pair in drawn}) == 3
    recorded: Any = recorded_sonar(identity(settings))
    for pair in drawn:
        assert (pair.layers["instance"] == 7).any()
        assert set(json.loads(str(pair.record["visibility"]))) == {"7"}
        assert pair.geometry is not None
        assert pair.geometry.sector_rad == pytest.approx(
            np.deg2rad(float(pair.record["device.hfov_deg"]))
        )
        assert FanGeometry.from_record(recorded, pair.record) == pair.geometry


def test_a_key_that_is_not_drawn_is_as_configured() -> None:
    settings = config("devices.tvg_log=null", "acoustics.tvg_log=22", "sonar.beams=80")
    assert settings.devices is not None
    device = devices.draw(settings.devices, 0, "a")
    image = devices.configured(settings, device, any_size=False)
    assert isinstance(image.acoustics, CoherentSettings)
    assert image.acoustics.tvg_log == 22
    assert image.sonar.beams == 80
    assert image.sonar.vfov_deg == device.values["vfov_deg"]
    assert "device.tvg_log" not in {column.name for column in devices.columns(settings.devices)}


def test_materials_are_drawn() -> None:
    settings = config(
        "++devices.reflectivity_db={Tire: -3}", "devices.objects_db=5", "devices.background_db=-33"
    )
    assert settings.devices is not None
    image = devices.configured(settings, devices.draw(settings.devices, 0, "a"), any_size=False)
    assert isinstance(image.acoustics, CoherentSettings)
    assert isinstance(settings.acoustics, CoherentSettings)
    can_db = settings.acoustics.reflectivity_db["Can"]
    echo_db = image.acoustics.reflectivity_db
    assert (echo_db["Background"], echo_db["Tire"]) == (-33, -3)
    assert echo_db["Can"] == can_db + 5


def test_all_images_of_a_place_may_have_one_device() -> None:
    by_place = pairs(config("devices.per=place", "dataset.columns=[]"), 1)[0].record
    frame = labelled(world_from_camera=np.eye(4))
    settings = config("devices.per=place")
    assert settings.devices is not None
    device = devices.draw(settings.devices, settings.seed, frame.ref.location, frame.ref.scene, 0)
    assert by_place["device.range_max_m"] == device.values["range_max_m"]


def test_bearings_without_an_echo_show_the_noise_of_the_receiver() -> None:
    words: tuple[str, ...] = (
        "devices=fixed",
        "noise=physical",
        "sonar.range.auto=false",
        "sonar.hfov_deg=60",
    )
    words += (
        "sonar.range.max_m=6",
        "sonar.transfer.kind=log",
        "sonar.transfer.dynamic_range_db=90",
    )
    words += ("noise.beam_gain.enabled=false", "noise.receiver.level_db=25")
    base = [word for word in WORDS if not word.startswith(("devices", "sonar.sector", "noise="))]
    for sector, is_black in (("seen", True), ("whole", False)):
        settings = compose_config([*base, *words, f"sonar.sector={sector}"])
        pair = pairs(settings, 1)[0]
        assert pair.geometry is not None
        maps = pair.geometry.maps(0, 0, *pair.noisy.shape)
        # The camera sees 45 of the 60 degrees.
        beyond = (np.abs(maps["azimuth_rad"]) > np.deg2rad(25)) & (
            np.abs(maps["azimuth_rad"]) < np.deg2rad(29)
        )
        inside = beyond & (maps["range_fraction"] > 0.3) & (maps["range_fraction"] < 0.95)
        assert (pair.noisy[inside].mean() < 1) == is_black


@pytest.mark.parametrize(
    ("words", "key"),
    [
        (("acoustics.tvg_log=20",), "acoustics.tvg_log"),
        (("sonar.vfov_deg=12",), "sonar.vfov_deg"),
        (("noise=simnfnd",), "noise"),
        (("++devices.reflectivity_db={Shoe: -3}",), "devices.reflectivity_db"),
        (("sonar.image.layout=polar", "devices.beams=64"), "devices.beams"),
        (("devices.field_share=0.5", "dataset.columns=[calibration]"), "dataset"),
        (("dataset.layers=[]",), "dataset.columns"),
    ],
)
def test_what_does_not_go_together_is_refused(words: tuple[str, ...], key: str) -> None:
    with pytest.raises(FactoryError) as caught:
        config(*words)
    assert str(caught.value).startswith(key)
