"""Training pictures of drawn devices, and what they are to be freed of."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from simnfnd.factory.cli.compose import compose_config
from simnfnd.models.data.renders import DeviceSource
from tests.models.data.small_renders import drawn_devices


@pytest.fixture(scope="module")
def source(rendered: tuple[Path, Path]) -> DeviceSource:
    words = ("devices.quiet_share=0", "devices.height_px={choice: [96, 128, 160]}")
    drawn = drawn_devices(rendered, patch=48, weaker=0.3)
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
