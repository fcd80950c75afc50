"""What lies over a picture goes by weights of its own, grain by the usual ones."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest

import simnfnd
from simnfnd.factory.errors import FactoryError
from simnfnd.factory.sonar.geometry import FanGeometry
from simnfnd.models.denoise.asked import InTurn, asked_denoiser
from simnfnd.models.denoise.command import main
from simnfnd.models.denoise.denoiser import Denoiser, load_denoiser
from simnfnd.models.pretrained import REMOVAL
from tests.models.recordings.fan_pictures import fan, preset

Grey = npt.NDArray[np.float32]


def with_a_spoke() -> tuple[Grey, Grey, FanGeometry, npt.NDArray[np.bool_]]:
    """A picture, the same with a bright bearing, its geometry, and where that bearing is."""
    grey, geometry = fan(preset("didson_hf", 300, 400), 0.3, holes=False)
    picture = grey.astype(np.float32) / 255
    maps = geometry.maps(0, 0, *grey.shape)
    spoke = (np.abs(np.rad2deg(maps["azimuth_rad"]) - 5) < 0.4) & (maps["sector"] > 0)
    spoiled = np.clip(picture + np.float32(0.4) * spoke, 0, 1).astype(np.float32)
    return picture, spoiled, geometry, spoke


def test_a_spoke_goes_and_the_grain_stays() -> None:
    picture, spoiled, geometry, spoke = with_a_spoke()
    result = simnfnd.denoise(spoiled, geometry=geometry, remove=["spokes"])
    left = (result - picture)[spoke].mean() / (spoiled - picture)[spoke].mean()
    assert left < 0.5
    rest = ~spoke & (geometry.maps(0, 0, *picture.shape)["sector"] > 0)
    assert np.abs(result - picture)[rest].mean() < 0.2 * picture[rest].std()
    by_usual = simnfnd.denoise(spoiled, geometry=geometry, remove=["spokes"], weights="simnfnd")
    assert (by_usual - picture)[spoke].mean() > (result - picture)[spoke].mean()


def test_both_in_turn() -> None:
    _, spoiled, geometry, _ = with_a_spoke()
    both = asked_denoiser(None, "cpu", ["spokes", "speckle"])
    assert isinstance(both, InTurn)
    first = load_denoiser(REMOVAL, "cpu", remove=["spokes"])
    second = load_denoiser("simnfnd", "cpu", remove=["speckle"])
    expected = second(first(spoiled, geometry), geometry)
    np.testing.assert_array_equal(both(spoiled, geometry), expected)
    assert both.digest not in (first.digest, second.digest)
    assert len(both.digest) == 64
    for words in (None, ["speckle"], ["blur", "speckle"]):
        alone = asked_denoiser(None, "cpu", words)
        assert isinstance(alone, Denoiser)
        assert alone.digest == second.digest
    over = asked_denoiser(None, "cpu", ["haze", "gains"])
    assert isinstance(over, Denoiser)
    assert over.digest == first.digest
    named = asked_denoiser("simnfnd-removal", "cpu", ["haze"])
    assert named.digest == load_denoiser("simnfnd-removal", "cpu").digest


def test_by_the_command(tmp_path: Path) -> None:
    _, spoiled, _, spoke = with_a_spoke()
    noisy = np.rint(spoiled * 255).astype(np.uint8)
    assert cv2.imwrite(str(tmp_path / "a.png"), noisy)
    words = [str(tmp_path / "a.png"), "--out", str(tmp_path / "out")]
    assert main([*words, "--remove", "spokes,speckle", "--strength", "0.9"]) == 0
    result = np.asarray(cv2.imread(str(tmp_path / "out" / "a.png"), 0))
    assert noisy[spoke].mean() - result[spoke].mean() > 40
    with pytest.raises(FactoryError, match="--remove: 'fog' is none of speckle, haze"):
        main([*words, "--remove", "haze,fog"])
