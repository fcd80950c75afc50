"""`simnfnd evaluate real` on scenes that stand still: truth, folds, tuning."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from simnfnd.command import main
from simnfnd.evaluation.filters import REGISTRY
from simnfnd.evaluation.real.groups import Group, judged, nearest, parts_of
from simnfnd.evaluation.recorded import Shot
from simnfnd.evaluation.tuning import line_search
from tests.evaluation.real.static_scenes import SHAPE, frames, shuffled


def real(out: Path, *words: str) -> dict[str, Any]:
    assert main(["evaluate", "real", *words, f"out={out}", "workers=1", "examples=1"]) == 0
    content: dict[str, Any] = json.loads((out / "real.json").read_text(encoding="utf-8"))
    return content


def group(folder: Path, values: list[int]) -> Group:
    """A group of even pictures."""
    shots = []
    for number, value in enumerate(values):
        path = folder / f"{number}.png"
        cv2.imwrite(str(path), np.full(SHAPE, value, np.uint8))
        shots.append(Shot(path, 0, path.name))
    still = np.ones(SHAPE, bool)
    return Group("even", tuple(shots), np.zeros((len(shots), 2)), None, still, 1.0)


def test_a_shuffled_folder_is_judged_by_its_groups(tmp_path: Path) -> None:
    folder = shuffled(tmp_path / "in", {0: 11, 1: 7, 2: 3})
    content = real(tmp_path / "out", str(folder), "baselines=[gaussian,median]")
    assert sorted(len(one["frames"]) for one in content["groups"]) == [7, 11]
    assert [one["fold"] for one in content["groups"]] == [0, 1]
    assert len(content["files"]) == 18, "the third scene has too few frames"
    rows = {row["label"]: row for row in content["rows"]}
    noisy, blurred = rows["noisy"], rows["gaussian tuned on others"]
    # Noise of .08, and an eleventh or seventh of it in the truth; levels take some away.
    assert 20.5 < noisy["means"]["psnr_db"] < 23
    assert blurred["means"]["gain_db"] > 5
    assert len(blurred["parameters"]) == 2
    low, high = blurred["intervals"]["psnr_db"]
    assert low <= blurred["means"]["psnr_db"] <= high
    assert content["best_filter"]["psnr_db"] == "gaussian tuned on others"
    assert noisy["means"]["margin_db"] == pytest.approx(-blurred["means"]["gain_db"], abs=1e-6)
    text = (tmp_path / "out" / "real.md").read_text(encoding="utf-8")
    assert "2 static groups of 18 frames" in text
    # The example shows three rows and the truth.
    page = (tmp_path / "out" / "real.html").read_text(encoding="utf-8")
    assert page.count("data:image/png") == 4


def test_of_a_recording_one_half_tunes_and_the_other_is_judged(tmp_path: Path) -> None:
    path = tmp_path / "dive.avi"
    video = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 5, SHAPE[::-1], True)
    for frame in frames(3, 9):
        video.write(cv2.cvtColor(frame, cv2.COLOR_GRAY2BGR))
    video.release()
    content = real(tmp_path / "out", str(path), "baselines=[gaussian]", "limit=8")
    (found,) = content["groups"]
    assert found["frames"] == [f"dive.avi#{number}" for number in range(8)]
    assert found["judged"] == found["frames"][4:]
    assert any("tuned on frames of its first half (4)" in note for note in content["notes"])
    rows = {row["label"]: row for row in content["rows"]}
    assert rows["gaussian tuned on others"]["means"]["gain_db"] > 3
    assert rows["noisy"]["intervals"] == {}


def test_the_truth_of_a_frame_does_not_hold_it(tmp_path: Path) -> None:
    values = [10, 20, 30, 40, 50, 60, 70, 90, 100, 130]
    (one,) = judged(0, group(tmp_path, values), [1])
    assert one.reference is not None
    assert one.noisy[0, 0] * 255 == pytest.approx(20)
    assert one.reference[0, 0] * 255 == pytest.approx((sum(values) - 20) / 9, rel=1e-5)
    assert nearest(10, 5, 7) == [2, 3, 4, 5, 6, 7, 8]
    assert nearest(10, 9, 7) == [3, 4, 5, 6, 7, 8, 9]


def test_filters_are_tuned_on_other_frames_than_they_judge(tmp_path: Path) -> None:
    shared = group(tmp_path, [50] * 8)
    (part,) = parts_of([shared])
    assert part.judged == (4, 5, 6, 7)
    assert part.tuning == {0: (0, 1, 2, 3)}
    parts = parts_of([shared] * 40)
    for part in parts:
        assert part.judged == tuple(range(8))
        assert part.fold not in part.tuning
    for fold in (0, 1):
        assert 14 <= sum(len(part.tuning.get(fold, ())) for part in parts) <= 16


def test_tuning_finds_the_best_point_without_trying_all() -> None:
    wavelet = REGISTRY["wavelet"]

    def peak(point: dict[str, float]) -> float:
        return -abs(math.log(point["strength"] / 0.068)) - abs(point["levels"] - 2)

    points = line_search(wavelet, peak)
    assert points[0] == {"strength": 0.07, "levels": 2}
    assert len(points) < len(wavelet.points()) / 2
    between, *_ = line_search(REGISTRY["gaussian"], lambda p: -abs(math.log(p["sigma_px"] / 1.2)))
    assert between["sigma_px"] == pytest.approx(1.18)
