"""The optional layers: what lies behind a pixel, and each noise effect alone."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import ndimage

from simnfnd.factory import pairs
from simnfnd.factory.config import FactoryConfig, from_mapping
from simnfnd.factory.dataset.schema import Pair, layers
from simnfnd.factory.errors import FactoryError, FrameError
from simnfnd.factory.frame import Frame
from simnfnd.factory.labels import CLASSES
from simnfnd.factory.sonar.fan import fan_table
from tests.frames import HEIGHT_M, POST_M, ground_and_post, labelled, plain_render

TRUTH = ["range", "elevation", "valid_azimuth", "segmentation"]
EFFECTS = ("range_spreading", "multipath", "azimuth", "range_arc", "background")
POLAR = {"image": {"layout": "polar"}, "vfov_deg": 60, "projection": "slant_range"}


def config(**keys: Any) -> FactoryConfig:
    return from_mapping({"scenes": {"kind": "seabed"}, **keys})


def made(settings: FactoryConfig, frame: Frame | None = None, variant: int = 0) -> Pair:
    frame = frame or labelled()
    scene = pairs.observe(frame, plain_render(frame), settings)
    return pairs.make_pair(scene, variant, settings)


def test_each_effect_layer_is_the_noisy_picture_with_that_effect_alone() -> None:
    """As another configuration would make it, in which all others are off."""
    noise = {effect: {"enabled": True} for effect in EFFECTS} | {"range_arc": {"count": 2}}
    noise["range_arc"]["enabled"] = True
    together = made(config(noise=noise, dataset={"layers": ["effects"]}))
    assert set(together.layers) == {f"layers/{effect}" for effect in EFFECTS}
    for effect in EFFECTS:
        off: dict[str, Any] = {other: {"enabled": False} for other in EFFECTS if other != effect}
        alone = made(config(noise={**off, effect: noise[effect]}))
        np.testing.assert_array_equal(together.layers[f"layers/{effect}"], alone.noisy)
        assert np.abs(alone.noisy.astype(int) - alone.clean.astype(int)).sum() > 500


def test_effects_that_are_off_have_no_layer_and_asking_changes_no_picture() -> None:
    off = {"background": {"enabled": False}}
    asked = made(config(noise=off, dataset={"layers": ["effects", *TRUTH]}))
    plain = made(config(noise=off))
    assert "layers/background" not in asked.layers
    for name in ("noisy", "clean", "shadow"):
        np.testing.assert_array_equal(getattr(asked, name), getattr(plain, name))
    assert str(asked.record) == str(plain.record)  # text, because an effect that is off is NaN


def test_range_and_elevation_put_every_echo_back_on_ground_or_post() -> None:
    """range sin(elevation) is the height below the sonar; the picture alone has lost it."""
    settings = config(sonar=POLAR, dataset={"layers": TRUTH})
    frame = labelled()
    scene = pairs.observe(frame, plain_render(frame), settings)
    layer = {name: np.asarray(picture) for name, picture in scene.layers.items()}
    echo = np.isfinite(layer["range"])
    np.testing.assert_array_equal(np.isfinite(layer["elevation"]), echo)
    assert echo.mean() > 0.3
    window = scene.window
    edges_m = window.range_min_m + np.arange(257) / 256 * window.range_span_m
    rows = np.broadcast_to(np.arange(256)[:, None], echo.shape)
    assert (layer["range"][echo] >= edges_m[rows][echo] - 1e-4).all()
    assert (layer["range"][echo] <= edges_m[rows + 1][echo] + 1e-4).all()
    # The camera looks down by 20 degrees, and the sonar with it.
    ground = echo & np.asarray(layer["segmentation"] == 0)
    azimuth = np.broadcast_to(settings.sonar.beam_centres_rad()[None], echo.shape)[ground]
    range_m, elevation = layer["range"][ground], layer["elevation"][ground]
    ahead_m = range_m * np.cos(elevation) * np.cos(azimuth)
    below_m = ahead_m * np.sin(np.deg2rad(20)) - range_m * np.sin(elevation) * np.cos(
        np.deg2rad(20)
    )
    np.testing.assert_allclose(below_m, HEIGHT_M, atol=0.01)
    # The post stands in the middle, from its depth on.
    post = np.asarray(layer["segmentation"] == CLASSES.index("Pillar"))
    assert post.sum() > 3
    assert (np.abs(np.argwhere(post)[:, 1] - 127.5) < 18).all()
    assert layer["range"][post].min() == pytest.approx(POST_M, rel=0.01)
    np.testing.assert_array_equal(layer["instance"] == 7, post)


def test_valid_azimuth_is_what_the_camera_saw() -> None:
    wide = config(sonar={"hfov_deg": 120}, dataset={"layers": ["valid_azimuth"]})
    pair = made(wide)
    valid = np.asarray(pair.layers["valid_azimuth"], np.bool_)
    frame = labelled()
    scene = pairs.observe(frame, plain_render(frame), wide)
    inside = fan_table(wide.sonar, scene.window.near_fraction).inside
    assert pair.layers["valid_azimuth"].dtype == np.bool_
    assert not valid[~inside].any()
    assert valid[inside].mean() == pytest.approx(46 / 120, abs=0.03)
    # Grey values are interpolated beside valid pixels, labels never.
    elsewhere = ~ndimage.binary_dilation(valid, iterations=3)
    assert not np.asarray(pair.noisy)[elsewhere].any()


def test_outside_of_the_fan_there_is_nothing() -> None:
    settings, frame = config(dataset={"layers": TRUTH}), labelled()
    scene = pairs.observe(frame, plain_render(frame), settings)
    outside = ~fan_table(settings.sonar, scene.window.near_fraction).inside
    for name, picture in pairs.make_pair(scene, 0, settings).layers.items():
        values = np.asarray(picture)[outside]
        assert (np.isnan(values) if values.dtype.kind == "f" else values == 0).all(), name
        assert picture.dtype == {layer.name: layer.dtype for layer in layers("uint8", [name])}[name]


def test_labels_are_refused_where_there_are_none() -> None:
    with pytest.raises(FactoryError, match=r"segmentation needs labelled frames.*scenes=seabed"):
        from_mapping(
            {"scenes": {"kind": "flsea", "root": "x"}, "dataset": {"layers": ["segmentation"]}}
        )
    with pytest.raises(FrameError, match="here/plain/0001: has no labels"):
        made(config(dataset={"layers": ["segmentation"]}), ground_and_post())
