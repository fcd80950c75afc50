"""Videos, and pictures whose colours stand for levels of echo, in `simnfnd denoise`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from simnfnd.models.denoise.writers import CODECS, write_frames
from simnfnd.models.recordings import open_recording
from simnfnd.models.recordings.pictures import VideoFile
from tests.models.adapt.scenes import noisy, scene
from tests.models.denoise.untrained import main, through_network
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
    assert (out / "compare" / f"{name}.png").is_file()
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


Bytes = npt.NDArray[Any]


def levels_of(number: int) -> Bytes:
    return np.asarray(np.rint(np.clip(noisy(scene(0), number), 0, 1) * 255), np.uint8)


def jet(levels: npt.NDArray[np.floating] | Bytes) -> Bytes:
    rounded = np.rint(levels).astype(np.uint8)
    return np.asarray(cv2.applyColorMap(rounded, cv2.COLORMAP_JET), np.uint8)


def away(one: npt.NDArray[Any], other: Bytes) -> float:
    return float(np.abs(one.astype(int) - other).mean())


@pytest.mark.usefixtures("halving")
def test_a_picture_is_painted_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    levels = levels_of(0)
    (tmp_path / "in").mkdir()
    for suffix in ("png", "tif", "bmp"):
        assert cv2.imwrite(str(tmp_path / "in" / f"a.{suffix}"), jet(levels))
    words = [str(tmp_path / "in"), "--out", str(tmp_path / "out"), "--weights", "x", "--compare"]
    assert main(words) == 0
    for suffix in ("png", "tif", "bmp"):
        result = cv2.imread(str(tmp_path / "out" / f"a.{suffix}"), cv2.IMREAD_UNCHANGED)
        assert away(result, jet(levels / 2)) < 2
    assert "colour maps: jet in 3" in capsys.readouterr().out


@pytest.mark.usefixtures("halving")
def test_a_video_is_painted_again(tmp_path: Path) -> None:
    path = tmp_path / "a.avi"
    code = cv2.VideoWriter.fourcc(*"FFV1")
    frames = [levels_of(number)[:60, :62] for number in range(3)]
    writer = cv2.VideoWriter(str(path), code, 5.0, frames[0].shape[::-1])
    for frame in frames:
        writer.write(jet(frame))
    writer.release()
    assert main([str(path), "--out", str(tmp_path / "out"), "--weights", "x"]) == 0
    with open_recording(tmp_path / "out" / "a.avi") as denoised:
        for before, after in zip(frames, denoised, strict=True):
            assert away(after.samples, jet(before / 2)) < 8, "a codec of video mixes colours"
