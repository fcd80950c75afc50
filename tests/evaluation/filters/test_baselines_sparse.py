"""Complex wavelets, sparse codes and the geometry of a fan: baselines with a theory to keep to."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from simnfnd.evaluation.filters import REGISTRY
from simnfnd.evaluation.filters.bm3d import _all_blocks
from simnfnd.evaluation.filters.literature import dual_tree as dualtree
from simnfnd.evaluation.filters.literature.convolutional import atoms, coded, reconstructed
from simnfnd.evaluation.filters.literature.dtcwt_map import _map
from simnfnd.evaluation.filters.literature.structural import noise_map
from simnfnd.evaluation.methods.method import Method
from simnfnd.evaluation.metrics.fidelity import psnr
from simnfnd.evaluation.pairs import Pair as Pair_
from simnfnd.evaluation.pairs import geometry_of, items_of, picture
from simnfnd.evaluation.runner import denoised
from simnfnd.factory.dataset.format.schema import Axis, Column, Pair, Provenance
from simnfnd.factory.dataset.format.settings import DatasetSettings
from simnfnd.factory.dataset.write.writer import write_shard
from simnfnd.factory.sonar.fan import fan_table, pixel_size
from simnfnd.factory.sonar.geometry import FanGeometry
from simnfnd.factory.sonar.settings import ImageSettings, SonarSettings
from tests.evaluation.filters.scenes import noisy_scene, run, scene

Array = npt.NDArray[Any]


@settings(max_examples=10, deadline=None)
@given(
    rows=st.integers(1, 4),
    columns=st.integers(1, 4),
    levels=st.integers(1, 4),
    seed=st.integers(0, 2**32 - 1),
)
def test_dual_tree_is_a_tight_frame(rows: int, columns: int, levels: int, seed: int) -> None:
    shape = (rows * 2**levels, columns * 2**levels)
    image = np.random.default_rng(seed).random(shape, dtype=np.float32)
    found = dualtree.forward(image, levels)
    np.testing.assert_allclose(dualtree.inverse(found), image, atol=2e-6)
    power = sum(float((np.abs(band) ** 2).sum()) for band in found.bands)
    power += float((found.lows**2).sum())
    assert power == pytest.approx(float((image**2).sum()), rel=1e-5)


def wavelet_of(tree: int, level: int, size: int = 256) -> Array:
    """(size,) the wavelet of a tree at a level, by the way back from one coefficient."""
    one = np.zeros((size >> level, 1), np.float32)
    one[one.size // 2] = 1
    for number in reversed(range(level)):
        low, high = dualtree.filters(number, tree)
        one = dualtree._synthesised(one, high if number == level - 1 else low, 0)
    return one[:, 0]


@pytest.mark.parametrize("level", [2, 3, 4, 5])
def test_wavelets_of_both_trees_are_a_hilbert_pair(level: int) -> None:
    """Together they have no negative frequencies; a tree alone has half of its power there."""
    pair = wavelet_of(0, level) + 1j * wavelet_of(1, level)
    power = np.abs(np.fft.fft(pair)) ** 2
    assert power[129:].sum() < 0.01 * power.sum()


def test_dual_tree_hardly_feels_a_shift_and_tells_directions() -> None:
    y, x = np.mgrid[0:128, 0:128]
    step = ((x - 64) ** 2 + (y - 64) ** 2 < 30**2).astype(np.float32)
    moved = [np.roll(step, n, (0, 1)) for n in range(8)]

    def unsteady(levels_of: Any) -> Array:
        power = np.array([[float((np.abs(b) ** 2).sum()) for b in levels_of(m)] for m in moved])
        return np.asarray(power.std(axis=0) / power.mean(axis=0))

    complex_bands = unsteady(lambda image: dualtree.forward(image, 4).bands)
    real_bands = unsteady(lambda image: dualtree._forward(image, 4, 0, 0)[0])
    assert complex_bands.max() < 0.05
    assert (real_bands[1:] > 2.5 * complex_bands[1:]).all()
    # Waves of six directions are strongest in one band each; real wavelets mix +45 and -45.
    strongest = []
    for degrees in (20, 45, 70, 110, 135, 160):
        turn = np.deg2rad(degrees)
        wave = np.cos(0.375 * np.pi * (x * np.cos(turn) + y * np.sin(turn))).astype(np.float32)
        power = (np.abs(dualtree.forward(wave, 2).bands[1]) ** 2).sum(axis=(1, 2))
        strongest.append(int(power.argmax()))
    assert sorted(strongest) == list(range(6))


def test_map_shrinkage_is_its_formula() -> None:
    rng = np.random.default_rng(3)
    band, parent = (
        (rng.normal(size=shape) + 1j * rng.normal(size=shape)).astype(np.complex64)
        for shape in ((6, 16, 16), (6, 8, 8))
    )
    result, noise = _map(band, parent, 0.6), 0.6
    for number, row, column in ((0, 7, 9), (4, 8, 8), (5, 12, 3)):
        around = band[number, row - 3 : row + 4, column - 3 : column + 4]
        sigma = np.sqrt((np.abs(around) ** 2).mean() / 2 - noise**2)
        y, above = band[number, row, column], parent[number, row // 2, column // 2]
        length = np.sqrt(abs(y) ** 2 + abs(above) ** 2)
        kept = max(length - np.sqrt(3) * noise**2 / sigma, 0) / length
        assert result[number, row, column] == pytest.approx(kept * y, abs=1e-5)


def test_dtcwt_map_keeps_the_mean_and_leaves_a_noiseless_picture() -> None:
    noisy = noisy_scene("speckle", 61)
    assert run("dtcwt_map", noisy, strength=0.5).mean() == pytest.approx(noisy.mean(), rel=1e-2)
    np.testing.assert_allclose(run("dtcwt_map", noisy, strength=0.0), noisy, atol=0.005)
    speckle = np.random.default_rng(0).gamma(12, 1 / 12, (128, 128))
    speckled = np.where(scene(128) > 0, 0.5, 0) * speckle
    smooth = run("dtcwt_map", speckled.astype(np.float32))
    even = np.s_[8:24, 8:56]
    assert smooth[even].std() < 0.25 * speckled[even].std()


def test_convolutional_code_is_the_minimum() -> None:
    """The conditions of the minimum: correlations of what is left are +-strength where a map is
    not 0, and no larger anywhere."""
    values, strength = noisy_scene("white", 40) - np.float32(0.5), 0.1
    worst = []
    for iterations in (20, 100, 500):
        maps = coded(values, strength, iterations)
        left = values - reconstructed(maps)
        turned = np.conj(np.fft.fft2(atoms(), s=left.shape))
        correlation = np.fft.ifft2(np.fft.fft2(left) * turned).real
        wanted = np.where(maps != 0, strength * np.sign(maps), 0)
        excess = np.where(maps != 0, correlation - wanted, np.abs(correlation) - strength)
        worst.append(np.where(maps != 0, np.abs(excess), excess).max())
        assert 0.005 < (maps != 0).mean() < 0.2, "sparse"
    assert worst == sorted(worst, reverse=True)
    assert worst[-1] < 0.1 * strength
    # The sum of the maps with their atoms, pixel by pixel.
    direct = sum(
        ndimage.convolve(np.roll(m, (2, 2), (0, 1)), a, mode="wrap")
        for m, a in zip(maps, atoms(), strict=True)
    )
    np.testing.assert_allclose(reconstructed(maps), direct, atol=1e-5)


def test_a_code_without_price_is_the_picture() -> None:
    image = noisy_scene("speckle", 50)
    np.testing.assert_allclose(
        run("convolutional", image, strength=1e-4, iterations=300), image, atol=0.02
    )


def test_structural_sees_noise_that_is_not_everywhere_the_same() -> None:
    rng = np.random.default_rng(0)
    sigma = np.where(np.arange(128) < 64, 0.03, 0.12)[None] * np.ones((128, 1))
    flat = (0.5 + sigma * rng.normal(size=sigma.shape)).astype(np.float32)
    seen = noise_map(_all_blocks(flat))
    assert seen[:, :40].mean() == pytest.approx(0.03, rel=0.1)
    assert seen[:, -40:].mean() == pytest.approx(0.12, rel=0.1)
    # BM3D knows one level for the whole picture: whichever it is told, it is wrong somewhere.
    clean = scene(96)
    ramp = np.linspace(0.02, 0.25, 96)[None] * rng.normal(size=clean.shape)
    noisy = np.clip(clean + ramp, 0, 1).astype(np.float32)
    ours = psnr(clean, run("structural", noisy), data_range=1)
    others = [psnr(clean, run("bm3d", noisy, sigma=s), data_range=1) for s in (0.1, 0.15, 0.2)]
    assert ours > max(others) + 0.5


def test_structural_leaves_a_noiseless_picture() -> None:
    image = noisy_scene("white", 41)
    np.testing.assert_allclose(run("structural", image, strength=1e-4), image, atol=2e-3)


def blurred_fan(sigma_px: float) -> tuple[SonarSettings, float, Array, Array]:
    """(sonar, near fraction, sharp fan, the same blurred along range) of points in a wide sector.

    sigma_px: of the blur, in pixels of the fan.
    """
    sonar = SonarSettings(
        hfov_deg=110, beams=400, range_bins=400, image=ImageSettings(width_px=240, height_px=150)
    )
    near = 0.2
    polar = np.full((400, 400), 0.15, np.float32)
    for row in range(60, 380, 60):
        for beam in range(20, 380, 60):
            polar[row : row + 16, beam : beam + 12] = 0.9
    bins_a_pixel = pixel_size(sonar, near) / ((1 - near) / 400)
    soft = ndimage.gaussian_filter1d(polar, sigma_px * bins_a_pixel, axis=0, mode="nearest")
    table = fan_table(sonar, near)
    return sonar, near, table.bilinear(polar), table.bilinear(soft)


def test_richardson_lucy_follows_range_across_a_fan() -> None:
    sonar, near, sharp, soft = blurred_fan(2.0)
    baseline = REGISTRY["richardson_lucy"]
    parameters = {"sigma_px": 2.0, "iterations": 10}
    along = baseline(soft, parameters, FanGeometry.from_sonar(sonar, near, 1.0))
    down = baseline(soft, parameters)
    before, after, columns = (np.abs(one - sharp).mean() for one in (soft, along, down))
    assert after < 0.7 * before
    assert columns > before, "range is not down the columns: there it does harm"
    # Nothing outside of the sector, and nothing lost by the way there and back.
    assert not along[~fan_table(sonar, near).inside].any()
    same = baseline(
        soft, {"sigma_px": 0.01, "iterations": 1}, FanGeometry.from_sonar(sonar, near, 1.0)
    )
    np.testing.assert_allclose(same, soft, atol=1e-5)
    polar = FanGeometry("polar", near, 2, -1, 1, range_bins=150)
    np.testing.assert_array_equal(baseline(soft, parameters, polar), down)


def test_the_report_tells_methods_where_range_is(tmp_path: Path) -> None:
    sonar, near, sharp, soft = blurred_fan(2.0)
    names = ("range_min_m", "range_max_m", "azimuth_min_deg", "azimuth_max_deg")
    columns = [Column(name, "S8") for name in ("location", "scene", "frame")]
    columns += [Column("variant", "i4"), *(Column(name, "f8") for name in names)]
    record: dict[str, float | int | str] = {
        "location": "a",
        "scene": "b",
        "frame": "c",
        "variant": 0,
    }
    record |= dict(zip(names, (2 * near, 2.0, -55.0, 55.0), strict=True))
    pair = Pair(soft, sharp, np.zeros(soft.shape, bool), record)
    axes = tuple(
        Axis(name, "px", np.arange(count, dtype=float))
        for name, count in zip(("row", "column"), soft.shape, strict=True)
    )
    provenance = Provenance({"sonar": asdict(sonar)}, "0123abcd", "tests")
    write_shard(
        tmp_path,
        "test/shard-00000.h5",
        [pair],
        (axes[0], axes[1]),
        tuple(columns),
        provenance,
        DatasetSettings(dtype="float32"),
    )
    (item,) = items_of(tmp_path, "test")
    known = geometry_of(item.place)
    assert known is not None
    assert known.far_px == pytest.approx(FanGeometry.from_sonar(sonar, near, 1.0).far_px)
    method = Method("richardson_lucy", "", {"sigma_px": 2.0, "iterations": 30})
    noisy = picture(item.place).noisy
    baseline = REGISTRY["richardson_lucy"]
    shown, _ = denoised(method, Pair_(item, 0.02, texture=False), "cpu")
    assert shown is not None
    np.testing.assert_array_equal(shown, baseline(noisy, method.parameters, known))
    unknown = baseline(noisy, method.parameters)
    assert np.abs(shown - unknown).max() > 0.05


def test_a_methods_program_holds_what_it_is_made_of() -> None:
    """What was measured is measured again when a part of the method in another file changes."""
    assert "def forward(" in REGISTRY["dtcwt_map"].program()
    assert "def _alike(" in REGISTRY["structural"].program()
    assert "def forward(" not in REGISTRY["median"].program()
