"""Fans found in images, against the geometry that the images were made with."""

from __future__ import annotations

import csv
import math

import cv2
import numpy as np
import pytest

from simnfnd.factory.common.array_types import Array, UInt8s
from simnfnd.factory.dataset.fan_geometry import FanGeometry
from simnfnd.models.recordings.fan_finder import find_geometry
from simnfnd.models.recordings.palettes import find_painted
from tests.models.recordings.fan_images import LEFT, TOP, fan, preset, screen
from tests.project_files import ROOT

DATA = ROOT.parent / "shared" / "data"
WHITE = (255,)
PRESETS = sorted(path.stem for path in (ROOT / "conf" / "sonar").glob("*.yaml"))


def check(fan: FanGeometry | None, true: FanGeometry) -> None:
    assert fan is not None
    # Where the apex lies far outside, two pixels are less than an edge of whole pixels can tell.
    apex_px = max(2.0, 0.0025 * true.far_px)
    assert fan.apex_x_px == pytest.approx(true.apex_x_px, abs=apex_px)
    assert fan.apex_y_px == pytest.approx(true.apex_y_px, abs=apex_px)
    # A short edge is a staircase of few pixels: most of one at its end turns it by this much.
    length_px = true.far_px - true.near_px
    edge_deg = max(0.3, math.degrees(0.7 / length_px))
    for found_rad, true_rad in (
        (fan.azimuth_min_rad, true.azimuth_min_rad),
        (fan.azimuth_max_rad, true.azimuth_max_rad),
    ):
        assert math.degrees(found_rad) == pytest.approx(math.degrees(true_rad), abs=edge_deg)
    assert fan.x_scale == pytest.approx(true.x_scale, abs=0.01)
    assert fan.near_px == pytest.approx(true.near_px, abs=max(6, 0.02 * true.far_px))
    assert fan.far_px == pytest.approx(true.far_px, abs=apex_px + 0.5)
    assert fan.azimuth_max_rad <= fan.sector_rad / 2 + 1e-9


@pytest.mark.parametrize("name", PRESETS[::4])
def test_fans_of_our_devices(name: str) -> None:
    for near in (0.05, 0.6):
        check(*shown(name, (192, 192), near, holes=False))


@pytest.mark.parametrize("name", PRESETS[::12])
def test_fans_with_dark_patches(name: str) -> None:
    check(*shown(name, (640, 400), 0.3, holes=True))


def shown(
    name: str, size: tuple[int, int], near: float, holes: bool
) -> tuple[FanGeometry | None, FanGeometry]:
    """What is found in a drawn fan, and what it was drawn with."""
    grey, true = fan(preset(name, *size), near, holes)
    return find_geometry(grey), true


@pytest.mark.parametrize("squeeze", [0.7, 1.25])
def test_a_squeezed_fan(squeeze: float) -> None:
    grey, true = fan(preset("aris_explorer_3000", 600, 600), 0.3, False)
    width = round(600 * squeeze)
    narrow = cv2.resize(grey, (width, 600), interpolation=cv2.INTER_NEAREST)
    actual = find_geometry(np.asarray(narrow))
    assert actual is not None
    assert actual.x_scale == pytest.approx(squeeze, rel=0.02)
    assert actual.apex_y_px == pytest.approx(true.apex_y_px, abs=2.5)
    assert actual.apex_x_px == pytest.approx((width - 1) / 2, abs=1)


def test_what_happens_to_images_on_their_way() -> None:
    """JPEG, text, other types, margins and sizes leave the fan where it is."""
    grey, true = fan(preset("didson_hf", 300, 500), 0.2, False)
    check(find_geometry(grey), true)
    check(find_geometry(grey.astype(np.uint16) * 257), true)
    check(find_geometry((grey / 255).astype(np.float32)), true)
    check(find_geometry(np.stack([grey] * 3, axis=-1)), true)
    _, content = cv2.imencode(".jpg", grey, [cv2.IMWRITE_JPEG_QUALITY, 50])
    check(find_geometry(np.asarray(cv2.imdecode(content, cv2.IMREAD_GRAYSCALE))), true)
    text = cv2.copyMakeBorder(grey, 40, 40, 30, 50, cv2.BORDER_CONSTANT)
    cv2.putText(text, "2013-06-14 12:00:01", (3, 14), cv2.FONT_HERSHEY_SIMPLEX, 0.4, WHITE)
    actual = find_geometry(np.asarray(text))
    assert actual is not None
    assert actual.apex_x_px == pytest.approx(true.apex_x_px + 30, abs=2)
    assert actual.apex_y_px == pytest.approx(true.apex_y_px + 40, abs=2)


@pytest.mark.parametrize(
    ("page", "kind"), [(255, "png"), (190, "png"), (255, "jpg"), (190, "framed")]
)
def test_a_fan_on_a_bright_page(page: int, kind: str) -> None:
    grey, geometry = fan(preset("didson_hf", 300, 400), 0.3, holes=False)
    inside = geometry.maps(0, 0, *grey.shape)["sector"] > 0
    shown = grey if kind == "framed" else np.where(inside, grey, page).astype(np.uint8)
    shown = np.pad(shown, 30, constant_values=page)
    if kind == "jpg":
        _, content = cv2.imencode(".jpg", shown, [cv2.IMWRITE_JPEG_QUALITY, 90])
        shown = np.asarray(cv2.imdecode(content, cv2.IMREAD_GRAYSCALE), np.uint8)
    actual = find_geometry(shown)
    assert actual is not None
    assert actual.apex_x_px == pytest.approx(geometry.apex_x_px + 30, abs=2)
    assert actual.sector_rad == pytest.approx(geometry.sector_rad, rel=0.03)
    assert find_geometry(np.full((120, 120), page, np.uint8)) is None


