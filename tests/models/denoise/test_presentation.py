"""Images that lie otherwise or are dark are denoised as the usual ones are."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

import simnfnd
from simnfnd.factory.common.array_types import Array
from simnfnd.models.adapting.stretches import StretchFrame, presented
from simnfnd.models.denoise.options import main
from simnfnd.models.recordings.fan_finder import find_geometry
from tests.models.recordings.fan_images import LEFT, TOP, fan, preset, screen, with_rings

QUARTERS = {"usual": 0, "from the left": 1, "upside down": 2, "from the right": 3}


@pytest.mark.slow
def test_turned_fans_are_denoised_as_the_usual_one(tmp_path: Path) -> None:
    grey, _ = fan(preset("didson_hf", 150, 200), 0.3, holes=False)
    (tmp_path / "in").mkdir()
    for name, turns in QUARTERS.items():
        assert cv2.imwrite(str(tmp_path / "in" / f"{name}.png"), np.rot90(grey, turns))
    assert main([str(tmp_path / "in"), "--out", str(tmp_path / "out")]) == 0
    read: dict[str, Array] = {
        name: np.asarray(cv2.imread(str(tmp_path / "out" / f"{name}.png"), 0)) for name in QUARTERS
    }
    usual = read["usual"].astype(np.float64)
    assert np.abs(usual - grey).mean() > 3
    for name, turns in QUARTERS.items():
        again = np.rot90(read[name], -turns).astype(np.float64)
        assert np.abs(again - usual).mean() < 0.2, name
    turned = np.rot90(grey)
    actual = find_geometry(turned)
    assert actual is not None
    in_python = simnfnd.denoise(turned.astype(np.float32) / 255)
    np.testing.assert_allclose(in_python * 255, read["from the left"], atol=1.5)
    shot = StretchFrame((turned / np.float32(255)).astype(np.float32), actual)
    for presented_shot in presented([shot]):
        np.testing.assert_allclose(presented_shot.grey * 255, grey, atol=1e-3)
        assert presented_shot.geometry is not None
        assert presented_shot.geometry.quarter_turns == 0


@pytest.mark.parametrize("ground", [(0, 0, 0), (45, 45, 45)])
def test_a_screen_keeps_its_text(ground: tuple[int, int, int], tmp_path: Path) -> None:
    """Only the fan is denoised, as it would be alone; rings in colour stay."""
    grey, geometry = fan(preset("didson_hf", 150, 200), 0.3, holes=False)
    inside = geometry.sector_mask(*grey.shape)
    shown = with_rings(screen(grey, inside, ground), geometry, (0, 200, 0))
    (tmp_path / "in").mkdir()
    assert cv2.imwrite(str(tmp_path / "in" / "screen.png"), shown)
    assert cv2.imwrite(str(tmp_path / "in" / "alone.png"), grey)
    assert main([str(tmp_path / "in"), "--out", str(tmp_path / "out")]) == 0
    result = np.asarray(cv2.imread(str(tmp_path / "out" / "screen.png")))
    alone = np.asarray(cv2.imread(str(tmp_path / "out" / "alone.png"), 0)).astype(np.float64)
    part = slice(TOP, TOP + grey.shape[0]), slice(LEFT, LEFT + grey.shape[1])
    around = np.ones(shown.shape[:2], bool)
    around[part] &= cv2.dilate(inside.astype(np.uint8), np.ones((7, 7), np.uint8)) == 0
    np.testing.assert_array_equal(result[around], shown[around])
    coloured = np.ptp(shown, axis=2) > 0
    np.testing.assert_array_equal(result[coloured], shown[coloured])
    np.testing.assert_array_equal(simnfnd.denoise(shown), result, "in Python as by the command")
    assert (simnfnd.denoise(shown, geometry=None) != result).any()
    plain = cv2.erode((inside & ~coloured[part]).astype(np.uint8), np.ones((9, 9), np.uint8)) > 0
    left = np.abs(result[part][..., 0] - alone)[plain].mean()
    assert left < 0.25 * np.abs(alone - grey)[plain].mean()


@pytest.mark.parametrize("bits", [8, 10, 12])
def test_samples_of_few_bits_in_files_of_sixteen(bits: int, tmp_path: Path) -> None:
    """By the weights that ship, fan and all; before, 12 bits were made worse than they were."""
    grey, _ = fan(preset("didson_hf", 150, 200), 0.3, holes=False)
    scale = (2**bits - 1) / 255
    images = {
        "full": grey.astype(np.uint16) * 257,
        "few": np.rint(grey * scale).astype(np.uint16),
    }
    (tmp_path / "in").mkdir()
    for name, image in images.items():
        assert cv2.imwrite(str(tmp_path / "in" / f"{name}.png"), image)
    assert main([str(tmp_path / "in"), "--out", str(tmp_path / "out")]) == 0
    full, few = (
        cv2.imread(str(tmp_path / "out" / f"{name}.png"), cv2.IMREAD_UNCHANGED) for name in images
    )
    assert np.abs(few / scale - full / 257).mean() < 2
    assert np.abs(full / 257 - grey).mean() > 3, "that is less than what denoising does"
    assert few.max() > 100
