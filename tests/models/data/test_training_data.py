"""Kinds of training data: fresh noise on renders, real images as clean, real images alone."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest
import torch
from hydra import compose, initialize_config_module
from omegaconf import OmegaConf

from simnfnd.factory.cli.compose import compose_config
from simnfnd.factory.cli.generate import run
from simnfnd.factory.dataset.read.pair_dataset import in_unit_range
from simnfnd.factory.errors import FactoryError
from simnfnd.factory.noise.draws import Draws, StreamNames, draw
from simnfnd.factory.noise.registry import POINT_EFFECTS, NoiseSettings
from simnfnd.factory.pairs import pair_maker
from simnfnd.factory.recordings.pictures import read_grey
from simnfnd.factory.render.pack import write_pack
from simnfnd.factory.renders.views import CachedViews
from simnfnd.factory.settings import build
from simnfnd.factory.sonar.fan import fan_table
from simnfnd.factory.sonar.geometry import FanGeometry
from simnfnd.factory.sonar.settings import SonarSettings
from simnfnd.models.data.any_device import DeviceSource
from simnfnd.models.data.crops import Crops, Visit, WholeImages
from simnfnd.models.data.fans import read_fans
from simnfnd.models.data.images import list_images
from simnfnd.models.data.olddata import OldDataSource, with_noise
from simnfnd.models.data.pairs import PairSource, hold_out, read_table
from simnfnd.models.data.renders import RenderSource, open_renders, resized
from simnfnd.models.data.sources import open_data
from simnfnd.models.settings import DATA, ModelsSettings, RendersData
from simnfnd.models.training.blind_spots import mask_blind_spots
from simnfnd.models.training.module import DenoisingModule
from simnfnd.models.training.self_supervised import neighbour_pairs, select_pixels
from simnfnd.models.training.train import train
from tests.project_files import ROOT
from tests.small_dataset import fan_images

MDD = ROOT.parent / "shared" / "data" / "mdd"
WORDS = (
    *("experiment=simnfnd", "scenes=seabed", "scenes.locations=4", "scenes.frames_per_location=1"),
    *("scenes.width=160", "scenes.height=100", "render=analytic", "split.test=[]"),
    *("sonar.image.width_px=48", "sonar.image.height_px=40", "sonar.beams=48"),
    *("sonar.range_bins=40", "scheduler=serial", "scenes.objects=0.2", "dataset.preview_pairs=0"),
)
SMALL = (
    *("model.width=4", "model.encoder=[1]", "model.decoder=[1]", "data.patch=32", "data.batch=4"),
    *("train.steps=6", "train.check_every=2", "train.warmup=2", "train.ema=0.5"),
    *("tensorboard=false", "pictures=0", "data.workers=0"),
)


@pytest.fixture(autouse=True, scope="module")
def one_thread() -> None:
    torch.set_num_threads(1)


@pytest.fixture(scope="module")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A dataset of the factory, and a pack of its renders."""
    folder = tmp_path_factory.mktemp("rendered")
    dataset, pack = folder / "data", folder / "views.pack"
    config = compose_config([*WORDS, f"dataset.dir='{dataset}'", f"cache.dir='{folder / 'cache'}'"])
    report, _ = run(config, [])
    views = CachedViews(config)
    from simnfnd.factory.scenes import open_reader

    frames = open_reader(config.scenes).discover().frames
    write_pack(pack, frames, views.view, config.sonar.mount, config.render.kind)
    assert not report.failures
    return dataset, pack


def composed(*words: str) -> tuple[ModelsSettings, dict[str, Any]]:
    with initialize_config_module("simnfnd.conf", version_base="1.3"):
        values: Any = OmegaConf.to_container(compose("models", list(words)), resolve=True)
    return build(ModelsSettings, values), values


def renders(rendered: tuple[Path, Path], **changes: Any) -> tuple[RenderSource, str]:
    dataset, pack = rendered
    settings, _ = composed("data=renders")
    assert isinstance(settings.data, RendersData)
    data = replace(settings.data, **{"pack": str(pack), **changes})
    table = read_table(dataset, "train")
    _, held = hold_out(table.samples, 0.3, 0)
    found = open_renders(data, table, held, str(dataset), seed=5)
    assert isinstance(found.source, RenderSource)
    return found.source, found.said


