"""Training pictures of drawn devices, and what they are to be freed of."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from simnfnd.factory.cli.compose import compose_config
from simnfnd.factory.errors import FactoryError
from simnfnd.models.data.any_device import DeviceSource
from simnfnd.models.data.crops import Crops, Visit
from simnfnd.models.removal import DEFAULT, vector
from tests.models.data.small_renders import drawn_devices


@pytest.fixture(scope="module")
def source(rendered: tuple[Path, Path]) -> DeviceSource:
    words = ("devices.quiet_share=0", "devices.height_px={choice: [96, 128, 160]}")
    drawn = drawn_devices(rendered, patch=48, weaker=0.3, choices=0.5)
    small = compose_config(["experiment=any_sonar", *words])
    drawn.config = replace(drawn.config, devices=small.devices)
    return drawn


def test_every_visit_is_another_picture_and_the_same_one_again(source: DeviceSource) -> None:
    samples = [source.sample(0, visit) for visit in range(4)]
    assert len({one.noisy.shape for one in samples}) > 1
    again = pickle.loads(pickle.dumps(source)).sample(0, 3)
    np.testing.assert_array_equal(again.noisy, samples[3].noisy)
    assert again.geometry == samples[3].geometry
    for one in samples:
        assert one.clean is not None
        assert one.shadow is not None
        assert one.noisy.shape == one.clean.shape == one.shadow.shape
        assert min(one.noisy.shape) >= 48
        assert one.noisy.min() >= 0
        assert one.noisy.max() <= 1
        # A shadow is learned where it is black, not where haze lies over it.
        assert not (one.shadow.astype(bool) & (one.clean > 0.02)).any()
    assert any((one.noisy != one.clean).any() for one in samples)


def test_most_visits_remove_the_usual_and_some_what_a_coin_says(source: DeviceSource) -> None:
    chosen = [source.removed(0, visit) for visit in range(200)]
    usual = np.mean([one == DEFAULT for one in chosen])
    assert usual == pytest.approx(0.5, abs=0.1)
    assert len(set(chosen)) > 20
    assert all(chosen)
    sample = source.sample(0, 3)
    assert sample.remove is not None
    # The first device that is tried sees enough of this frame.
    np.testing.assert_array_equal(sample.remove, vector(source.removed(0, 3, 0)))


def test_crops_tell_the_network_what_to_remove(source: DeviceSource) -> None:
    extras = ("range_fraction", "azimuth_rad", "sector", "remove")
    crops = Crops(source, crops=2, flip=True, seed=0, extras=extras)
    batch = crops[Visit(0, 1, 3, 48)]
    assert batch["noisy"].shape == (2, 1, 48, 48)
    assert batch["remove"].shape == (2, 6)


def test_a_recipe_without_devices_is_refused(source: DeviceSource) -> None:
    plain = compose_config(["experiment=demo"])
    with pytest.raises(FactoryError, match=r"data\.experiment: has no"):
        DeviceSource(plain, source.frames, patch=48, weaker=0, choices=0, seed=0)
