"""`simnfnd geometry`: its table is what `denoise --geometry` reads."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
import pytest

from simnfnd.command import main
from simnfnd.factory.errors import FactoryError
from simnfnd.models.data.fans import read_fans
from tests.models.recordings.fan_pictures import fan, preset


def test_table_and_drawings(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "in"
    folder.mkdir()
    pictures = {
        "a.png": fan(preset("didson_hf", 300, 500), 0.2, False),
        "b.png": fan(preset("oculus_m750d_hf", 400, 300), 0.0, False),
    }
    for name, (grey, _) in pictures.items():
        assert cv2.imwrite(str(folder / name), grey)
    assert cv2.imwrite(str(folder / "c.png"), np.full((100, 100), 90, np.uint8))
    (folder / "d.png").write_bytes(b"x")
    assert main(["geometry", str(folder), "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr()
    assert "c.png: no fan found" in said.err
    assert "d.png: not a readable picture" in said.err
    assert "fan found in 2 of 3 pictures" in said.err
    table = tmp_path / "fans.csv"
    table.write_text(said.out)
    fans = read_fans(table)
    assert sorted(fans) == ["a.png", "b.png"]
    for name, (grey, true) in pictures.items():
        found = fans[name]
        assert found.apex_y_px == pytest.approx(true.apex_y_px, abs=2)
        assert found.far_px == pytest.approx(true.far_px, abs=2)
        assert math.degrees(found.sector_rad) == pytest.approx(
            math.degrees(true.sector_rad), abs=0.4
        )
        assert found.near_fraction == pytest.approx(true.near_fraction, abs=0.01)
        drawn = cv2.imread(str(tmp_path / "out" / name))
        assert drawn is not None
        assert drawn.shape[:2] == grey.shape
        assert (drawn[..., 1].astype(int) - drawn[..., 0] > 100).sum() > 500, "the outline"


def test_a_turned_fan_comes_back_from_its_table(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    grey, true = fan(preset("didson_hf", 300, 500), 0.2, False)
    turned = np.rot90(grey)
    assert cv2.imwrite(str(tmp_path / "a.png"), turned)
    assert main(["geometry", str(tmp_path / "a.png")]) == 0
    table = tmp_path / "fans.csv"
    table.write_text(capsys.readouterr().out)
    found = read_fans(table)["a.png"].turned(*turned.shape)
    assert found.apex_x_px == pytest.approx(true.apex_x_px, abs=2)
    assert found.apex_y_px == pytest.approx(true.apex_y_px, abs=2)
    assert found.far_px == pytest.approx(true.far_px, abs=2)
    table.write_text(table.read_text().replace(",3\n", ",7\n"))
    with pytest.raises(FactoryError, match="quarter_turns must be 0, 1, 2 or 3"):
        read_fans(table)


def test_nothing_found(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cv2.imwrite(str(tmp_path / "c.png"), np.full((100, 100), 90, np.uint8))
    assert main(["geometry", str(tmp_path / "c.png")]) == 1
    assert main(["geometry", str(tmp_path / "none.png")]) == 2
    assert "none.png" in capsys.readouterr().err
