"""The weights that suit a picture of which nothing is known."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import cast

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage

from simnfnd import denoise, make_pair
from simnfnd.factory.dataset.read.pair_dataset import in_unit_range
from simnfnd.models.denoise.command import main
from simnfnd.models.denoise.denoiser import Denoiser, load_denoiser
from simnfnd.models.denoise.weighing import suited
from simnfnd.models.denoise.weighing.points import figures, likelihood
from simnfnd.models.denoise.weighing.suited import Suited
from simnfnd.models.recordings.fan.pings import frame_picture
from tests.project_files import ROOT
from tools.fit_points import Judged, _fit, _line

DATA = ROOT.parent / "shared" / "data"
Gray = npt.NDArray[np.float32]


@lru_cache(maxsize=2)
def picture(experiment: str) -> Gray:
    """A noisy picture of a bumpy bottom, of 8 bits, as a PNG has it."""
    rng = np.random.default_rng(3)
    coarse, fine = (
        ndimage.gaussian_filter(rng.standard_normal((152, 242)), width) for width in (5, 1.5)
    )
    rough = coarse / coarse.std() + 0.1 * fine / fine.std()
    depth = ndimage.zoom(np.linspace(7, 2, 152)[:, None] + 0.3 * rough, 4).astype(np.float32)
    rgb = np.clip(110 + 40 * rng.standard_normal((608, 968, 1)), 0, 255).astype(np.uint8)
    words = (f"experiment={experiment}", "render=analytic")
    pair = make_pair(
        np.repeat(rgb, 3, axis=2), depth, fx=1175, fy=1175, cx=484, cy=304, config=words
    )
    return np.asarray(np.rint(in_unit_range(pair.noisy) * 255) / 255, np.float32)


def test_points_and_speckle_are_told_apart() -> None:
    assert likelihood(picture("simnfnd")) > 0.9
    assert likelihood(picture("physical")) < 0.1


@pytest.mark.parametrize(
    "name", ["didson/lamprey1.avi", "aris-sdk/sample.aris", "oculus/three_pings_8bit.raw"]
)
def test_recordings_are_not_taken_for_points(name: str) -> None:
    if not (DATA / name).exists():
        pytest.skip(f"{name} is not here")
    gray, fan = frame_picture(DATA / name, 0)
    assert likelihood(gray, fan) < 0.02
    assert likelihood(gray) < 0.1


@given(
    height=st.integers(1, 40),
    width=st.integers(1, 40),
    level=st.sampled_from([0.0, 0.5, 1.0]),
    noise=st.sampled_from([0.0, 0.3]),
)
def test_figures_of_any_picture_are_finite(
    height: int, width: int, level: float, noise: float
) -> None:
    rng = np.random.default_rng(0)
    gray = np.clip(level + noise * rng.standard_normal((height, width)), 0, 1).astype(np.float32)
    assert np.isfinite(figures(gray)).all()
    assert 0 <= likelihood(gray) <= 1


def test_pictures_unlike_any_are_not_taken_for_points() -> None:
    rng = np.random.default_rng(0)
    flat = np.full((60, 80), 0.3, np.float32)
    grain = np.clip(0.5 + 0.1 * rng.standard_normal((200, 200)), 0, 1).astype(np.float32)
    assert max(likelihood(one) for one in (flat, 0 * flat, grain)) < 0.1


class _Adds:
    looks = 1

    def __init__(self, value: float) -> None:
        self.value, self.calls = np.float32(value), 0

    def __call__(self, gray: Gray, geometry: object = None, looks: object = ()) -> Gray:
        self.calls += 1
        return gray + self.value


@pytest.mark.parametrize(
    ("part", "added", "calls"),
    [(0.05, 0.1, (1, 0)), (0.95, 0.2, (0, 1)), (0.25, 0.125, (1, 1)), (0.75, 0.175, (1, 1))],
)
def test_one_denoises_or_both_where_in_doubt(
    part: float, added: float, calls: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(suited, "likelihood", lambda *_: part)
    usual, points = _Adds(0.1), _Adds(0.2)
    both = Suited(cast(Denoiser, usual), lambda: cast(Denoiser, points))
    gray = np.zeros((4, 5), np.float32)
    np.testing.assert_allclose(both(gray), added, rtol=1e-6)
    assert (usual.calls, points.calls) == calls
    assert len(list(both.summary())) == (part > 0.5)


def test_pictures_of_points_get_their_weights_without_a_word(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "in").mkdir()
    for name in ("simnfnd", "physical"):
        cv2.imwrite(str(tmp_path / "in" / f"{name}.png"), np.rint(picture(name) * 255))
    assert main([str(tmp_path / "in"), "--out", str(tmp_path / "out")]) == 0
    assert "weights: simnfnd-paper for 1 of 2 pictures" in capsys.readouterr().out
    for name, weights in (("simnfnd", "simnfnd-paper"), ("physical", "simnfnd")):
        words = [str(tmp_path / "in" / f"{name}.png"), "--out", str(tmp_path / weights)]
        assert main([*words, "--weights", weights]) == 0
        assert "simnfnd-paper for" not in capsys.readouterr().out
        chosen, named = (tmp_path / folder / f"{name}.png" for folder in ("out", weights))
        assert chosen.read_bytes() == named.read_bytes()


def test_in_python_the_picture_decides_too() -> None:
    gray = picture("simnfnd")
    by_points = load_denoiser("simnfnd-paper", "cpu")(gray)
    np.testing.assert_array_equal(denoise(gray, device="cpu", geometry=None), by_points)
    assert (
        np.abs(denoise(gray, weights="simnfnd", device="cpu", geometry=None) - by_points).max()
        > 0.05
    )


def test_the_fit_finds_what_decides() -> None:
    rng = np.random.default_rng(1)

    def judged(count: int) -> Judged:
        values = rng.standard_normal((count, 5))
        more = 4 * np.tanh(3 * values[:, 2])
        return Judged(values, np.stack([20 + 0 * more, 25 - more / 2, 25 + more / 2], axis=1))

    judge = _fit(judged(300))
    line = _line(judged(200), judge)
    assert float(line.split(": ")[1].split(" %")[0]) > 90
    assert "200 pictures of places held out" in line
