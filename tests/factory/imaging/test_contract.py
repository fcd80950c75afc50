"""Both image formations under one contract: `simnfnd.factory.imaging.contract`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from simnfnd.factory import pairs
from simnfnd.factory.cli.compose import compose_config
from simnfnd.factory.config import FactoryConfig
from simnfnd.factory.noise.draws import StreamNames, draw
from simnfnd.factory.noise.registry import POINT_EFFECTS
from simnfnd.factory.pairs import FORMATIONS
from simnfnd.factory.render.view import view_of
from simnfnd.factory.render.views import OneView
from tests.frames import ground_and_post, plain_render


def config(formation: str) -> FactoryConfig:
    words = {"points": [], "field": ["experiment=physical", "noise.background.enabled=true"]}
    return compose_config([*words[formation], "dataset.dtype=float32", "dataset.layers=[effects]"])


@pytest.mark.parametrize("formation", list(FORMATIONS))
def test_samples_of_a_scene_repeat_and_effects_can_be_chosen(formation: str) -> None:
    settings = config(formation)
    frame = ground_and_post()
    observed = pairs.observe(frame, plain_render(frame), settings)
    draws = draw(settings.noise, settings.seed, StreamNames.of(frame.ref, 0, has_pose=False))
    first, again = (observed.scene.sample(0, draws.effects, settings) for _ in range(2))
    bins = (settings.sonar.range_bins, settings.sonar.beams)
    assert first.clean.shape == observed.scene.filled.shape == bins
    assert set(first.added) == set(draws.names) & set(POINT_EFFECTS)
    assert first.points > 0
    assert 0 < first.rate <= 1
    noisy = first.noisy(draws.names)
    np.testing.assert_array_equal(again.noisy(draws.names), noisy)
    np.testing.assert_array_equal(again.noisy(draws.names), noisy)  # nothing was used up
    for name in draws.names[:2]:
        alone = observed.scene.sample(0, (draws[name],), settings)
        np.testing.assert_array_equal(alone.noisy({name}), first.noisy({name}))
    assert noisy.dtype == first.clean.dtype == np.float32
    assert 0 <= noisy.min() <= noisy.max() <= 1


@pytest.mark.parametrize("formation", list(FORMATIONS))
def test_noise_of_a_call_is_that_of_another_configuration(formation: str) -> None:
    settings = config(formation)
    frame = ground_and_post()
    views = OneView(view_of(frame, plain_render(frame), settings.sonar.mount))
    maker = pairs.PairMaker(settings, views)
    block = replace(settings.noise.background, enabled=False)
    quieter = replace(settings.noise, background=block)
    (given,) = maker.pairs(frame.ref, (1,), quieter)
    (configured,) = pairs.PairMaker(replace(settings, noise=quieter), views).pairs(frame.ref, (1,))
    (usual,) = maker.pairs(frame.ref, (1,))
    np.testing.assert_array_equal(given.noisy, configured.noisy)
    assert str(given.record) == str(configured.record)
    assert set(usual.layers) - set(given.layers) == {"layers/background"}
    assert set(given.record) == {column.name for column in maker.columns()}
