"""Real images as training data: their fans, and noise on them."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from simnfnd.factory.cli.compose import compose_config
from simnfnd.factory.errors import FactoryError
from simnfnd.factory.noise.draws import Draws, StreamNames, draw
from simnfnd.factory.settings import build
from simnfnd.factory.sonar.fan import fan_table
from simnfnd.factory.sonar.geometry import FanGeometry
from simnfnd.factory.sonar.settings import SonarSettings
from simnfnd.models.data.fans import read_fans
from simnfnd.models.data.images import OldDataSource, list_images, with_noise
from simnfnd.models.data.pairs import open_data
from simnfnd.models.recordings.pictures import read_grey
from simnfnd.models.settings import DATA
from simnfnd.models.training.train import train
from tests.models.data.data_settings import SMALL, composed
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
    source = OldDataSource(samples, str(images / "fans.csv"), silent, weaker=0.0, seed=0)
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
        noisy = with_noise(clean, fan, Draws(config, (effect,)))
        assert not noisy[~sector].any()
        errors[effect.name] = float(np.abs(noisy - clean).mean())
        if not effect.effect.moves:
            assert (noisy - clean).min() > -1e-6, "echoes are added, never taken away"
    assert all(error > 0 for name, error in errors.items() if name != "range_arc")
    # Range spreading moves echoes along their bearing and loses few.
    spread = with_noise(clean, fan, Draws(config, (draws["range_spreading"],)))
    assert spread.sum() == pytest.approx(clean.sum(), rel=0.1)


def test_old_data_trains(images: Path, tmp_path: Path) -> None:
    words = ("data=olddata", f"data.folder='{images}'", f"data.geometry='{images / 'fans.csv'}'")
    out, again = tmp_path / "out", tmp_path / "again"
    best = train(*composed(*words, *SMALL, f"out='{out}'"))
    assert best["step"] in (2, 4, 6)
    assert {"weights.safetensors", "samples.png"} <= {path.name for path in out.iterdir()}
    train(*composed(*words, *SMALL, f"out='{again}'"))
    name = "weights.safetensors"
    assert (out / name).read_bytes() == (again / name).read_bytes()


def test_unusable_folders_are_one_line(images: Path, tmp_path: Path) -> None:
    def opened(*words: str) -> None:
        open_data(composed(*words)[0])

    with pytest.raises(FactoryError, match=r"data\.folder=nowhere: no such folder"):
        opened("data=olddata", "data.folder=nowhere")
    with pytest.raises(FactoryError, match="holds no image"):
        opened("data=olddata", f"data.folder='{tmp_path}'")
    with pytest.raises(FactoryError, match=r"data\.patch=128 is larger than the images of .*png"):
        opened("data=olddata", f"data.folder='{images}'")
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


def test_every_kind_of_data_has_a_configuration() -> None:
    for kind in DATA:
        folder = ["data.folder=x"] if kind == "olddata" else []
        settings, _ = composed(f"data={kind}", *folder)
        assert settings.data.kind == kind
