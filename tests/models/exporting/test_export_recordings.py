"""Recordings leave as a video, as images and as a table, and come back by other libraries."""

from __future__ import annotations

import csv
from pathlib import Path

import cv2
import numpy as np
import pytest

import simnfnd
from simnfnd.command import main
from tests.models.recordings.recording_files import pings, write_aris, write_oculus


def read_table(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_a_recording_as_a_video(tmp_path: Path) -> None:
    """Of the size of its fans, with all frames, at the recorder's rate of 10 Hz."""
    source = write_aris(tmp_path / "a.aris", pings(5, 64, 48))
    target = tmp_path / "talk.mp4"
    assert main(["export", str(source), "--to", "mp4", "--out", str(target)]) == 0
    with simnfnd.open_recording(source) as recording:
        height, width = recording[0].image.shape
    with simnfnd.open_recording(target) as video:
        frames = list(video)
    assert len(frames) == 5
    assert abs(frames[0].image.shape[0] - height) <= 1
    assert abs(frames[0].image.shape[1] - width) <= 1
    times = [frame.time_s or 0.0 for frame in frames]
    np.testing.assert_allclose(times, np.arange(5) * 0.1, atol=1e-3)
    assert main(["export", str(source), "--to", "mp4", "--out", str(target)]) == 2, "is there"


def test_a_recording_as_images(tmp_path: Path) -> None:
    source = write_aris(tmp_path / "a.aris", pings(2, 64, 48))
    assert main(["export", str(source), "--to", "png", "--out", str(tmp_path / "png")]) == 0
    images = sorted((tmp_path / "png").iterdir())
    assert [path.name for path in images] == ["000000.png", "000001.png"]
    image = cv2.imread(str(images[1]), cv2.IMREAD_UNCHANGED)
    with simnfnd.open_recording(source) as recording:
        expected = recording[1].image
    np.testing.assert_allclose(image, 255 * expected, atol=0.51)


def test_a_recording_as_a_table(tmp_path: Path) -> None:
    source = write_aris(tmp_path / "a.aris", pings(3, 64, 48))
    target = tmp_path / "frames.csv"
    assert main(["export", str(source), "--to", "csv", "--out", str(target)]) == 0
    rows = read_table(target)
    assert [row["frame"] for row in rows] == ["0", "1", "2"]
    assert float(rows[2]["time_s"]) == pytest.approx(1_700_000_000.2)
    assert rows[0]["time_utc"].startswith("2023-11-14T22:13:20")
    assert float(rows[0]["heading_deg"]) == 123
    assert float(rows[0]["device_sound_speed_m_s"]) == 1500
    assert rows[0]["device_gain_percent"] == ""
    assert 27 < float(rows[0]["opening_deg"]) < 29
    with simnfnd.open_recording(source) as recording:
        beams = recording[0].beams
    assert beams is not None
    assert float(rows[0]["range_max_m"]) == pytest.approx(beams.range_max_m)


def test_a_denoised_recording_that_is_a_folder(tmp_path: Path) -> None:
    """Its fans count, and not the samples beside them."""
    source = write_oculus(tmp_path / "a.raw", pings(2, 24, 20))
    out = tmp_path / "out"
    assert main(["denoise", str(source), "--out", str(out), "--frames", "1"]) == 0
    target = tmp_path / "frames.csv"
    assert main(["export", str(out / "a.raw"), "--to", "csv", "--out", str(target)]) == 0
    assert [row["file"] for row in read_table(target)] == ["000000.png", "000001.png"]


def test_what_cannot_be_exported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = write_aris(tmp_path / "a.aris", pings(1, 64, 48))
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "a").touch()
    for words in (
        [str(source), "--to", "coco", "--out", str(tmp_path / "out")],
        [str(tmp_path / "none.aris"), "--to", "csv", "--out", str(tmp_path / "out")],
        [str(source), "--to", "png", "--out", str(tmp_path / "full")],
        [str(source), "--to", "csv", "--out", str(tmp_path / "out"), "--split", "test"],
    ):
        assert main(["export", *words]) == 2
        assert len(capsys.readouterr().err.splitlines()) == 1
    with pytest.raises(SystemExit):
        main(["export", "--help"])
    assert "--to csv" in capsys.readouterr().out


def test_each_recording_of_a_folder_gets_its_table(tmp_path: Path) -> None:
    folder = tmp_path / "dives"
    folder.mkdir()
    for name in ("a", "b"):
        np.save(folder / f"{name}.npy", np.zeros((3, 40, 50), np.uint8))
    out = tmp_path / "tables"
    assert main(["export", str(folder), "--to", "csv", "--out", str(out)]) == 0
    assert sorted(path.name for path in out.iterdir()) == ["a.npy.csv", "b.npy.csv"]
    assert main(["export", str(folder), "--to", "csv", "--out", str(tmp_path / "one.csv")]) == 2


def test_a_recording_as_a_bag_of_ros(tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    source = write_aris(tmp_path / "a.aris", pings(3, 64, 48))
    assert main(["export", str(source), "--to", "mcap", "--out", str(tmp_path / "bag")]) == 0
    with (
        simnfnd.open_recording(source) as recording,
        simnfnd.open_recording(tmp_path / "bag/a") as bag,
    ):
        assert len(bag) == 3
        np.testing.assert_array_equal(bag[2].samples, recording[2].samples)
        assert bag[2].time_s == pytest.approx(recording[2].time_s)
        assert bag[2].beams is not None
        assert recording[2].beams is not None
        assert bag[2].beams.range_max_m == pytest.approx(recording[2].beams.range_max_m, abs=1e-3)
