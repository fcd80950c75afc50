"""Devices drawn for every image: their draws, their record, their rasterisation."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import simnfnd
from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.simulation.config.compose import compose_config
from simnfnd.factory.simulation.config.identity import identity
from simnfnd.factory.simulation.devices import draw as devices
from simnfnd.factory.simulation.noise.registry import blocks
from simnfnd.factory.simulation.sonar.fan import rasterised
from simnfnd.factory.simulation.sonar.settings import ImageSettings, SonarSettings
from simnfnd.factory.simulation.sonar.window import Window

H = 96
W = 152
PLACE: dict[str, Any] = {"fx": 180.0, "fy": 180.0, "cx": 76.0, "cy": 48.0}
WORDS = (
    *("devices=any_sonar", "noise=any_sonar", "acoustics=coherent", "render=analytic"),
    *("sonar.image.width_px=96", "sonar.image.height_px=96"),
)
ALL_FIELD = ("devices.field_share=1", "devices.quiet_share=0", "devices.fewer_share=0")


def pair(*words: str, variant: int = 0) -> Any:
    """A pair of sloping ground with a block on it."""
    down = np.arange(H)[:, None] / H
    depth_m = np.broadcast_to(1.5 / (0.15 + 0.5 * down), (H, W)).astype(np.float32).copy()
    depth_m[40:60, 60:90] *= 0.8
    rgb = np.random.default_rng(0).integers(60, 200, (H, W, 3), dtype=np.uint8)
    return simnfnd.make_pair(rgb, depth_m, **PLACE, variant=variant, config=(*WORDS, *words))


def test_every_variant_has_a_device_of_its_own_and_says_which() -> None:
    rows = [pair(variant=number).record for number in range(4)]
    assert len({row["device.bins_per_px"] for row in rows}) == 4
    assert {row["device.field_share"] for row in rows} <= {0.0, 1.0}
    assert all(20 <= row["device.hfov_deg"] <= 45 for row in rows)
    # Effects of the other formation are off, and the table says so.
    for row in rows:
        points = row["device.field_share"] == 0
        assert np.isnan(row["noise.speckle.looks"]) or not points
        assert np.isnan(row["noise.background.density"]) or points


def test_the_same_name_draws_the_same_device() -> None:
    settings = compose_config(["experiment=any_sonar"]).devices
    assert settings is not None
    first, again, third = (devices.draw(settings, 0, "a", n) for n in (1, 1, 2))
    assert first == again
    assert first.values != third.values
    drawn = [devices.draw(settings, 3, n) for n in range(400)]
    assert np.mean([device.formation == "coherent" for device in drawn]) == pytest.approx(
        0.9, abs=0.05
    )
    assert {round(device.values["beams"]) for device in drawn} == {48, 96, 128, 160, 256, 512}


def test_drawn_values_given_as_numbers_make_the_same_image() -> None:
    first = pair(variant=3)
    row = first.record
    drawn = [name for name in row if name.startswith("device.")]
    fixed = [f"devices.{name.removeprefix('device.')}={row[name]!r}" for name in drawn]
    again = pair(*fixed, variant=3)
    np.testing.assert_array_equal(again.noisy, first.noisy)
    np.testing.assert_array_equal(again.clean, first.clean)


def test_odd_effects_are_those_of_a_share_of_the_images() -> None:
    odd = ("spokes", "ring_down", "surface_multipath", "sidelobe_arcs", "tvg_error", "beam_gain")

    def on(share: int, variants: int) -> list[dict[str, bool]]:
        config = compose_config(["experiment=any_sonar", *ALL_FIELD, f"devices.odd_share={share}"])
        assert config.devices is not None
        drawn = [devices.draw(config.devices, 0, number) for number in range(variants)]
        noises = [devices.configured(config, device, any_size=True).noise for device in drawn]
        return [{name: block.enabled for name, block in blocks(noise).items()} for noise in noises]

    for without in on(0, 4):
        assert not any(without[name] for name in odd)
        assert all(without[name] for name in ("speckle", "receiver", "volume"))
    share = np.mean([actual[name] for actual in on(1, 40) for name in odd])
    assert share == pytest.approx(0.5, abs=0.15)


def test_the_receivers_noise_follows_the_echoes() -> None:
    levels = [
        pair(*ALL_FIELD, f"devices.receiver_db={level}").record["noise.receiver.level_db"]
        for level in (-20, -10)
    ]
    assert levels[1] - levels[0] == pytest.approx(10, abs=1e-6)


def test_rasters_show_samples_as_they_are_or_between() -> None:
    window = Window("slant_range", 1.0, 4.0, -1.0, 1.0)
    polar = (np.random.default_rng(0).integers(0, 256, (24, 16)) / 255).astype(np.float32)

    def raster(**keys: Any) -> Any:
        image = ImageSettings(width_px=120, height_px=160, **keys)
        sonar = SonarSettings(hfov_deg=30, beams=16, range_bins=24, image=image)
        return rasterised(polar, window, sonar, noisy=True)

    nearest = raster(sampling="nearest")
    assert set(np.unique(nearest)) <= {0.0, *np.unique(polar)}
    assert len(np.unique(raster())) > len(np.unique(polar))


@pytest.mark.slow
def test_one_device_may_make_its_pixels_in_the_same_ways() -> None:
    words = ("devices=fixed", "noise=physical", "sonar.image.width_px=90")
    usual = compose_config(["experiment=physical", "sonar.image.width_px=90"])
    assert usual.sonar.image.plain
    said = identity(usual)["sonar"]["image"]
    assert said == {"layout": "fan", "width_px": 90, "height_px": 256}
    before = pair(*words)
    for key, value in (("sampling", "nearest"), ("enlarged", 1.5), ("jpeg_quality", 60)):
        config = compose_config(["experiment=physical", f"sonar.image.{key}={value}"])
        assert identity(config)["sonar"]["image"][key] == value
        changed = pair(*words, f"sonar.image.{key}={value}")
        assert changed.noisy.shape == before.noisy.shape
        assert (changed.noisy != before.noisy).any()
        # A clean image has no traces of compression.
        assert (changed.clean != before.clean).any() == (key != "jpeg_quality")


@pytest.mark.slow
def test_a_device_that_sees_nothing_gives_way_to_the_next() -> None:
    """All of the ground lies nearer than 4 m; half of the devices begin beyond it."""
    far = "devices.range_min_m={choice: [0.7, 20]}"
    words = (far, "devices.range_max_m=30", "devices.auto_range_share=0", "devices.field_share=1")
    rows = [pair(*words, variant=number).record for number in range(6)]
    assert {row["device.range_min_m"] for row in rows} == {0.7}
    with pytest.raises(FactoryError, match="no echo inside"):
        pair(*words, "devices.range_min_m=20")
