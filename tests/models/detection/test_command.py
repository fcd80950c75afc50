"""`simnfnd detect`: every input, damaged files, results for other programs, resuming."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from pycocotools.coco import COCO

import simnfnd
from simnfnd.command import main
from simnfnd.factory.dataset.fan_geometry import FanGeometry
from simnfnd.models.detection.objects import place_of

HEIGHT, WIDTH = 240, 160


def ring(middle: tuple[int, int] = (90, 130), radius: int = 24) -> np.ndarray:
    """A fan with speckle and a tyre: a bright ring, (H, W) uint8."""
    rng = np.random.default_rng(0)
    row, column = np.mgrid[:HEIGHT, :WIDTH]
    grey = rng.rayleigh(0.12, (HEIGHT, WIDTH))
    distance = np.hypot(column - middle[0], row - middle[1])
    grey += 0.6 * (np.abs(distance - radius) < 4) * rng.rayleigh(0.8, (HEIGHT, WIDTH))
    across = np.arctan2(column - WIDTH / 2, HEIGHT + 40 - row)
    is_fan = np.abs(across) < 0.26
    return np.asarray(np.rint(255 * np.clip(grey, 0, 1) * is_fan), np.uint8)


def table(out: Path) -> list[dict[str, str]]:
    with (out / "detections.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def run(*words: object) -> int:
    return main(["detect", *map(str, words), "--threshold", "0.1"])


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Images of many kinds, an empty one and a damaged one."""
    place = tmp_path / "in"
    (place / "deep").mkdir(parents=True)
    image = ring()
    cv2.imwrite(str(place / "plain.png"), image)
    cv2.imwrite(str(place / "deep" / "bits10.png"), image.astype(np.uint16) * 4)
    cv2.imwrite(str(place / "alpha.png"), cv2.cvtColor(image, cv2.COLOR_GRAY2BGRA))
    cv2.imwrite(str(place / "black.png"), np.zeros((HEIGHT, WIDTH), np.uint8))
    (place / "cut.png").write_bytes((place / "plain.png").read_bytes()[:500])
    return place


def test_a_folder_with_a_damaged_and_an_empty_image(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert run(folder, "--out", out, "--overlay") == 1
    said = capsys.readouterr()
    assert said.err.count("skipped:") == 1
    assert "cut.png" in said.err
    rows = table(out)
    by_file = {row["file"]: row for row in reversed(rows)}
    assert set(by_file) == {"alpha.png", "deep/bits10.png", "plain.png"}
    for row in by_file.values():  # of 10 bits in 16 and with alpha the same box
        np.testing.assert_allclose(
            [float(row[key]) for key in ("left", "top", "width", "height")],
            [float(by_file["plain.png"][key]) for key in ("left", "top", "width", "height")],
            atol=3,
        )
    assert (
        abs(float(by_file["plain.png"]["left"]) + float(by_file["plain.png"]["width"]) / 2 - 90)
        < 12
    )
    assert (out / "overlay/deep/bits10.png.png").is_file()

    truth = COCO(str(out / "detections.json"))
    assert len(truth.imgs) == 4
    results = json.loads((out / "results.json").read_text())
    assert len(truth.loadRes(results).anns) == len(rows) == len(truth.anns)


def test_what_is_finished_is_not_done_again(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    (folder / "cut.png").unlink()
    assert run(folder, "--out", out) == 0
    first = (out / "detections.json").read_bytes()
    capsys.readouterr()
    cv2.imwrite(str(folder / "plain.png"), ring(radius=26))
    assert run(folder, "--out", out) == 0
    assert "already looked into: 3 file(s)" in capsys.readouterr().out
    assert (out / "detections.json").read_bytes() != first


def test_a_video_has_rows_by_frame(tmp_path: Path) -> None:
    path = tmp_path / "swim.avi"
    size = (WIDTH, HEIGHT)
    video = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 5, size)
    for shift in (0, 6):
        video.write(cv2.cvtColor(ring((90 - shift, 130)), cv2.COLOR_GRAY2BGR))
    video.release()
    out = tmp_path / "out"
    assert run(path, "--out", out, "--overlay", "--geometry", "none") == 0
    images = json.loads((out / "detections.json").read_text())["images"]
    assert [image["file_name"] for image in images] == [f"swim.avi/{n:06d}.png" for n in (0, 1)]
    assert [image["time_s"] for image in images] == pytest.approx([0, 0.2])
    assert {row["frame"] for row in table(out)} == {"0", "1"}
    assert (out / "overlay/swim.avi.mp4").stat().st_size > 1000


@pytest.mark.parametrize(
    ("words", "part"),
    [
        (["--threshold", "2"], "--threshold"),
        (["--classes", "Submarine"], "--classes Submarine"),
        (["--detector", "nowhere"], "detector=nowhere"),
    ],
)
def test_wrong_options_cost_one_line(
    words: list[str], part: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), ring())
    assert main(["detect", str(tmp_path / "a.png"), "--out", str(tmp_path / "o"), *words]) == 2
    said = capsys.readouterr().err
    assert part in said
    assert said.count("\n") == 1


def test_torch_is_not_needed(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), ring())
    program = (
        "import sys; sys.modules['torch'] = None\n"
        "from simnfnd.command import main\n"
        "assert main(['detect', 'a.png', '--out', 'o']) == 0"
    )
    subprocess.run([sys.executable, "-c", program], check=True, cwd=tmp_path)


def test_api_finds_what_the_command_finds_with_ranges() -> None:
    image = ring()
    geometry = FanGeometry.fan(
        0.52, apex_x_px=WIDTH / 2, apex_y_px=HEIGHT + 40.0, near_px=40.0, far_px=280.0,
        range_min_m=0.5, range_max_m=3.5,
    )  # fmt: skip
    found = simnfnd.detect(image, threshold=0.1, geometry=geometry)
    best = found[0]
    assert best.slant_range_m == pytest.approx(150 / 280 * 3.5, abs=0.15)
    assert best.bearing_deg == pytest.approx(np.rad2deg(np.arctan2(10, 150)), abs=3)
    assert best.size_m == pytest.approx(56 / 280 * 3.5, abs=0.2)
    only = simnfnd.detect(image, threshold=0.1, classes=["Valve"], geometry=None)
    assert {item.class_name for item in only} <= {"Valve"}

    # An image that lies on its side has the same objects, in its own pixels.
    turned = geometry.turned_back(1, WIDTH, HEIGHT)
    lying = np.ascontiguousarray(np.rot90(image, -1))
    (other, *_) = simnfnd.detect(lying, threshold=0.1, geometry=turned)
    assert other.slant_range_m == pytest.approx(best.slant_range_m, abs=0.01)
    assert (other.top, other.bottom) == pytest.approx((best.left, best.right), abs=0.5)


def test_places_of_polar_images_and_fans_agree() -> None:
    polar = FanGeometry.polar(0.6, 1.0, 5.0).with_size(400, 96)
    place = place_of(polar, 48, 200)
    assert place.slant_range_m == pytest.approx(3.0)
    assert place.bearing_deg == pytest.approx(0, abs=0.01)


def test_a_live_detector_refuses_frames_after_its_end() -> None:
    with simnfnd.Detector(geometry=None) as find:
        assert find(np.zeros((60, 40), np.uint8)) == []
        odd: Any = np.zeros((60, 40), np.int64)
        with pytest.raises(ValueError, match="int64"):
            find(odd)
    with pytest.raises(ValueError, match="closed"):
        find(np.zeros((60, 40), np.uint8))
