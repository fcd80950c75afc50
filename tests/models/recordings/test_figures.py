"""Pictures in figures: told from axes, text and colour bars, and their fans found."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from simnfnd.models.recordings.fan.finder import find_fan
from simnfnd.models.recordings.fan.page import parts_of_figure
from simnfnd.models.recordings.palettes import find_painted
from tests.models.recordings.fan_pictures import fan, preset
from tests.models.recordings.figure_pictures import Bytes, Drawn, figure, sector, shown

HALF_RAD = 0.5
AXES_PX = 6


def speckle(ranges: int = 300, beams: int = 128, seed: int = 3) -> Bytes:
    """Grey values up to white, with a shadow."""
    rng = np.random.default_rng(seed)
    values = np.clip(rng.rayleigh(60, (ranges, beams)), 0, 255)
    values[ranges // 2 : ranges // 2 + 40, 20:60] = 0
    return values.astype(np.uint8)


def apex(drawn: Drawn) -> tuple[float, float]:
    """Column and row of (0, 0)."""
    x, y = drawn.axes[0].transData.transform((0, 0))
    return float(x), len(drawn.picture) - float(y)


@pytest.mark.parametrize("beams", [16, 48, 256])
@pytest.mark.parametrize(("look", "dpi"), [("default", 100), ("default", 200), ("ggplot", 100)])
def test_a_rectangle_in_axes(look: str, dpi: int, beams: int) -> None:
    drawn = figure([shown(speckle(400, beams))], look=look, dpi=dpi, bar=look == "default")
    (part,) = parts_of_figure(drawn.grey) or ()
    rows, columns = drawn.boxes[0]
    found = (part.rows.start, part.rows.stop, part.columns.start, part.columns.stop)
    wanted = (rows.start, rows.stop, columns.start, columns.stop)
    assert np.abs(np.subtract(found, wanted)).max() <= AXES_PX * dpi / 100
    assert part.inside.mean() > 0.97


def test_several_on_a_page_and_on_a_dark_one() -> None:
    draw = [shown(speckle(seed=seed)) for seed in range(4)]
    for look in ("default", "dark_background"):
        drawn = figure(draw, columns=2, look=look)
        found = parts_of_figure(drawn.grey, dark=True) or ()
        assert len(found) == 4
        for rows, columns in drawn.boxes:
            middle = (rows.start + rows.stop) // 2, (columns.start + columns.stop) // 2
            assert sum(one.alone(np.ones_like(drawn.grey))[middle] for one in found) == 1
    assert parts_of_figure(drawn.grey) is None


def test_figures_without_pictures_and_pictures_without_figures() -> None:
    lines = figure([lambda axes: axes.plot(np.sin(np.arange(90)))])
    grey, _ = fan(preset("didson_hf", 300, 400), 0.3, holes=True)
    for picture in (lines.grey, np.full((200, 200), 255, np.uint8)):
        assert parts_of_figure(picture, dark=True) == ()
    for picture in (speckle(), grey, np.zeros((200, 200), np.uint8)):
        assert parts_of_figure(picture, dark=True) is None


@pytest.mark.parametrize("colours", ["gray", "viridis", "jet", "hot", "copper"])
@pytest.mark.parametrize("polar", [False, True])
def test_a_fan_in_axes(colours: str, polar: bool) -> None:
    drawn = figure([sector(speckle(), HALF_RAD, 0.2, colours)], bar=not polar, polar=polar)
    found = find_fan(drawn.grey if colours == "gray" else drawn.picture[..., ::-1])
    assert found is not None
    geometry = found.geometry
    if not polar:  # polar axes say where they begin in another way
        assert (geometry.apex_x_px, geometry.apex_y_px) == pytest.approx(apex(drawn), abs=3)
    assert geometry.sector_rad == pytest.approx(2 * HALF_RAD, rel=0.06)
    assert geometry.near_fraction == pytest.approx(0.2, abs=0.03)
    # The axes' frame lies over the far arc.
    assert geometry.x_scale == pytest.approx(1, abs=0.06)


def test_a_fan_on_black_in_axes_after_jpeg() -> None:
    grey, true = fan(preset("didson_hf", 300, 400), 0.3, holes=False)

    def draw(axes: object) -> object:
        return axes.imshow(grey, cmap="gray")  # type: ignore[attr-defined]

    drawn = figure([draw])
    _, content = cv2.imencode(".jpg", drawn.grey, [cv2.IMWRITE_JPEG_QUALITY, 90])
    found = find_fan(np.asarray(cv2.imdecode(content, cv2.IMREAD_GRAYSCALE)))
    assert found is not None
    assert found.geometry.sector_rad == pytest.approx(true.sector_rad, rel=0.03)
    scale = (drawn.boxes[0][0].stop - drawn.boxes[0][0].start) / len(grey)
    wanted = drawn.boxes[0][1].start + scale * true.apex_x_px
    assert found.geometry.apex_x_px == pytest.approx(wanted, abs=3)


def test_the_jet_of_matplotlib() -> None:
    drawn = figure([sector(speckle(), HALF_RAD, 0.2, "jet")], bar=True)
    painted = find_painted(drawn.picture)
    assert painted is not None
    assert painted.palette.name == "jet"
    row = (drawn.boxes[0][0].start + drawn.boxes[0][0].stop) // 2
    assert painted.known[row, 300]
    assert not painted.known[5, 5]
