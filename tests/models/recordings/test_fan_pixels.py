"""Pixels in sectors, counted by sums of columns, against a plain test of every point."""

from __future__ import annotations

import numpy as np
import pytest

from simnfnd.factory.common.array_types import Array, Bools
from simnfnd.models.recordings.fans.lit_pixels import LitPixels
from simnfnd.models.recordings.fans.sector import Sector

HEIGHT = 60
WIDTH = 70
FINE = 64  # points in the height of a pixel
SECTORS = {
    "whole": Sector(34.3, 58.2, 55.1, 11.7, -0.51, 0.47, 1.0),
    "beyond the image": Sector(20.6, 80.4, 95.2, 9.3, -1.3, 1.9, 1.0),
    "to one side": Sector(5.2, 66.1, 60.4, 0.0, -0.06, 0.92, 1.0),
    "squeezed": Sector(35.1, 59.6, 41.3, 22.2, -0.8, 0.7, 0.8),
    "above the image": Sector(34.3, -3.2, 50.1, 5.7, -0.5, 0.5, 1.0),
}


def is_inside(sector: Sector, rows: Array, columns: Array) -> Bools:
    """Whether points lie in a sector."""
    across = (columns - sector.apex_x) / sector.squeeze
    ahead = sector.apex_y - rows
    distance = np.hypot(across, ahead)
    in_range = (distance >= sector.near_px) & (distance <= sector.far_px)
    right_of_left = across >= sector.left_tangent * ahead
    left_of_right = across <= sector.right_tangent * ahead
    return np.asarray(in_range & right_of_left & left_of_right & (ahead > 0))


@pytest.mark.parametrize("name", SECTORS)
def test_counts_and_mask_of_a_sector(name: str) -> None:
    sector = SECTORS[name]
    lit = np.random.default_rng(0).random((HEIGHT, WIDTH)) < 0.6
    lit_pixels = LitPixels(lit)
    columns = np.arange(WIDTH)
    inside = is_inside(sector, np.arange(HEIGHT)[:, None], columns)
    fine_rows = (np.arange(HEIGHT * FINE)[:, None] + 0.5) / FINE - 0.5
    parts = is_inside(sector, fine_rows, columns).reshape(HEIGHT, FINE, WIDTH).mean(axis=1)

    np.testing.assert_array_equal(sector.mask(HEIGHT, WIDTH), inside)
    for step in (1, 3):
        some = slice(step // 2, None, step)
        whole = lit_pixels.count_whole([sector], step)
        assert whole == (inside[:, some].sum(), (inside & lit)[:, some].sum())
        fractional = lit_pixels.count_fractional(sector, step)
        # Each column may be wrong by half a point at both ends.
        close = WIDTH / step / FINE
        assert fractional.area == pytest.approx(parts[:, some].sum(), abs=close)
        assert fractional.lit == pytest.approx((parts * lit)[:, some].sum(), abs=close)