def _no_picture(*_: object) -> None:
    """Instead of drawing samples.png, which takes longer than the trainings here."""


# --- renders


def test_renders_train_on_no_scene_that_tests_or_validates(rendered: tuple[Path, Path]) -> None:
    source, said = renders(rendered)
    table = read_table(rendered[0], "train")
    _, held = hold_out(table.samples, 0.3, 0)
    scenes = {f"{ref.location}/{ref.scene}" for ref in source.frames}
    assert len(scenes) == 2
    assert scenes.isdisjoint({sample.scene for sample in held})
    tested = read_table(rendered[0], "test").samples
    assert scenes.isdisjoint({sample.scene for sample in tested})
    assert len(source) == 2
    assert said == "renders: 2 frames"


def test_renders_are_the_pairs_of_the_factory_with_other_noise_at_every_visit(
    rendered: tuple[Path, Path],
) -> None:
    source, _ = renders(rendered, weaker=0.0, fewer=0.0)
    maker = pair_maker(source.config)
    ref = source.frames[1]
    for visit in (0, 3):
        pair = maker.pairs(ref, (visit,))[0]
        sample = source.sample(1, visit)
        assert sample.clean is not None
        np.testing.assert_array_equal(sample.noisy, in_unit_range(pair.noisy))
        np.testing.assert_array_equal(sample.clean, in_unit_range(pair.clean))
    assert not np.array_equal(source.sample(1, 0).noisy, source.sample(1, 3).noisy)
    elsewhere = pickle.loads(pickle.dumps(source))
    np.testing.assert_array_equal(elsewhere.sample(1, 3).noisy, source.sample(1, 3).noisy)
    assert source.config.seed == 5


def test_looks_are_variants_of_the_same_render(rendered: tuple[Path, Path]) -> None:
    source, _ = renders(rendered, weaker=0.0, fewer=0.0, frames=3)
    alone, _ = renders(rendered, weaker=0.0, fewer=0.0)
    ref = source.frames[1]
    sample, same = source.sample(1, 3), alone.sample(1, 3)
    assert sample.looks is not None
    assert same.looks is None
    assert sample.clean is not None
    assert same.clean is not None
    np.testing.assert_array_equal(sample.noisy, same.noisy)
    np.testing.assert_array_equal(sample.clean, same.clean)
    before, own, after = sample.looks
    np.testing.assert_array_equal(own, sample.noisy)
    maker = pair_maker(source.config)
    for look, variant in ((before, 3 + 2**32), (after, 3 + 2 * 2**32)):
        pair = maker.pairs(ref, (variant,))[0]
        np.testing.assert_array_equal(look, in_unit_range(pair.noisy))
        assert not np.array_equal(look, own)
    dataset, pack = rendered
    settings, _ = composed("data=renders")
    assert isinstance(settings.data, RendersData)
    table = read_table(dataset, "train")
    _, held = hold_out(table.samples, 0.3, 0)
    data = replace(settings.data, pack=str(pack), frames=3)
    found = open_renders(data, table, held, str(dataset), seed=5)
    assert found.validation is not None
    shown = found.validation.sample(0, None)
    assert shown.looks is not None
    assert shown.looks.shape == (3, *shown.noisy.shape)
    assert len(found.labels) == len(found.validation)


def test_weaker_and_fewer_noise_down_to_none(rendered: tuple[Path, Path]) -> None:
    source, _ = renders(rendered, weaker=0.5, fewer=0.5)
    settings = [source.noise_of(0, visit) for visit in range(80)]
    kept = [tuple(getattr(one, effect).enabled for effect in POINT_EFFECTS) for one in settings]
    assert 0.2 < np.mean([all(enabled) for enabled in kept]) < 0.6
    assert len(set(kept)) > 8, "each effect has a coin of its own"
    full = source.config.noise.background.density.values[1]
    seen = [one.background.density.values[1] / full for one in settings]
    assert min(seen) < 0.2
    assert max(seen) == 1
    none = next(visit for visit in range(200) if not any(_enabled(source.noise_of(0, visit))))
    sample = source.sample(0, none)
    assert sample.clean is not None
    np.testing.assert_array_equal(sample.noisy, sample.clean)
    sure, _ = renders(rendered, weaker=0.0, fewer=0.0)
    assert sure.noise_of(0, 3) == sure.config.noise


