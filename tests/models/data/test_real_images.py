"""Real images as training data: their fans, noise on them, learning without clean ones."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest
import torch

from simnfnd.factory.cli.compose import compose_config
from simnfnd.factory.errors import FactoryError
from simnfnd.factory.noise.draws import Draws, StreamNames, draw
from simnfnd.factory.settings import build
from simnfnd.factory.sonar.fan import fan_table
from simnfnd.factory.sonar.geometry import FanGeometry
from simnfnd.factory.sonar.settings import SonarSettings
from simnfnd.models.data.fans import read_fans
from simnfnd.models.data.images import list_images
from simnfnd.models.data.olddata import OldDataSource, with_noise
from simnfnd.models.data.sources import open_data
from simnfnd.models.recordings.pictures import read_grey
from simnfnd.models.settings import DATA
from simnfnd.models.training.blind_spots import mask_blind_spots
from simnfnd.models.training.self_supervised import neighbour_pairs, select_pixels
from simnfnd.models.training.train import train
from tests.models.data.data_settings import SMALL, _no_picture, composed
from tests.project_files import ROOT
from tests.small_dataset import fan_images

MDD = ROOT.parent / "shared" / "data" / "mdd"


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
