"""Videos that `simnfnd denoise` takes and gives back."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from simnfnd.factory.errors import FrameError
from simnfnd.models.denoise.writers import CODECS, write_frames
from simnfnd.models.recordings.pictures import VideoFile
from tests.models.denoise.halving import main
from tests.models.denoise.untrained import through_network
from tests.small_dataset import fan_images


@pytest.mark.parametrize("name", ["dive.avi", "dive.mp4", "dive.webm"])
def test_videos_become_videos_or_folders(weights: Path, tmp_path: Path, name: str) -> None:
    noisy, _, _ = fan_images(48, np.random.default_rng(1))
    grey = (noisy * 255).astype(np.uint8)
    path = tmp_path / "dive.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 12.5, (48, 48))
    for shift in range(3):
        writer.write(cv2.cvtColor(np.roll(grey, shift, axis=1), cv2.COLOR_GRAY2BGR))
    writer.release()
    path = path.rename(tmp_path / name)
    with VideoFile(path) as recording:
        originals = [frame.samples for frame in recording]
    out = tmp_path / "out"
    assert main([str(path), "--out", str(out), "--weights", str(weights), "--compare"]) == 0
    if name != "dive.webm":
        with VideoFile(out / name) as recording:
            assert recording.rate_hz == pytest.approx(12.5)
            results = [frame.samples for frame in recording]
    else:
        frames = sorted((out / name).iterdir())
        assert [frame.name for frame in frames] == ["000000.png", "000001.png", "000002.png"]
        results = [np.asarray(cv2.imread(str(frame), cv2.IMREAD_UNCHANGED)) for frame in frames]
    assert len(results) == len(originals) == 3
    for original, result in zip(originals, results, strict=True):
        assert result.shape == original.shape
        assert np.abs(result - through_network(weights, original / 255.0) * 255).max() <= 0.51
    assert (out / "compare" / "dive.png").is_file()
    assert sorted(entry.name for entry in out.iterdir()) == sorted(["compare", name])


@pytest.mark.parametrize("name", [f"a{suffix}" for suffix in CODECS])
@pytest.mark.parametrize("colours", [(), (3,)])
def test_frames_survive_in_every_container(
    tmp_path: Path, name: str, colours: Any, capfd: pytest.CaptureFixture[str]
) -> None:
    frames = np.random.default_rng(3).integers(0, 256, (4, 30, 46, *colours), dtype=np.uint8)
    write_frames(tmp_path / name, frames, 7.5)
    with VideoFile(tmp_path / name) as recording:
        assert recording.rate_hz == pytest.approx(7.5)
        np.testing.assert_array_equal([frame.samples for frame in recording], frames)
    assert [entry.name for entry in tmp_path.iterdir()] == [name]
    assert not capfd.readouterr().err, "what OpenCV says of codecs is of no use to anybody"


@pytest.mark.parametrize(("shape", "rate_hz"), [((31, 46), 7.5), ((30, 47), 7.5), ((30, 46), None)])
def test_frames_that_fit_no_container_are_pictures(
    tmp_path: Path, shape: tuple[int, int], rate_hz: float | None
) -> None:
    frame = np.random.default_rng(3).integers(0, 256, shape, dtype=np.uint8)
    write_frames(tmp_path / "a.avi", [frame, frame], rate_hz)
    assert sorted(path.name for path in (tmp_path / "a.avi").iterdir()) == [
        "000000.png",
        "000001.png",
    ]
    np.testing.assert_array_equal(cv2.imread(str(tmp_path / "a.avi/000001.png"), -1), frame)
    (tmp_path / "b.avi").write_bytes(b"mine")
    with pytest.raises(FrameError, match=r"b\.avi: is there already"):
        write_frames(tmp_path / "b.avi", [frame], None)


def test_a_video_that_broke_off_leaves_nothing(tmp_path: Path) -> None:
    def stopped() -> Iterator[np.ndarray]:
        yield np.zeros((30, 46), np.uint8)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_frames(tmp_path / "a.avi", stopped(), 10.0)
    assert list(tmp_path.iterdir()) == []
