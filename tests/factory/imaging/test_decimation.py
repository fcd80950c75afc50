"""Raw samples averaged in a range bin: looks, targets, and nothing changed without."""

import numpy as np
import pytest
from scipy import special

from simnfnd.factory.imaging import expected
from tests.constant_field import config, effects_of, observed, scene_of

EDGE = (slice(12, -12), slice(20, -20))


def grey(settings, variant):
    made = observed(settings)
    effects = effects_of(settings, made, variant)
    sample = scene_of(made).sample(variant, effects, settings)
    return sample.noisy([effect.name for effect in effects]), sample.clean


@pytest.mark.parametrize(("window", "samples"), [("uniform", 2), ("hamming", 4)])
def test_averaged_samples_are_worth_their_looks(window, samples):
    display = {"kind": "log", "percentile": 50, "reference": 0.6, "dynamic_range_db": 80}
    array = {"bandwidth_khz": 60.0, "pulse": {"window": window}}
    settings = config(
        noise={"speckle": {"scatterer_m": 0.002}},
        sonar={
            "range_bins": 96, "samples_per_bin": samples, "array": array, "transfer": display,
        },
    )  # fmt: skip
    found = [grey(settings, variant) for variant in range(6)]
    scene = scene_of(observed(settings))
    assert scene.ping.shape == (96 * samples, 128)
    looks = expected.looks(scene.ping.kernel, samples)
    assert 1 < looks < samples
    noisy = np.stack([one for one, _ in found])[(slice(None), *EDGE)]
    assert noisy.shape[1:] == (72, 88)
    clean = found[0][1][EDGE]
    decibels = 80 * (noisy - clean).std()
    assert decibels == pytest.approx(4.343 * np.sqrt(special.polygamma(1, looks)), rel=0.06)
    # mean_log: the average of the noisy pictures.
    assert abs(float((noisy.mean(axis=0) - clean).mean())) < 0.006
