"""What a render is asked for: albedo, settings, and libraries that are missing."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from simnfnd.factory.errors import FactoryError
from simnfnd.factory.render import RenderSettings, open_renderer
from simnfnd.factory.render.surface import albedo, linear_luminance
from simnfnd.factory.settings import build

# ---- albedo ----


def test_albedo_rgb_is_linear_luminance() -> None:
    rgb = np.array([[[255, 255, 255], [128, 128, 128], [255, 0, 0], [0, 0, 0]]], np.uint8)
    np.testing.assert_allclose(
        linear_luminance(rgb)[0], [1, 0.2158605, 0.2126, 0], rtol=1e-5, atol=1e-7
    )
    found = albedo(rgb, np.array([[True, True, False, True]]), "rgb")
    np.testing.assert_allclose(found[0], [1, 0.2158605, 0, 0.01], rtol=1e-5)


def test_flattened_albedo_forgets_light_and_keeps_texture() -> None:
    rng = np.random.default_rng(0)
    texture = rng.uniform(0.5, 1.5, (200, 300))
    haze = np.linspace(0.02, 0.5, 300)[None, :] * np.linspace(1, 0.4, 200)[:, None]

    def picture(linear: npt.NDArray[np.float64]) -> npt.NDArray[np.uint8]:
        code = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
        grey: npt.NDArray[np.uint8] = np.round(255 * code).astype(np.uint8)
        return np.repeat(grey[..., None], 3, axis=-1)

    valid = np.ones((200, 300), np.bool_)
    flat = albedo(picture(texture * haze), valid, "flattened")
    assert flat.mean() == pytest.approx(0.5, abs=0.02)
    assert flat.min() >= 0.1
    assert flat.max() <= 1
    assert np.corrcoef(flat.ravel(), texture.ravel())[0, 1] > 0.97
    thirds = [part.mean() for part in np.array_split(flat, 3, axis=1)]
    assert max(thirds) - min(thirds) < 0.03


def test_flattened_albedo_ignores_unmeasured_pixels() -> None:
    rgb = np.full((120, 160, 3), 90, np.uint8)
    valid = np.ones((120, 160), np.bool_)
    valid[:, 80:] = False
    bright = rgb.copy()
    bright[:, 80:] = 255
    found = albedo(bright, valid, "flattened")
    np.testing.assert_allclose(found[:, :80], 0.5, rtol=1e-4)
    np.testing.assert_array_equal(found[:, 80:], 0)
    np.testing.assert_array_equal(albedo(rgb, valid, "constant"), np.where(valid, 0.5, 0))


# ---- settings and missing libraries ----


def test_points_are_for_cycles_only() -> None:
    with pytest.raises(FactoryError, match=r"render\.geometry=points.*render\.geometry=auto"):
        open_renderer(build(RenderSettings, {"kind": "embree", "geometry": "points"}))