@pytest.mark.parametrize("turns", [1, 2, 3])
@pytest.mark.parametrize("name", ["didson_hf", "oculus_m1200d_hf"])
def test_fans_whose_far_range_is_not_on_top(name: str, turns: int) -> None:
    grey, true = fan(preset(name, 300, 400), 0.3, holes=False)
    actual = find_geometry(np.rot90(grey, -turns))
    assert actual is not None
    assert actual.quarter_turns == turns
    turned = actual.turned(*np.rot90(grey, -turns).shape)
    check(turned, true)


@pytest.mark.parametrize("turns", [1, 2, 3])
def test_masks_of_objects_are_no_fans_however_they_lie(turns: int) -> None:
    grey, _ = fan(preset("didson_hf", 300, 400), 0.3, holes=False)
    spot = np.zeros((200, 200), np.uint8)
    spot[50:90, 60:110] = np.rot90(grey, turns)[:40, :50]
    of_spot = find_geometry(spot)
    assert of_spot is None or of_spot.quarter_turns == 0


@pytest.mark.parametrize(
    ("ground", "turns"),
    [((0, 0, 0), 0), ((80, 30, 10), 0), ((240, 240, 240), 0), ((80, 30, 10), 1)],
)
def test_a_fan_on_a_screen(ground: tuple[int, int, int], turns: int) -> None:
    grey, true = fan(preset("didson_hf", 300, 400), 0.3, holes=False)
    shown = screen(grey, true.sector_mask(*grey.shape), ground)
    if turns:
        fans = np.rot90(grey, -turns)
        shown = screen(fans, true.turned_back(turns, *fans.shape).sector_mask(*fans.shape), ground)
    actual = find_geometry(shown)
    assert actual is not None
    upright = actual.turned(*shown.shape[:2])
    assert upright.sector_rad == pytest.approx(true.sector_rad, rel=0.03)
    # A bright page is taken a pixel wider, as JPEG rings there: a narrow fan's apex moves by six.
    close = 4 if max(ground) < 200 else 7
    assert upright.far_px == pytest.approx(true.far_px, abs=close)
    assert actual.quarter_turns == turns
    if not turns:
        assert upright.apex_x_px == pytest.approx(true.apex_x_px + LEFT, abs=2)
        assert upright.apex_y_px == pytest.approx(true.apex_y_px + TOP, abs=close)


@pytest.mark.slow
@pytest.mark.skipif(not (DATA / "screens").is_dir(), reason="no shared data")
def test_fans_between_drawn_lines_of_chart_plotters() -> None:
    """Half of the fan is dark, and its range ring and edges are white lines."""
    path = min((DATA / "screens").glob("*_mask_template.png"))
    image = np.asarray(cv2.imread(str(path)))
    painted = find_painted(image)
    assert painted is not None
    assert painted.palette.name == "red"
    for shown in (image, painted.levels):
        fan = find_geometry(shown)
        assert fan is not None
        assert (fan.apex_x_px, fan.apex_y_px) == pytest.approx((960, 995), abs=10)
        assert fan.far_px == pytest.approx(fan.apex_y_px, abs=5)
        assert math.degrees(fan.sector_rad) == pytest.approx(150.3, abs=1)


def no_fans() -> dict[str, Array]:
    rng = np.random.default_rng(0)
    size = (180, 240)
    noise = rng.rayleigh(60, size).clip(1, 255).astype(np.uint8)
    images: dict[str, UInt8s] = {
        "noise": noise,
        "nothing": np.zeros(size, np.uint8),
        "one pixel": np.zeros(size, np.uint8),
        "tiny": noise[:20, :20],
        "a row": noise[:1],
    }
    images["one pixel"][60, 60] = 255
    for name in ("letterbox", "disc", "triangle", "polar", "specks"):
        images[name] = np.zeros(size, np.uint8)
    images["letterbox"][30:150, 36:204] = noise[30:150, 36:204]
    cv2.circle(images["disc"], (120, 90), 72, WHITE, -1)
    images["ellipse"] = np.zeros((300, 400), np.uint8)  # smaller, it is within a pixel of a fan
    cv2.ellipse(images["ellipse"], (200, 150), (160, 90), 0, 0, 360, WHITE, -1)
    corners = np.array([(30, 30), (210, 30), (120, 90)])
    cv2.fillPoly(images["triangle"], [corners], WHITE)
    images["polar"][48:] = noise[48:]
    images["specks"][rng.random(size) < 0.01] = 200
    return images


def test_images_without_a_fan() -> None:
    for name, image in no_fans().items():
        assert find_geometry(image) is None, name
        assert find_geometry(255 - np.rot90(image)) is None, (name, "turned negative")


@pytest.mark.skipif(not (DATA / "mdd").is_dir(), reason="no shared data")
def test_mdd() -> None:
    with (DATA / "mdd" / "fan_geometry.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 117
    for row in rows[::30]:
        image = cv2.imread(str(DATA / "mdd" / "Images" / row["file"]), cv2.IMREAD_UNCHANGED)
        fan = find_geometry(np.asarray(image))
        assert fan is not None
        assert fan.apex_x_px == pytest.approx(float(row["apex_x"]), abs=2)
        assert fan.apex_y_px == pytest.approx(float(row["apex_y"]), abs=2)
        squeeze = {"A": 1.0, "B": 0.8}[row["config"]]
        assert fan.x_scale == pytest.approx(squeeze, abs=0.01)
        half_deg = math.degrees(math.atan(float(row["edge_slope"]) / squeeze))
        for edge_rad in (-fan.azimuth_min_rad, fan.azimuth_max_rad):
            assert math.degrees(edge_rad) == pytest.approx(half_deg, abs=0.3)
