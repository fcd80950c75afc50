"""Recordings that stand still, judged in time."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from simnfnd.evaluation.methods import Method
from simnfnd.evaluation.real import in_time
from simnfnd.evaluation.real.groups import Group
from simnfnd.evaluation.recorded import Shot
from simnfnd.factory.scheduler.workers.tasks import TaskPool
from tests.evaluation.real.static_scenes import SHAPE, frames


def recording(path: Path, seed: int, count: int) -> Group:
    """A group of the frames of a video of one scene."""
    video = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 5, SHAPE[::-1], True)
    for frame in frames(seed, count):
        video.write(cv2.cvtColor(frame, cv2.COLOR_GRAY2BGR))
    video.release()
    shots = tuple(Shot(path, number, f"{path.name}#{number}") for number in range(count))
    still = np.ones(SHAPE, bool)
    return Group(path.name, shots, np.zeros((count, 2)), None, still, 1.0)


def blurred(gray: Any, geometry: object = None, **more: object) -> Any:
    return cv2.GaussianBlur(gray, (0, 0), 1.0)


def judged(groups: list[Group], networks: list[Method], most: int = 20) -> tuple[Any, list[str]]:
    settings: Any = SimpleNamespace(in_time=most, device="cpu")
    with TaskPool(1) as pool:
        return in_time.judged_in_time(settings, groups, networks, pool)


def test_rows_of_networks_and_of_frames(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(in_time, "network", lambda weights, device: blurred)
    monkeypatch.setattr(in_time, "WEIGHTS", (0.02, 0.04))
    one = Method("one", "", {}, weights="one")
    groups = [recording(tmp_path / f"{seed}.avi", seed, 14) for seed in (0, 1)]
    found, notes = judged(groups, [one], most=12)
    rows = [
        "one: one frame",
        "fused",
        "one: fused and denoised",
        "mean of 7",
        "mean of 7, tuned TV",
    ]
    assert list(found["row"].unique()) == rows
    assert list(found["kind"].unique()) == ["static", "moving", "ghost"]
    assert len(found) == 2 * 3 * len(rows)
    psnr = found.groupby(["kind", "row"])["psnr_db"].last()
    assert psnr["static", "mean of 7, tuned TV"] > psnr["static", "mean of 7"]
    assert psnr["moving", "mean of 7"] < psnr["moving", "fused"]
    assert any("0.avi: tuned TV has weight" in n and "tuned on 1.avi" in n for n in notes)
    table = in_time.wide(found)
    assert list(table) == ["row", *(f"{k}, dB / SSIM" for k in ("static", "moving", "ghost"))]
    assert list(table["row"]) == rows
    _, alone = judged(groups[:1], [one])
    assert "tuned on the first 12 frames of itself" in alone[0]


def test_nothing_is_judged_in_time_without_recordings_or_networks(tmp_path: Path) -> None:
    network = Method("one", "", {}, weights="one")
    short = recording(tmp_path / "short.avi", 0, 8)
    long = recording(tmp_path / "long.avi", 0, 14)
    assert judged([short], [network])[0].empty
    assert judged([long], [])[0].empty
    assert judged([long], [network], most=0)[0].empty
