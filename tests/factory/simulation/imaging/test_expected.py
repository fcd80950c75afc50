"""The targets: the mean of many displayed images, and each target's scale in the record."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.dataset.schema import Pair
from simnfnd.factory.simulation.config.compose import compose_config
from simnfnd.factory.simulation.frames.frame import Frame
from simnfnd.factory.simulation.imaging.artefacts import ARTEFACTS
from simnfnd.factory.simulation.imaging.coherent import CoherentSample
from simnfnd.factory.simulation.imaging.expected import Expected, display
from simnfnd.factory.simulation.imaging.settings import CoherentSettings
from simnfnd.factory.simulation.noise.registry import EFFECTS
from simnfnd.factory.simulation.pairs.pair_maker import make_pair, observe
from simnfnd.factory.simulation.render.base import Rendered
from simnfnd.factory.simulation.sonar.settings import TransferSettings
from tests.constant_field import config, constant_field, effects_of

IMAGE_SETTINGS = 24
# Those that the same device in the same place has from ping to ping.
CONSTANT = {"beam_gain", "comb_lines"}


def ground() -> tuple[Frame, Rendered]:
    """The constant field with a shadow in it."""
    frame, rendered = constant_field()
    radiance = rendered.radiance.copy()
    radiance[300:500, 250:400] = 0
    return frame, Rendered(radiance, rendered.surface)


def averaged(settings: Any) -> tuple[np.ndarray, np.ndarray]:
    """Mean of many noisy images with the same parameters, and the clean one."""
    observed_frame = observe(*ground(), settings)
    effects = effects_of(settings, observed_frame)
    sample = observed_frame.scene.sample(0, effects)
    assert isinstance(sample, CoherentSample)
    clean = sample.mean
    total = np.zeros(clean.shape)
    for seed in range(IMAGE_SETTINGS):
        others = [e if e.name in CONSTANT else replace(e, seed=seed) for e in effects]
        chosen = {effect.name for effect in others}
        total += observed_frame.scene.sample(0, others).noisy(chosen)
    return total / IMAGE_SETTINGS, clean


NOISE: dict[str, dict[str, Any]] = {
    "speckle": {},
    "volume": {"strength_db": -35},
    "drifting_volume": {"strength_db": -35},
    "surface_multipath": {"loss_db": 2, "tilt_deg": 10},
    "texture": {"shape": 4, "patch_m": 0.02},
    "sidelobe_arcs": {"level_db": -20},
    "crosstalk": {"level_db": -15, "spacing_beams": 1},
    "receiver": {"level_db": 25},
    "tvg_error": {"db_per_decade": -20},
    "beam_gain": {"sigma_db": 2},
    "sector_edges": {"level_db": 8},
    "ring_down": {"level_db": 20, "decay_db_per_m": 10},
    "comb_lines": {"level_db": 0, "spacing_m": 0.5, "decay_db": 1},
    "scintillation": {"sigma_db": 2},
    "saturation": {"level_db": 3},
}


@pytest.mark.parametrize(
    ("effect", "transfer"),
    [*((effect, "log") for effect in NOISE), *(("all", t) for t in ("log", "soft_log", "power"))],
)
def test_the_target_is_the_mean_of_the_displayed_images(effect, transfer):
    """Within 0.012 of full scale; where a row's strongest return leaks, 0.03."""
    noise = NOISE if effect == "all" else {"speckle": {}, effect: NOISE[effect]}
    settings = config(
        noise=noise, water={"depth_m": 1.5},
        sonar={"transfer": {"kind": transfer, "dynamic_range_db": 50, "reference": 0.7}},
    )  # fmt: skip
    mean, clean = averaged(settings)
    difference = mean - clean
    arcs = effect in ("sidelobe_arcs", "all")
    assert abs(difference.mean()) < (0.02 if arcs else 0.006)
    tiles = difference[:, 4:-4].reshape(12, 16, 6, 20).mean(axis=(1, 3))
    assert np.abs(tiles).max() < (0.06 if arcs else 0.02)


def test_speckle_on_a_log_display_is_2_51_db_below_its_mean_intensity() -> None:
    curve = TransferSettings(kind="log", dynamic_range_db=50)
    nothing = np.zeros((2, 3), np.float32)
    level = np.full((2, 3), 10**-2.5, np.float32)  # -25 dB, away from both ends
    state = Expected(level, nothing, nothing, nothing)
    for looks, bias_db in ((1, -2.507), (2, -1.174), (4, -0.566)):
        state.looks = looks
        grey = display(state, 1.0, curve)
        assert 50 * (float(grey[0, 0]) - 0.5) == pytest.approx(bias_db, abs=0.1)