def _enabled(settings: NoiseSettings) -> list[bool]:
    return [getattr(settings, effect).enabled for effect in POINT_EFFECTS]


def test_training_on_renders_broken_off_ends_with_the_same_bytes(
    rendered: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    dataset, pack = rendered
    words = (
        *("data=renders", f"dataset.dir='{dataset}'", f"data.pack='{pack}'", *SMALL),
        *("data.validation=0.3", "data.crops=2"),
        "data.stages=[{share: 0.34, patch: 16, batch: 8}]",
    )
    monkeypatch.setattr("simnfnd.models.training.train.write_samples", _no_picture)
    train(*composed(*words, f"out='{tmp_path / 'whole'}'"))
    step = DenoisingModule.training_step
    calls: list[int] = []

    def breaks_down(self: DenoisingModule, batch: Any, index: int) -> Any:
        calls.append(len(batch["noisy"]))
        if len(calls) == 4:
            raise OSError("the power went")
        return step(self, batch, index)

    with monkeypatch.context() as patch:
        patch.setattr(DenoisingModule, "training_step", breaks_down)
        with pytest.raises(OSError, match="power"):
            train(*composed(*words, f"out='{tmp_path / 'broken'}'"))
    assert calls == [8, 8, 4, 4]
    train(*composed(*words, f"out='{tmp_path / 'broken'}'"))
    one, other = (
        (tmp_path / name / "weights.safetensors").read_bytes() for name in ("whole", "broken")
    )
    assert one == other


def test_scales_train_on_pictures_of_several_sizes(rendered: tuple[Path, Path]) -> None:
    source, _ = renders(rendered, scales=(1.0, 2.0), weaker=0.0, fewer=0.0)
    once, _ = renders(rendered, weaker=0.0, fewer=0.0)
    height, width = source.config.sonar.shape()
    drawn = {visit: source.scale_of(0, visit) for visit in range(40)}
    assert 8 < sum(scale == 2 for scale in drawn.values()) < 32
    for scale in (1.0, 2.0):
        visit = next(number for number, one in drawn.items() if one == scale)
        sample = source.sample(0, visit)
        assert sample.noisy.shape == (scale * height, scale * width)
        assert sample.geometry is not None
        sonar = resized(source.config.sonar, scale)
        expected = pair_maker(replace(source.config, sonar=sonar)).pairs(source.frames[0], (visit,))
        np.testing.assert_array_equal(sample.noisy, in_unit_range(expected[0].noisy))
        sector = sample.geometry.maps(0, 0, *sample.noisy.shape)["sector"]
        assert (sector[sample.noisy > 0] > 0).mean() > 0.97
        if scale == 1:
            np.testing.assert_array_equal(sample.noisy, once.sample(0, visit).noisy)
    crops = Crops(source, crops=2, flip=True, seed=1, extras=("range_fraction",))
    sizes = {crops[Visit(visit, 0, visit, 24)]["noisy"].shape for visit in range(4)}
    assert sizes == {(2, 1, 24, 24)}
    assert source.sample(0, None).noisy.shape == (height, width), "validation is as the dataset is"


def test_pixels_apart_from_beams(rendered: tuple[Path, Path]) -> None:
    """[1, 2]: the dataset's beams and range bins, drawn on twice as many pixels a side."""
    source, _ = renders(rendered, scales=((1.0, 2.0),), weaker=0.0, fewer=0.0)
    height, width = source.config.sonar.shape()
    sample = source.sample(0, 0)
    assert sample.noisy.shape == (2 * height, 2 * width)
    sonar = resized(source.config.sonar, (1.0, 2.0))
    assert (sonar.beams, sonar.range_bins) == (
        source.config.sonar.beams,
        source.config.sonar.range_bins,
    )
    expected = pair_maker(replace(source.config, sonar=sonar)).pairs(source.frames[0], (0,))
    np.testing.assert_array_equal(sample.noisy, in_unit_range(expected[0].noisy))
    table = SonarSettings(beams=3, beam_azimuths_deg=(-20.0, 1.0, 20.0))
    assert resized(table, (1, 2)).image.width_px == 2 * table.image.width_px
    words = (f"dataset.dir='{rendered[0]}'", f"data.pack='{rendered[1]}'", *SMALL)
    several = ("data.scales=[1, [2, 0.2]]", "data.batch=2", "data.crops=1")
    settings, _ = composed("data=renders", *words, *several)
    assert isinstance(settings.data, RendersData)
    assert settings.data.scales == (1.0, (2.0, 0.2))
    with pytest.raises(FactoryError, match=r"the images of .* \(8x10\); choose at most 8"):
        open_data(settings)


def test_scales_that_cannot_be(rendered: tuple[Path, Path]) -> None:
    table = SonarSettings(beams=3, beam_azimuths_deg=(-20.0, 1.0, 20.0))
    with pytest.raises(FactoryError, match=r"data\.scales: 2: camera_matched has a table of beams"):
        resized(table, 2)
    assert resized(table, 1) == table
    with pytest.raises(FactoryError, match=r"data\.scales: 16 makes 16384 beams"):
        resized(SonarSettings(beams=1024), 16)
    words = (f"dataset.dir='{rendered[0]}'", f"data.pack='{rendered[1]}'", *SMALL)
    several = ("data.scales=[1, 0.2]", "data.batch=2", "data.crops=1")
    settings, _ = composed("data=renders", *words, *several)
    with pytest.raises(FactoryError, match=r"the images of .* \(8x10\); choose at most 8"):
        open_data(settings)
    with pytest.raises(FactoryError, match=r"data\.scales"):
        composed("data=renders", *words, "data.scales=[]")


def test_words_of_the_factory_change_what_an_experiment_draws(rendered: tuple[Path, Path]) -> None:
    """Also where the dataset itself has no drawn devices."""
    words = ("devices.odd_share=0.9", "noise.spokes.enabled=false")
    source = _drawn(rendered, words)
    usual = _drawn(rendered, ())
    assert source.config.devices is not None
    assert usual.config.devices is not None
    assert source.config.devices.odd_share.values == (0.9,)
    assert replace(source.config.devices, odd_share=usual.config.devices.odd_share) == (
        usual.config.devices
    )
    assert usual.config.noise.spokes is not None
    assert source.config.noise.spokes is not None
    assert usual.config.noise.spokes.enabled
    assert not source.config.noise.spokes.enabled
    with pytest.raises(FactoryError, match=r"odd_shar"):
        _drawn(rendered, ("devices.odd_shar=0.9",))


def _drawn(rendered: tuple[Path, Path], words: tuple[str, ...]) -> DeviceSource:
    settings, _ = composed("data=renders", "data.experiment=any_sonar")
    assert isinstance(settings.data, RendersData)
    data = replace(settings.data, pack=str(rendered[1]), factory=words, patch=16)
    table = read_table(rendered[0], "train")
    _, held = hold_out(table.samples, 0.3, 0)
    source = open_renders(data, table, held, str(rendered[0]), seed=5).source
    assert isinstance(source, DeviceSource)
    return source


def test_renders_that_are_not_there(rendered: tuple[Path, Path], tmp_path: Path) -> None:
    dataset, _ = rendered
    with pytest.raises(FactoryError, match=r"none of the 2 training frames.*data\.pack=FILE"):
        renders(rendered, pack=None, cache=str(tmp_path))
    with pytest.raises(FactoryError, match=r"data\.factory: 'nonsense' is no KEY=VALUE"):
        renders(rendered, factory=("nonsense",))
    with pytest.raises(FactoryError, match=r"needs a dataset of this version.*noise\.fog"):
        renders(rendered, factory=("noise.fog=1",))
    source, _ = renders(rendered, factory=("noise.background.density=0.5",))
    assert source.config.noise.background.density.values == (0.5,)
    # What needs more than the renders, and is no part of a pair.
    source, _ = renders(rendered, factory=("dataset.layers=[range,rgb,depth,echoes]",))
    assert source.config.dataset.layers == ()
    (dataset / "config.yaml").rename(tmp_path / "config.yaml")
    try:
        with pytest.raises(FactoryError, match=r"config\.yaml: cannot be read"):
            renders(rendered)
    finally:
        (tmp_path / "config.yaml").rename(dataset / "config.yaml")


# --- geometry


@pytest.mark.parametrize("near", [0.05, 0.4])
def test_fan_geometry_is_the_factorys(near: float) -> None:
    sonar: SonarSettings = build(
        SonarSettings, {"hfov_deg": 60, "image": {"width_px": 90, "height_px": 70}, "beams": 64}
    )
    table = fan_table(sonar, near)
    maps = FanGeometry.from_sonar(sonar, near, 1.0).maps(0, 0, 70, 90)
    assert np.mean((maps["sector"] > 0) != table.inside) < 0.002  # rounding at the very edge
    rows = (np.arange(sonar.range_bins) + 0.5) / sonar.range_bins * (1 - near) + near
    polar = np.repeat(rows[:, None], sonar.beams, axis=1).astype(np.float32)
    inner = table.inside & (maps["range_fraction"] > near + 0.01) & (maps["range_fraction"] < 0.99)
    np.testing.assert_allclose(
        table.bilinear(polar)[inner], maps["range_fraction"][inner], atol=1e-4
    )
    bearings = np.repeat(sonar.beam_centres_rad()[None], sonar.range_bins, axis=0)
    within = inner & (np.abs(maps["azimuth_rad"]) < np.deg2rad(29))
    np.testing.assert_allclose(
        table.bilinear(bearings)[within], maps["azimuth_rad"][within], atol=1e-4
    )
    part = FanGeometry.from_sonar(sonar, near, 1.0).maps(10, 20, 30, 40)
    for name, values in maps.items():
        np.testing.assert_array_equal(part[name], values[10:40, 20:60])


def test_pixels_are_the_inverse_of_maps() -> None:
    for geometry in (
        FanGeometry.from_sonar(SonarSettings(), 0.2, 1.0),
        FanGeometry.polar().with_size(256, 256),
    ):
        maps = geometry.maps(0, 0, 256, 256)
        row, column = geometry.pixels(maps["range_fraction"], maps["azimuth_rad"])
        inside = maps["sector"] > 0
        rows, columns = np.mgrid[0:256, 0:256]
        np.testing.assert_allclose(row[inside], rows[inside], atol=1e-2)
        np.testing.assert_allclose(column[inside], columns[inside], atol=1e-2)


def test_crops_carry_the_maps_of_their_window(rendered: tuple[Path, Path]) -> None:
    table = read_table(rendered[0], "train")
    source = PairSource(table.samples, table.sonar)
    extras = ("range_fraction", "azimuth_rad", "sector")
    geometry = source.sample(0, None).geometry
    assert geometry is not None
    maps = geometry.maps(0, 0, 40, 48)
    assert (maps["sector"][source.sample(0, None).noisy > 0] > 0).mean() > 0.97
    crops = Crops(source, crops=6, flip=True, seed=1, extras=extras)
    batch = crops[Visit(0, 0, 0, 24)]
    assert {name: tuple(batch[name].shape) for name in extras} == dict.fromkeys(
        extras, (6, 1, 24, 24)
    )
    taller = crops[Visit(0, 0, 0, 44)]["noisy"]
    assert taller.shape == (6, 1, 40, 44), "of a smaller image the whole"
    sides = {crops[Visit(number, 0, 0, 64)]["range_fraction"].shape for number in range(3)}
    assert sides == {(6, 1, 40, 48)}
    rising = batch["azimuth_rad"].diff(dim=-1)
    assert (rising > 0).all(), "a mirrored picture has its bearings from left to right, too"
    whole = WholeImages(source, extras)[0]
    assert whole["sector"].shape == (1, 1, 40, 48)


# --- real images


@pytest.fixture(scope="module")
def images(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Fan pictures with their geometry in a table."""
    folder = tmp_path_factory.mktemp("images")
    rng = np.random.default_rng(3)
    lines = ["file,apex_x,apex_y,edge_slope,top_row,bottom_row"]
    for number in range(5):
        _, clean, _ = fan_images(48, rng)
        cv2.imwrite(str(folder / f"{number}.png"), (clean * 255).astype(np.uint8))
        lines.append(f"{number}.png,23.5,50.4,0.55,0,49")
    (folder / "fans.csv").write_text("\n".join(lines), encoding="utf-8")
    return folder


def test_old_data_without_noise_is_the_image_itself(images: Path) -> None:
    samples = list_images(images)
    silent = compose_config(["noise=none"]).noise
    source = OldDataSource(samples, str(images / "fans.csv"), silent, looks=3, weaker=0.0, seed=0)
    sample = source.sample(0, 0)
    assert sample.clean is not None
    assert sample.shadow is not None
    np.testing.assert_allclose(sample.noisy, sample.clean, atol=1e-6)
    np.testing.assert_allclose(sample.clean, read_grey(samples[0].path), atol=1e-6)
    assert (sample.clean[sample.shadow > 0] <= 0.02).all()


def test_old_data_has_the_factorys_noise_where_it_belongs(images: Path) -> None:
    fan = read_fans(images / "fans.csv")["0.png"]
    clean = read_grey(images / "0.png") * fan.maps(0, 0, 48, 48)["sector"]
    config = compose_config(["noise=simnfnd"]).noise
    draws = draw(config, 0, StreamNames.single("a"))
    sector = fan.maps(0, 0, 48, 48)["sector"] > 0
    errors = {}
    for effect in draws.effects:
        noisy = with_noise(clean, fan, Draws(config, (effect,)), 8)
        assert not noisy[~sector].any()
        errors[effect.name] = float(np.abs(noisy - clean).mean())
        if not effect.moves:
            assert (noisy - clean).min() > -1e-6, "echoes are added, never taken away"
    assert all(error > 0 for name, error in errors.items() if name != "range_arc")
    # Range spreading moves echoes along their bearing and loses few.
    spread = with_noise(clean, fan, Draws(config, (draws["range_spreading"],)), 8)
    assert spread.sum() == pytest.approx(clean.sum(), rel=0.1)


def test_old_data_and_self_supervised_train(
    images: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for kind, more in (
        ("olddata", (f"data.geometry='{images / 'fans.csv'}'",)),
        ("self_supervised", ()),
        ("self_supervised", ("data.method=blind_spot",)),
    ):
        out = tmp_path / f"{kind}{len(more)}"
        words = (f"data={kind}", f"data.folder='{images}'", *more, *SMALL, f"out='{out}'")
        best = train(*composed(*words))
        assert best["step"] in (2, 4, 6)
        assert {"weights.safetensors", "samples.png"} <= {path.name for path in out.iterdir()}
        monkeypatch.setattr("simnfnd.models.training.train.write_samples", _no_picture)
        again = tmp_path / f"{kind}{len(more)}-again"
        train(*composed(*words[:-1], f"out='{again}'"))
        name = "weights.safetensors"
        assert (out / name).read_bytes() == (again / name).read_bytes()
        monkeypatch.undo()


def test_unusable_folders_are_one_line(images: Path, tmp_path: Path) -> None:
    def opened(*words: str) -> None:
        open_data(composed(*words)[0])

    with pytest.raises(FactoryError, match=r"data\.folder=nowhere: no such folder"):
        opened("data=self_supervised", "data.folder=nowhere")
    with pytest.raises(FactoryError, match="holds no image"):
        opened("data=self_supervised", f"data.folder='{tmp_path}'")
    with pytest.raises(FactoryError, match=r"data\.patch=128 is larger than the images of .*png"):
        opened("data=self_supervised", f"data.folder='{images}'")
    table = tmp_path / "fans.csv"
    table.write_text("file,apex_x\n0.png,3\n", encoding="utf-8")
    old = ("data=olddata", f"data.folder='{images}'", "data.patch=16")
    with pytest.raises(FactoryError, match="not a table of fans"):
        opened(*old, f"data.geometry='{table}'")
    lines = (images / "fans.csv").read_text(encoding="utf-8").splitlines()
    table.write_text("\n".join(lines[:3]), encoding="utf-8")
    with pytest.raises(FactoryError, match=r"says nothing about 2\.png and 2 more"):
        opened(*old, f"data.geometry='{table}'")
    with pytest.raises(FactoryError, match=r"data\.kind: 'ducks' is none of"):
        composed("data.kind=ducks")
    with pytest.raises(FactoryError, match="must be a multiple of crops"):
        composed("data.batch=6", "data.crops=4")
    with pytest.raises(FactoryError, match="data=pairs needs the folder"):
        opened()


@pytest.mark.skipif(not MDD.is_dir(), reason="no ../shared/data/mdd")
def test_fans_of_mdd_hold_its_echoes() -> None:
    fans = read_fans(MDD / "fan_geometry.csv")
    for ref in list_images(MDD / "Images")[::12]:
        image = read_grey(ref.path)
        sector = fans[ref.frame].maps(0, 0, *image.shape)["sector"] > 0
        assert (image[~sector] > 0.02).mean() < 0.01
        assert (image[sector] > 0).mean() > 0.9


# --- without clean images


def test_neighbours_are_two_pixels_that_touch() -> None:
    image = torch.arange(2 * 7 * 8, dtype=torch.float32).reshape(2, 1, 7, 8)
    first, second = neighbour_pairs(image.shape, np.random.default_rng(0))
    one, other = select_pixels(image, first), select_pixels(image, second)
    assert one.shape == (2, 1, 3, 4)
    assert set((one - other).abs().unique().tolist()) == {1.0, 8.0}
    rows = one[0, 0] // 8
    assert ((rows // 2) == torch.arange(3)[:, None]).all()


@pytest.mark.parametrize("radius", [0, 2])
def test_blind_spots_see_nothing_of_their_surroundings(radius: int) -> None:
    image = torch.rand(1, 1, 40, 40)
    hidden, chosen = mask_blind_spots(image, np.random.default_rng(4), 0.01, radius)
    places = torch.nonzero(chosen[0, 0]).tolist()
    assert places
    other = image.clone()
    for row, column in places:
        near = np.s_[
            ...,
            max(0, row - radius) : row + radius + 1,
            max(0, column - radius) : column + radius + 1,
        ]
        other[near] = 7.0
    again, _ = mask_blind_spots(other, np.random.default_rng(4), 0.01, radius)
    for row, column in places:
        assert again[0, 0, row, column] != 7.0 or len(places) > 1
    assert (hidden != image).float().mean() < 0.6


def speckled(size: int, seed: int) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """(noisy, clean): multiplicative noise that is independent from pixel to pixel."""
    rng = np.random.default_rng(seed)
    _, clean, _ = fan_images(size, rng)
    noisy = clean * rng.gamma(4, 0.25, clean.shape)
    return np.clip(noisy, 0, 1).astype(np.float32), clean


def test_neighbor2neighbor_denoises_without_a_clean_image(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("simnfnd.models.training.train.write_samples", _no_picture)
    folder = tmp_path / "images"
    folder.mkdir()
    for number in range(8):
        noisy, _ = speckled(64, number)
        cv2.imwrite(str(folder / f"{number}.png"), (noisy * 255).astype(np.uint8))
    words = (
        *("data=self_supervised", f"data.folder='{folder}'", f"out='{tmp_path / 'out'}'", *SMALL),
        *("train.steps=100", "train.check_every=50", "train.learning_rate=0.004", "train.ema=0.9"),
        *("model.width=8", "data.patch=48"),
    )
    train(*composed(*words))
    from simnfnd.models.denoise.denoiser import load_denoiser

    denoise = load_denoiser(tmp_path / "out" / "weights.safetensors", "cpu")
    noisy, clean = speckled(64, 99)
    before, after = (float(np.mean((image - clean) ** 2)) for image in (noisy, denoise(noisy)))
    assert after < 0.7 * before


def test_every_kind_of_data_has_a_configuration() -> None:
    for kind in DATA:
        folder = [] if kind in ("pairs", "renders") else ["data.folder=x"]
        settings, _ = composed(f"data={kind}", *folder)
        assert settings.data.kind == kind
