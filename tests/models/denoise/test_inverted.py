"""Images with dark echoes on a bright ground, and images that come out as they were."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from simnfnd.factory.common.array_types import Float32s
from simnfnd.models.denoise.inverted import InvertedReport, has_inverted_scale, looks_inverted
from simnfnd.models.denoise.options import main
from simnfnd.models.denoise.unchanged import UnchangedReport, has_bright_border, is_unchanged

LAMPREY = Path(__file__).parents[3] / "examples/didson/lamprey.avi"
MDD = Path(__file__).parents[4] / "shared/data/mdd/Images"


def speckled_fan(seed: int, *, ground: float, inverted: bool = False) -> Float32s:
    """(240, 200) float32: a sea floor with bright objects and their shadows in a fan."""
    rng = np.random.default_rng(seed)
    rows, columns = np.mgrid[:240, :200].astype(np.float32)
    depth = 250 - rows
    across = columns - 100
    inside = (np.abs(across) < 0.35 * depth) & (np.hypot(depth, across) < 235) & (depth > 60)

    reflectivity = np.full(inside.shape, 0.12, np.float32)
    for row, column in rng.integers((30, 60), (150, 140), (6, 2)):
        reflectivity[row : row + 6, column : column + 12] = 0.7
        reflectivity[row - 14 : row, column : column + 12] = 0.03
    speckle = cv2.blur(rng.gamma(3, 1 / 3, inside.shape).astype(np.float32), (2, 2))
    image = np.clip(reflectivity * speckle, 0, 1)
    if inverted:
        image = 1 - image
    return np.where(inside, image, np.float32(ground)).astype(np.float32)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("ground", [0.0, 1.0])
def test_the_speckle_tells_dark_echoes_whatever_the_ground(seed: int, ground: float) -> None:
    assert not has_inverted_scale(speckled_fan(seed, ground=ground))
    assert has_inverted_scale(speckled_fan(seed, ground=ground, inverted=True))


def test_an_image_without_a_ground_is_judged_by_its_speckle() -> None:
    echoes = speckled_fan(0, ground=0.0)[40:140, 75:125]
    assert not has_inverted_scale(echoes)
    assert has_inverted_scale(1 - echoes)


@pytest.mark.parametrize("level", [0.0, 0.5, 1.0])
def test_an_image_without_grain_is_not_judged(level: float) -> None:
    assert not has_inverted_scale(np.full((64, 64), level, np.float32))
    assert not has_inverted_scale(np.full((3, 3), level, np.float32))


@pytest.mark.skipif(not MDD.is_dir(), reason="needs the MDD sample in ../shared/data")
def test_real_fans_and_their_inverses_are_told_apart() -> None:
    for path in sorted(MDD.glob("*.png"))[::6]:
        levels = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE).astype(np.float32) / 255
        assert not has_inverted_scale(levels), path.name
        assert has_inverted_scale(1 - levels), path.name


def test_most_images_of_a_file_decide() -> None:
    upright, inverted = (speckled_fan(0, ground=value, inverted=bool(value)) for value in (0, 1))
    report = InvertedReport()
    for name, count in (("title.avi", 1), ("dark.avi", 3)):
        for index in range(4):
            levels = inverted if index < count else upright
            report.add(name, inverted=looks_inverted(levels, levels))
    (line,) = report.summary()
    assert "dark.avi" in line
    assert "title.avi" not in line


def test_twelve_bits_in_sixteen_are_judged_on_their_own_scale() -> None:
    counts = np.rint(speckled_fan(0, ground=1.0, inverted=True) * 4095).astype(np.uint16)
    assert looks_inverted(counts, counts.astype(np.float32) / 65535)


def test_the_command_names_inverted_images_until_invert_is_given(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    grey = cv2.VideoCapture(str(LAMPREY)).read()[1][::2, ::2, 1]
    assert cv2.imwrite(str(tmp_path / "white.png"), 255 - grey)
    assert cv2.imwrite(str(tmp_path / "black.png"), grey)
    words = [str(tmp_path / "white.png"), str(tmp_path / "black.png"), "--out"]

    assert main([*words, str(tmp_path / "as-is"), "--frames", "1"]) == 0
    line = next(line for line in capsys.readouterr().out.splitlines() if "--invert" in line)
    assert "white.png" in line
    assert "black.png" not in line

    out = tmp_path / "out"
    assert main([words[0], "--out", str(out), "--invert"]) == 0
    assert main([words[1], "--out", str(out)]) == 0
    assert "--invert" not in capsys.readouterr().out
    white, black = (cv2.imread(str(out / f"{name}.png"), -1) for name in ("white", "black"))
    np.testing.assert_array_equal(white, 255 - black)


def test_images_that_did_not_change_are_named_and_flat_ones_are_not() -> None:
    bright = np.rint(speckled_fan(0, ground=1.0, inverted=True) * 255).astype(np.uint8)
    flat = np.zeros_like(bright)
    assert is_unchanged(bright, bright)
    assert not is_unchanged(bright, 255 - bright)
    assert not is_unchanged(flat, flat)
    report = UnchangedReport()
    report.add("kept.png", bright_border=has_bright_border(bright))
    (line,) = report.summary()
    assert line.startswith("unchanged: 1 image of kept.png")
    assert "--invert" in line
