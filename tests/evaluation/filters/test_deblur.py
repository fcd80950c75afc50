"""Deconvolution along range, across a fan too."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from scipy import ndimage

from simnfnd.evaluation.filters import REGISTRY
from simnfnd.evaluation.methods import Method
from simnfnd.evaluation.pairs import Pair as Pair_
from simnfnd.evaluation.pairs import geometry_of, items_of, picture
from simnfnd.evaluation.runner import denoised
from simnfnd.factory.dataset.format.schema import Axis, Column, Pair, Provenance
from simnfnd.factory.dataset.format.settings import DatasetSettings
from simnfnd.factory.dataset.write.writer import write_shard
from simnfnd.factory.sonar.fan import fan_table, pixel_size
from simnfnd.factory.sonar.geometry import FanGeometry
from simnfnd.factory.sonar.settings import ImageSettings, SonarSettings

Array = npt.NDArray[Any]


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
