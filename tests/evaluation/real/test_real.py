"""`simnfnd evaluate real`: pictures without truth, measured and segmented."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from simnfnd.command import main
from simnfnd.evaluation.filters import REGISTRY
from simnfnd.evaluation.real.groups import sector_of
from simnfnd.evaluation.real.judge import Scene, figures_of, scene_of
from simnfnd.evaluation.recorded import MDD_GEOMETRIES, MDD_SHAPE, Shot, open_input
from tests.evaluation.filters.scenes import BROKEN

Array = npt.NDArray[Any]


def save(path: Path, picture: Array) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.rint(np.clip(picture, 0, 1) * 255).astype(np.uint8))


def fans(root: Path, count: int) -> Path:
    """Pictures of both fans with speckle, a shadow and a bright object each."""
    rng = np.random.default_rng(0)
    for number in range(count):
        name = "AB"[number % 2]
        sector = MDD_GEOMETRIES[name].sector_mask(*MDD_SHAPE)
        clean = np.where(sector, 0.4, 0.0)
        row, column = int(rng.integers(90, 220)), int(rng.integers(130, 170))
        clean[row : row + 24, column : column + 24] = 0.8
        clean[row + 30 : row + 150, column - 40 : column + 64] *= 0.05
        noisy = clean * rng.gamma(6, 1 / 6, clean.shape)
        save(root / "Images" / f"{number:02d}.png", np.where(sector, np.maximum(noisy, 1 / 255), 0))
    return root


def scene(shot: Shot) -> Scene:
    picture, geometry = shot.read()
    return scene_of(picture, sector_of(picture, geometry), shot.name)


def real(*words: str) -> int:
    return main(["evaluate", "real", *words, "workers=1"])


def test_both_fans_of_the_dataset_get_their_geometry(tmp_path: Path) -> None:
    (stretch,), notes = open_input(str(fans(tmp_path / "mdd", 2)))
    assert notes == ("Marine Debris Dataset: 1 of geometry A, 1 of geometry B",)
    for shot, name in zip(stretch.shots, "AB", strict=True):
        shared = scene(shot)
        own = MDD_GEOMETRIES[name]
        np.testing.assert_array_equal(shared.sector, own.sector_mask(*MDD_SHAPE))
        # The same sector by the geometry that filters and networks get.
        _, known = shot.read()
        assert known is not None
        theirs = known.maps(0, 0, *MDD_SHAPE)["sector"] > 0
        assert (theirs ^ shared.sector).sum() < 0.005 * shared.sector.sum()
        # Dark ground lies in the shadow.
        assert shared.noisy[shared.dark].mean() < 0.3 < shared.noisy[shared.bright].mean()


def test_figures_say_what_was_done(tmp_path: Path) -> None:
    (stretch,), _ = open_input(str(fans(tmp_path / "mdd", 1)))
    shared = scene(stretch.shots[0])
    same = figures_of(shared.noisy, shared)
    assert same["edges_kept"] == pytest.approx(1)
    blurred = cv2.GaussianBlur(shared.noisy, (0, 0), 2)
    smooth = figures_of(np.asarray(blurred, np.float32), shared)
    assert smooth["enl"] > 3 * same["enl"]
    assert smooth["edges_kept"] < 0.5
    half = figures_of(shared.noisy / 2, shared)
    for name in ("enl", "cnr", "edges_kept"):
        assert half[name] == pytest.approx(same[name], rel=1e-4), name
    black = figures_of(np.zeros_like(shared.noisy), shared)
    assert math.isnan(black["edges_kept"])


def test_the_report_of_a_folder_without_static_groups(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(REGISTRY, "broken", BROKEN)
    folder, out = fans(tmp_path / "mdd", 2), tmp_path / "out"
    words = ("baselines=[gaussian,median,broken]", "examples=2")
    assert real(str(folder), f"out={out}", *words) == 0
    assert "| noisy |" in capsys.readouterr().out
    content = json.loads((out / "real.json").read_text(encoding="utf-8"))
    rows = {row["label"]: row for row in content["rows"]}
    assert list(rows) == ["noisy", "gaussian", "median", "broken"]
    assert "no such luck" in rows["broken"]["lost"]
    assert rows["gaussian"]["means"]["enl"] > rows["noisy"]["means"]["enl"]
    for label in ("noisy", "gaussian", "median"):
        assert len(rows[label]["pictures"]) == 2
    page = (out / "real.html").read_text(encoding="utf-8")
    assert page.count("data:image/png") == 2 * 3
    assert "lost:" in page
    assert "http" not in page.replace('<html lang="en">', ""), "works without a network"
    assert "| broken" in (out / "real.md").read_text(encoding="utf-8")


def test_bad_input_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "empty").mkdir()
    save(tmp_path / "black" / "0.png", np.zeros((40, 40)))
    save(tmp_path / "plain" / "0.png", np.full((40, 40), 0.5))
    plain = str(tmp_path / "plain")
    for words, told in (
        ((), "real: give pictures or a recording"),
        ((str(tmp_path / "none"),), "no such folder or recording"),
        ((str(tmp_path / "empty"),), "holds no pictures and no recordings"),
        ((str(tmp_path / "black"),), "0.png: black, or smaller than 16 pixels"),
        ((plain, "limit=3"), "limit: Input should be greater than or equal to 4"),
        ((plain, "baselines=[wiener]"), "baselines: no 'wiener'"),
        ((plain, f"models=[{tmp_path / 'none'}]"), "models: "),
    ):
        assert real(*words, f"out={tmp_path / 'out'}") == 2
        error = capsys.readouterr().err
        assert told in error
        assert "Traceback" not in error
