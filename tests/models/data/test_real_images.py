"""Real images and frames of recordings as training data: their fans, and noise on them."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from simnfnd.evaluation.judging.recorded import open_input
from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.common.settings import build
from simnfnd.factory.dataset.fan_geometry import FanGeometry
from simnfnd.factory.simulation.config.compose import compose_config
from simnfnd.factory.simulation.noise.draws import Draws, StreamNames, draw
from simnfnd.factory.simulation.sonar.fan import fan_table
from simnfnd.factory.simulation.sonar.settings import SonarSettings
from simnfnd.models.data.images import list_images, read_sample, smallest_side, with_noise
from simnfnd.models.data.sources import open_data
from simnfnd.models.recordings.fan_tables import read_fans
from simnfnd.models.recordings.views import frame_image
from simnfnd.models.training.train import train
from tests.models.data.small_renders import SMALL, composed
from tests.models.recordings.recording_files import pings, write_array
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


# --- real images


@pytest.fixture(scope="module")
def images(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Fan images with their geometry in a table."""
    folder = tmp_path_factory.mktemp("images")
    rng = np.random.default_rng(3)
    lines = ["file,apex_x,apex_y,edge_slope,top_row,bottom_row"]
    for number in range(5):
        _, clean, _ = fan_images(48, rng)
        cv2.imwrite(str(folder / f"{number}.png"), (clean * 255).astype(np.uint8))
        lines.append(f"{number}.png,23.5,50.4,0.55,0,49")
    (folder / "fans.csv").write_text("\n".join(lines), encoding="utf-8")
    return folder


def test_old_data_has_the_factorys_noise_where_it_belongs(images: Path) -> None:
    fan = read_fans(images / "fans.csv")["0.png"]
    clean = frame_image(images / "0.png", 0)[0] * fan.maps(0, 0, 48, 48)["sector"]
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
    moving = tuple(effect for effect in draws.effects if effect.effect.moves)
    spread = with_noise(clean, fan, Draws(config, moving))
    assert spread.sum() == pytest.approx(clean.sum(), rel=0.1)


@pytest.mark.slow
def test_old_data_trains(images: Path, tmp_path: Path) -> None:
    words = ("data=olddata", f"data.folder='{images}'", f"data.geometry='{images / 'fans.csv'}'")
    out = tmp_path / "out"
    again = tmp_path / "again"
    best = train(*composed(*words, *SMALL, f"out='{out}'"))
    assert best["step"] in (2, 4, 6)
    assert {"weights.safetensors", "samples.png"} <= {path.name for path in out.iterdir()}
    train(*composed(*words, *SMALL, f"out='{again}'"))
    name = "weights.safetensors"
    assert (out / name).read_bytes() == (again / name).read_bytes()


def test_unusable_folders_are_one_line(images: Path, tmp_path: Path) -> None:
    old = ("data=olddata", f"data.folder='{images}'")
    table = tmp_path / "fans.csv"
    lines = (images / "fans.csv").read_text(encoding="utf-8").splitlines()
    geometry = (*old, "data.patch=16", f"data.geometry='{table}'")
    for words, rows, said in (
        (("data=olddata", "data.folder=nowhere"), [], r"data\.folder=nowhere: no such folder"),
        (("data=olddata", f"data.folder='{tmp_path}'"), [], "holds no image"),
        (old, [], r"data\.patch=128 is larger than the images of .*png"),
        (geometry, ["file,apex_x", "0.png,3"], "not a table of fans"),
        (geometry, lines[:3], r"says nothing about 2\.png and 2 more"),
        (("data.kind=ducks",), [], "data: Input tag 'ducks'.*'pairs'"),
        (("data.batch=6", "data.crops=4"), [], "must be a multiple of crops"),
        ((), [], "data=pairs needs the folder"),
    ):
        table.write_text("\n".join(rows), encoding="utf-8")
        with pytest.raises(FactoryError, match=said):
            open_data(composed(*words)[0])


def test_every_kind_of_data_has_a_configuration() -> None:
    for kind in ("pairs", "renders", "mixed", "olddata"):
        folder = ["data.folder=x"] if kind == "olddata" else []
        settings, _ = composed(f"data={kind}", *folder)
        assert settings.data.kind == kind


LAMPREY = ROOT / "examples" / "didson" / "lamprey.avi"


def test_frames_stand_beside_images(tmp_path: Path) -> None:
    shutil.copy(LAMPREY, tmp_path / "dive.avi")
    cv2.imwrite(str(tmp_path / "one.png"), np.full((300, 500), 90, np.uint8))
    actual = list_images(tmp_path)
    assert [sample.frame for sample in actual] == [*(f"dive.avi#{n}" for n in range(36)), "one.png"]
    assert actual[0].scene == "dive.avi"
    side, smallest = smallest_side(actual)
    assert (side, smallest.frame) == (300, "one.png")
    frames = [read_sample(actual[number])[0] for number in (7, 0, 36)]
    assert [frame.shape for frame in frames] == [(774, 400), (774, 400), (300, 500)]
    assert 0 <= frames[0].min() < frames[0].max() <= 1
    np.testing.assert_array_equal(frames[1], read_sample(list_images(LAMPREY)[0])[0])


def test_arrays_are_recordings_for_training_and_for_evaluate_real(tmp_path: Path) -> None:
    images = pings(9, 30, 40)
    path = write_array(tmp_path / "a.npy", images)
    actual = list_images(path)
    assert [sample.frame for sample in actual] == [f"a.npy#{n}" for n in range(9)]
    image, _ = read_sample(actual[5])
    np.testing.assert_allclose(image, images[5] / 255, atol=1e-6)
    words = ("data=olddata", f"data.folder='{path}'", "data.patch=16")
    assert len(open_data(composed(*words)[0]).validation) > 0
    stretches, _ = open_input(str(path))
    assert [len(stretch.shots) for stretch in stretches] == [9]
