"""The compiled loops of the complex field against plain numpy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from simnfnd.factory.imaging.coherent.beams import vertical_table
from simnfnd.factory.imaging.coherent.scatterers import beam_table, scatterers
from simnfnd.factory.pairs import fitted_window
from simnfnd.factory.sonar.window import conical
from tests.constant_field import config
from tests.frames import ground_and_post, plain_render


@pytest.mark.parametrize("range_bins", [48, 300])
def test_scatterers_lie_where_their_pixels_do(range_bins):
    """Bins, powers and sums of a ground, most of whose pixels cover a bin or, with 300, several."""
    automatic = {"auto": True, "min_m": 0.2, "max_m": 12.0}
    made = config(sonar={"hfov_deg": 40, "range_bins": range_bins, "range": automatic})
    frame = ground_and_post()
    labels = (np.arange(frame.depth_m.size) % 3).astype(np.uint8).reshape(frame.depth_m.shape)
    frame, rendered = replace(frame, segmentation=labels), plain_render(frame)
    acoustics = replace(made.acoustics, reflectivity_db={"Background": -20.0})
    sonar = made.sonar
    window = conical(fitted_window(frame, rendered, made), sonar)
    found = scatterers(frame, rendered, window, sonar, made.water, acoustics)

    camera, depth_m = frame.intrinsics, frame.depth_m.astype(np.float64)
    v, u = np.indices(depth_m.shape)
    across, down = (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy
    range_m = depth_m * np.sqrt(1 + across**2 + down**2)
    bearing = across * depth_m / np.maximum(range_m, 1e-9)
    start = (range_m - window.range_min_m) * range_bins / window.range_span_m
    row, column = np.divmod(found.pixels, depth_m.shape[1])
    below = np.minimum(row + 1, depth_m.shape[0] - 1)
    begins = start[row, column]
    # Where the next row is another surface the pixel lies at one range: the loop says so.
    ends = np.where(found.parts > 0, start[below, column], begins)
    at = begins + found.parts * (ends - begins)
    edges, _ = beam_table(sonar)
    beam = np.searchsorted(edges, bearing[row, column], side="right") - 1
    # What lies on the border of two bins may be rounded into either.
    clear = np.abs(at - np.rint(at)) > 1e-3
    clear &= np.abs(bearing[row, column][:, None] - edges).min(axis=1) > 1e-6
    assert clear.mean() > 0.9
    expected = np.floor(at).astype(int) * sonar.beams + beam
    np.testing.assert_array_equal(found.bins[clear], expected[clear])

    sine = -down * depth_m / np.maximum(range_m, 1e-9)
    table = vertical_table(sonar)
    pattern = np.interp(sine, np.linspace(-1, 1, len(table)), table)
    solid = (1 + across**2 + down**2) ** -1.5 / (camera.fx * camera.fy)
    value = rendered.radiance * solid * pattern * 0.01
    share = np.bincount(found.pixels)[found.pixels]
    inside = (begins > 1) & (ends > 1) & (np.maximum(begins, ends) < range_bins - 1)
    np.testing.assert_allclose(
        found.powers[inside], (value[row, column] / share)[inside], rtol=2e-4, atol=1e-14
    )
    # Sums of the scatterers and the exact parts of a pixel are the same echo, but where it lies.
    summed = found.power / found.loss[:, None]
    assert summed.sum() == pytest.approx(float(found.powers.sum()), rel=0.02)
    owned = found.owner[found.owner >= 0]
    assert (rendered.radiance.reshape(-1)[owned] > 0).all()
