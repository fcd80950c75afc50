"""Renders as training data: the pairs of the factory, with fresh noise at every visit."""

from __future__ import annotations

import pickle
import shutil
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.dataset.pair_dataset import in_unit_range
from simnfnd.factory.simulation.config.compose import compose_config
from simnfnd.factory.simulation.noise.registry import EFFECTS, NoiseSettings
from simnfnd.factory.simulation.pairs.pair_maker import pair_maker
from simnfnd.models.data.crops import Crops, Visit, whole_image
from simnfnd.models.data.pairs import TrainingPairs, hold_out, read_table
from simnfnd.models.data.renders import DeviceSource, ImageScale, resized
from simnfnd.models.data.sources import open_data
from simnfnd.models.training.loop import TrainingLoop
from simnfnd.models.training.train import train
from tests.models.data.small_renders import (
    SMALL,
    WORDS,
    composed,
    data_settings,
    drawn_devices,
    rendered_dataset,
    renders,
)

POINT_EFFECTS = [name for name, effect in EFFECTS.items() if effect.stage == "points"]


@pytest.fixture(scope="module")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A dataset, and a pack of its renders."""
    return rendered_dataset(tmp_path_factory.mktemp("rendered"))


def test_renders_train_on_no_scene_that_tests_or_validates(
    rendered: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    source = renders(rendered)
    table = read_table(rendered[0], "train")
    _, held = hold_out(table.samples, 0.3, 5)
    scenes = {f"{ref.location}/{ref.scene}" for ref in source.images}
    assert len(scenes) == 2
    assert scenes.isdisjoint({sample.scene for sample in held})
    tested = read_table(rendered[0], "test").samples
    assert scenes.isdisjoint({sample.scene for sample in tested})
    assert len(source) == 2
    assert capsys.readouterr().out == "renders: 2 frames\n"


@pytest.mark.slow
def test_renders_that_training_makes_need_no_test_split_and_are_missed_by_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["simnfnd"])
    words = [*WORDS, "split.test=[no_such_scene]", "cache.dir=cache"]
    settings, _ = composed("data=renders", "data.patch=32")
    data: Any = settings.data
    settings = replace(settings, data=replace(data, make=words, validation=0.3))
    open_data(settings)
    assert "no_such_scene" not in capfd.readouterr().err
    (folder,) = Path("outputs").iterdir()

    shutil.rmtree("cache")
    with pytest.raises(FactoryError, match=f"delete {folder}"):
        open_data(settings)


def test_renders_are_the_pairs_of_the_factory_with_other_noise_at_every_visit(
    rendered: tuple[Path, Path],
) -> None:
    source = renders(rendered, weaker=0.0, fewer=0.0)
    maker = pair_maker(source.config)
    ref = source.images[1]
    elsewhere = pickle.loads(pickle.dumps(source))
    for visit in (0, 3):
        pair = maker.pairs(ref, (visit,))[0]
        sample = source.sample(1, visit)
        np.testing.assert_array_equal(sample.noisy, in_unit_range(pair.noisy))
        np.testing.assert_array_equal(sample.clean, in_unit_range(pair.clean))
    assert not np.array_equal(source.sample(1, 0).noisy, source.sample(1, 3).noisy)
    np.testing.assert_array_equal(elsewhere.sample(1, 3).noisy, source.sample(1, 3).noisy)
    assert source.config.seed == 5


def test_weaker_and_fewer_noise_down_to_none(rendered: tuple[Path, Path]) -> None:
    source = renders(rendered, weaker=0.5, fewer=0.5)
    settings = [source.noise_of(0, visit) for visit in range(80)]
    remaining = [
        tuple(getattr(noise, effect).enabled for effect in POINT_EFFECTS) for noise in settings
    ]
    assert 0.2 < np.mean([all(enabled) for enabled in remaining]) < 0.6
    assert len(set(remaining)) > 8, "each effect has a coin of its own"
    full = source.config.noise.background.density.values[1]
    observed = [noise.background.density.values[1] / full for noise in settings]
    assert min(observed) < 0.2
    assert max(observed) == 1
    none = next(visit for visit in range(200) if not any(_enabled(source.noise_of(0, visit))))
    sample = source.sample(0, none)
    np.testing.assert_array_equal(sample.noisy, sample.clean)
    sure = renders(rendered, weaker=0.0, fewer=0.0)
    assert sure.noise_of(0, 3) == sure.config.noise


def _enabled(settings: NoiseSettings) -> list[bool]:
    return [getattr(settings, effect).enabled for effect in POINT_EFFECTS]


def test_training_on_renders_broken_off_ends_with_the_same_bytes(
    rendered: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    dataset, pack = rendered
    words = (
        *("data=renders", f"dataset.dir='{dataset}'", f"data.pack='{pack}'", *SMALL),
        *("data.validation=0.3", "data.crops=2", "data.reuse=2"),
    )
    train(*composed(*words, f"out='{tmp_path / 'whole'}'"))
    step = TrainingLoop.update
    calls: list[int] = []

    def breaks_down(self: TrainingLoop, *arguments: Any) -> Any:
        calls.append(len(arguments[-1]["noisy"]))
        if len(calls) == 4:
            raise OSError("the power went")
        return step(self, *arguments)

    with monkeypatch.context() as patch:
        patch.setattr(TrainingLoop, "update", breaks_down)
        with pytest.raises(OSError, match="power"):
            train(*composed(*words, f"out='{tmp_path / 'broken'}'"))
    train(*composed(*words, f"out='{tmp_path / 'broken'}'"))
    first, second = (
        (tmp_path / name / "weights.safetensors").read_bytes() for name in ("whole", "broken")
    )
    assert first == second


def test_scales_train_on_images_of_several_sizes(rendered: tuple[Path, Path]) -> None:
    source = renders(rendered, scales=(1.0, 2.0, (1.0, 2.0)), weaker=0.0, fewer=0.0)
    once = renders(rendered, weaker=0.0, fewer=0.0)
    height, width = source.config.sonar.shape()
    drawn = {visit: source.scale_of(0, visit) for visit in range(40)}
    wide_cells = ImageScale(cells=1, pixels=2)
    assert 4 < sum(scale == wide_cells for scale in drawn.values()) < 26
    for scale in (ImageScale(1, 1), ImageScale(2, 2), wide_cells):
        visit = next(number for number, drawn_scale in drawn.items() if drawn_scale == scale)
        sample = source.sample(0, visit)
        assert sample.noisy.shape == (scale.pixels * height, scale.pixels * width)
        assert sample.geometry is not None
        sonar = resized(source.config.sonar, scale)
        expected = pair_maker(replace(source.config, sonar=sonar)).pairs(source.images[0], (visit,))
        np.testing.assert_array_equal(sample.noisy, in_unit_range(expected[0].noisy))
        sector = sample.geometry.maps(0, 0, *sample.noisy.shape)["sector"]
        assert (sector[sample.noisy > 0] > 0).mean() > 0.97
        if scale.pixels == 1:
            np.testing.assert_array_equal(sample.noisy, once.sample(0, visit).noisy)
    crops = Crops(source, data_settings(patch=24, batch=8, crops=2), 1, ("range_fraction",))
    sizes = {crops[Visit(visit, 0, visit)]["noisy"].shape for visit in range(4)}
    assert sizes == {(2, 1, 24, 24)}
    assert source.sample(0, None).noisy.shape == (height, width), "validation is as the dataset is"


def test_crops_carry_the_maps_of_their_window(rendered: tuple[Path, Path]) -> None:
    table = read_table(rendered[0], "train")
    source = TrainingPairs(table.samples, table.sonar)
    extras = ("range_fraction", "azimuth_rad", "sector")
    geometry = source.sample(0, None).geometry
    assert geometry is not None
    maps = geometry.maps(0, 0, 40, 48)
    assert (maps["sector"][source.sample(0, None).noisy > 0] > 0).mean() > 0.97

    def crops(number: int, patch: int) -> dict[str, Any]:
        data = data_settings(patch=patch, batch=6, crops=6)
        return Crops(source, data, 1, extras)[Visit(number, 0, 0)]

    batch = crops(0, 24)
    assert {name: tuple(batch[name].shape) for name in extras} == dict.fromkeys(
        extras, (6, 1, 24, 24)
    )
    taller = crops(0, 44)["noisy"]
    assert taller.shape == (6, 1, 40, 44), "of a smaller image the whole"
    sides = {crops(number, 64)["range_fraction"].shape for number in range(3)}
    assert sides == {(6, 1, 40, 48)}
    rising = batch["azimuth_rad"].diff(dim=-1)
    assert (rising > 0).all(), "a mirrored image has its bearings from left to right, too"
    whole = whole_image(source.sample(0, None), extras)
    assert whole["sector"].shape == (1, 1, 40, 48)


@pytest.fixture(scope="module")
def source(rendered: tuple[Path, Path]) -> DeviceSource:
    words = ("devices.quiet_share=0", "devices.height_px={choice: [96, 128, 160]}")
    drawn = drawn_devices(rendered, patch=48, weaker=0.3)
    small = compose_config(["experiment=any_sonar", *words])
    drawn.config = replace(drawn.config, devices=small.devices)
    return drawn


@pytest.mark.slow
def test_every_visit_is_another_image_and_the_same_one_again(source: DeviceSource) -> None:
    elsewhere = pickle.loads(pickle.dumps(source))
    samples = [source.sample(0, visit) for visit in range(4)]
    assert len({sample.noisy.shape for sample in samples}) > 1
    again = elsewhere.sample(0, 3)
    np.testing.assert_array_equal(again.noisy, samples[3].noisy)
    assert again.geometry == samples[3].geometry
    for sample in samples:
        assert sample.shadow is not None
        assert sample.noisy.shape == sample.clean.shape == sample.shadow.shape
        assert min(sample.noisy.shape) >= 48
        assert sample.noisy.min() >= 0
        assert sample.noisy.max() <= 1
        # A shadow is learned where it is black, not where haze lies over it.
        assert not (sample.shadow.astype(bool) & (sample.clean > 0.02)).any()
    assert any((sample.noisy != sample.clean).any() for sample in samples)