def made(noise: dict[str, dict[str, Any]], target: str, *layers: str) -> Pair:
    """The pair of the ground under some noise, with a target."""
    settings = config(
        noise=noise,
        acoustics={"target": target},
        dataset={"layers": list(layers)},
        water={"depth_m": 1.5},
        sonar={"transfer": {"kind": "log", "dynamic_range_db": 50}},
    )
    return make_pair(observe(*ground(), settings), 0, settings)


def test_the_clean_image_does_not_move_when_noise_is_swept() -> None:
    quiet = made({}, "noise_free")
    loud = made(NOISE, "noise_free")
    np.testing.assert_array_equal(loud.clean, quiet.clean)
    np.testing.assert_array_equal(quiet.noisy, quiet.clean)
    assert np.abs(loud.noisy.astype(float) - quiet.noisy.astype(float)).mean() > 10
    # Sidelobes alone reach into the shadow; the mean of noisy images has the noise's floor there.
    mean_log = made(NOISE, "mean_log").clean
    darkest_mean = np.quantile(mean_log[loud.shadow].astype(float), 0.1)
    assert np.quantile(loud.clean[loud.shadow].astype(float), 0.1) < darkest_mean - 20


def test_the_default_target_is_free_of_noise() -> None:
    acoustics = config().acoustics
    assert isinstance(acoustics, CoherentSettings)
    assert acoustics.target == "noise_free"


def test_the_layer_mean_is_the_target_mean_log() -> None:
    stored = made(NOISE, "noise_free", "mean")
    np.testing.assert_array_equal(stored.layers["mean"], made(NOISE, "mean_log").clean)
    with pytest.raises(FactoryError, match="mean"):
        compose_config(["dataset.layers=[mean]"])


def test_restored_has_no_systematic_effect_and_mean_log_has_them() -> None:
    systematic = {"receiver": {"level_db": 30}, "tvg_error": {"db_per_decade": -40}}
    clean_images: dict[tuple[str, int], Any] = {}
    for target in ("mean_log", "restored"):
        for effect in ({}, systematic):
            noise = {"speckle": {}, **effect}
            dtype = {"dtype": "float32"}
            settings = config(noise=noise, acoustics={"target": target}, dataset=dtype)
            clean_images[target, len(effect)] = make_pair(
                observe(*ground(), settings), 0, settings
            ).clean
    np.testing.assert_array_equal(clean_images["restored", 0], clean_images["restored", 2])
    np.testing.assert_array_equal(clean_images["restored", 0], clean_images["mean_log", 0])
    assert np.abs(clean_images["mean_log", 2] - clean_images["mean_log", 0]).mean() > 0.02


def test_the_record_has_the_scale_of_the_target() -> None:
    settings = config(noise={"speckle": {}})
    record = make_pair(observe(*ground(), settings), 0, settings).record
    assert record["clean_full_scale"] == record["full_scale"]
    points = compose_config(["sonar.transfer.kind=log"])
    frame, rendered = constant_field(size=(240, 160))
    assert "clean_full_scale" not in make_pair(observe(frame, rendered, points), 0, points).record


def sampled(noise: dict[str, dict[str, Any]]) -> Any:
    """A sample of the ground with these effects."""
    settings = config(noise=noise)
    observed_frame = observe(*ground(), settings)
    return observed_frame.scene.sample(0, effects_of(settings, observed_frame))


def test_every_effect_says_what_it_shows_and_texture_is_part_of_the_scene() -> None:
    assert {effect.artefact for effect in EFFECTS.values()} == {*ARTEFACTS, None}
    assert [name for name, effect in EFFECTS.items() if effect.artefact is None] == ["texture"]


def test_an_image_without_an_artefact_has_all_the_others() -> None:
    """Under the same random streams, so what is kept is kept to the grey value."""
    noise = {name: NOISE[name] for name in ("speckle", "volume", "receiver", "beam_gain")}
    sample = sampled({**noise, "spokes": {"count": 2, "level_db": -10}})
    every = {*noise, "spokes"}
    np.testing.assert_array_equal(sample.without(()), sample.noisy(every))
    np.testing.assert_array_equal(sample.without(("spokes",)), sample.noisy({*noise}))
    without = sample.without(("haze", "gains"))
    np.testing.assert_array_equal(without, sample.noisy({"speckle", "spokes"}))


def test_without_speckle_no_grain_is_left_and_texture_stays() -> None:
    sample = sampled({"speckle": {}, "spokes": {"count": 1}, "volume": {"strength_db": -35}})
    cleaned = sample.without(("speckle", "spokes"))
    noisy = sample.noisy({"speckle", "spokes", "volume"})
    # Neighbours along range are alike where the ground is.
    assert np.abs(np.diff(cleaned, axis=0)).mean() < 0.1 * np.abs(np.diff(noisy, axis=0)).mean()
    patches = sampled({"speckle": {}, "texture": {"shape": 2, "patch_m": 0.3}})
    difference = patches.without(("speckle",)) - sampled({"speckle": {}}).without(("speckle",))
    assert difference.std() > 0.02
