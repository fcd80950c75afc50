"""`simnfnd detect --count`: tracks, directions, lengths, and the files that programs read."""

from __future__ import annotations

import csv
from pathlib import Path

import cv2
import numpy as np
import pytest

from simnfnd.command import main
from simnfnd.evaluation.counts.scores import TrackedFrame, count_error, score_tracks
from simnfnd.factory.dataset.fan_geometry import FanGeometry
from simnfnd.models.detection.counting import counts_of, rows_of
from simnfnd.models.detection.frames import ShownFrame
from simnfnd.models.detection.moving import deviations_of
from simnfnd.models.detection.tracker import track_echoes

HEIGHT, WIDTH = 240, 160
FRAMES = 40
GEOMETRY = FanGeometry.fan(
    0.7, apex_x_px=WIDTH / 2 - 0.5, apex_y_px=HEIGHT + 19.5, near_px=20.0, far_px=260.0,
    range_min_m=0.4, range_max_m=5.2,
)  # fmt: skip


def swimming(gap: range = range(0)) -> list[np.ndarray]:
    """Speckle and two fish, one to the right and one to the left; one is hidden for some frames."""
    rng = np.random.default_rng(0)
    background = rng.uniform(40, 70, (HEIGHT, WIDTH))
    images = []
    for number in range(FRAMES):
        image = background + rng.normal(0, 4, (HEIGHT, WIDTH))
        if number not in gap:
            cv2.ellipse(image, (50 + 2 * number, 90), (10, 3), 0, 0, 360, (200.0,), -1)
        cv2.ellipse(image, (110 - 2 * number, 170), (8, 3), 0, 0, 360, (190.0,), -1)
        images.append(np.clip(image, 0, 255).astype(np.uint8))
    return images


def frames(images: list[np.ndarray]) -> list[ShownFrame]:
    return [ShownFrame(n, image, GEOMETRY, n / 10) for n, image in enumerate(images)]


@pytest.mark.parametrize("gap", [range(0), range(15, 28)])
def test_two_fish_are_two_tracks_also_after_a_gap(gap: range) -> None:
    rows = rows_of("swim", track_echoes(deviations_of(frames(swimming(gap)))))
    assert counts_of(rows) == {"right": 1, "left": 1}
    scale_m = 5.2 / 260
    for row in rows:
        assert row.speed_m_s == pytest.approx(20 * scale_m, rel=0.15)
        assert row.length_m == pytest.approx({"right": 20, "left": 16}[row.direction] * scale_m,
                                             abs=0.09)  # fmt: skip
        assert row.frames > 20
    right = next(row for row in rows if row.direction == "right")
    assert right.first_time_s == pytest.approx(0, abs=0.3)
    assert right.last_time_s == pytest.approx(3.9, abs=0.3)


def test_a_video_is_counted_into_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "swim.avi"
    video = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 10, (WIDTH, HEIGHT))
    for image in swimming():
        video.write(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR))
    video.release()
    out = tmp_path / "out"
    words = ["detect", str(path), "--count", "--out", str(out), "--overlay", "--geometry", "none"]
    assert main(words) == 0
    assert "2 moving object(s): 1 to the left, 1 to the right" in capsys.readouterr().out
    with (out / "swim.avi/tracks.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["direction"] for row in rows} == {"left", "right"}
    assert all(row["length_m"] == "" and row["class"] == "object" for row in rows)
    mot = np.loadtxt(out / "swim.avi/mot.txt", delimiter=",")
    assert mot.shape[1] == 10
    assert 1 <= mot[:, 0].min() <= mot[:, 0].max() <= FRAMES
    echogram = cv2.imread(str(out / "swim.avi/echogram.png"))
    assert echogram is not None
    assert echogram.std() > 5
    assert (out / "overlay/swim.avi.mp4").stat().st_size > 1000


def test_images_cannot_be_counted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), swimming()[0])
    words = ["detect", str(tmp_path / "a.png"), "--count", "--out", str(tmp_path / "o")]
    assert main(words) == 2
    assert "--count" in capsys.readouterr().err


def test_scores_of_tracks_are_those_of_their_definitions() -> None:
    box = np.array([[0, 0, 10, 10]], np.float32)
    truth = [TrackedFrame((1,), box)] * 4
    assert score_tracks(truth, truth) == (1, 1)
    # A track that breaks in the middle: the better half is right, HOTA loses association alone.
    broken = [TrackedFrame((n,), box) for n in (7, 7, 8, 8)]
    scores = score_tracks(truth, broken)
    assert scores.idf1 == pytest.approx(2 * 2 / 8)
    assert scores.hota == pytest.approx(np.sqrt(0.5))
    nothing = [TrackedFrame((), box[:0])] * 4
    assert score_tracks(truth, nothing) == (0, 0)
    assert count_error({"left": 2, "right": 1}, {"left": 1, "away": 1}) == 3
