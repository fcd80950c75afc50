"""A recording that is stopped goes on where it was, to the bytes of an undisturbed run."""

from __future__ import annotations

import csv
import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from simnfnd.factory.common.array_types import Float32s, UInt8s
from simnfnd.factory.common.ros_types import typestore
from simnfnd.models.denoise import command, options
from simnfnd.models.denoise.reports import TABLE
from simnfnd.models.recordings.rosbag import IMAGE
from tests.models.adapt.scenes import noisy, scene, write
from tests.models.recordings.bag_files import image as image_message
from tests.models.recordings.bag_files import write_bag
from tests.models.recordings.recording_files import pings, write_aris, write_oculus

FRAMES = 44


class Smoothing:
    """A network that costs little, and kills or stops its process at an image."""

    name = "smoothing"
    digest = "0"

    def __init__(self, at: int | None = None, number: int = signal.SIGINT) -> None:
        self.at = at
        self.number = number
        self.count = 0

    def __call__(self, grey: Float32s, geometry: object = None) -> Any:
        self.count += 1
        if self.count == self.at:
            os.kill(os.getpid(), self.number)
        return cv2.GaussianBlur(grey, (0, 0), 1.5)


def moving_scene(count: int = FRAMES, side: int = 48) -> UInt8s:
    """(count, side, side): a drifting scene, with a frame that is repeated."""
    ground = scene(0, side, side)
    frames = [noisy(np.roll(ground, number // 9, 1), number) for number in range(count)]
    frames[20:21] = frames[19:20]
    return np.asarray(np.rint(np.stack(frames) * 255), np.uint8)


def write_video(path: Path) -> None:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"FFV1"), 5.0, (48, 48))
    for grey in moving_scene():
        writer.write(cv2.applyColorMap(grey, cv2.COLORMAP_JET))
    writer.release()


def write_images(folder: Path) -> None:
    for number, grey in enumerate(moving_scene()):
        write(folder / f"f{number:02d}.png", grey / np.float32(255))


def write_bag_of_images(path: Path) -> None:
    store = typestore(2)
    messages = [image_message(store, number, grey) for number, grey in enumerate(moving_scene())]
    write_bag(path, {"/images": (IMAGE, messages)})


WRITERS: dict[str, Callable[[Path], object]] = {
    "a.avi": write_video,
    "a.npy": lambda path: np.save(path, moving_scene()),
    "a.aris": lambda path: write_aris(path, pings(FRAMES, 24, 48)),
    "a.raw": lambda path: write_oculus(path, pings(FRAMES, 24, 20)),
    "a.mcap": write_bag_of_images,
    "images": write_images,
}


def contents(folder: Path) -> dict[str, bytes]:
    """All results; the journal has times in it."""
    files = (path for path in folder.rglob("*") if path.is_file())
    results = {str(path.relative_to(folder)): path for path in files}
    return {name: path.read_bytes() for name, path in results.items() if name[0] != "."}


def use(monkeypatch: pytest.MonkeyPatch, denoiser: Smoothing) -> Smoothing:
    monkeypatch.setattr(command, "Denoiser", lambda *arguments, **named: denoiser)
    return denoiser


# --- A second run -------------------------------------------------------------------------------


def rows_of(out: Path) -> dict[str, dict[str, str]]:
    with (out / TABLE).open(newline="", encoding="utf-8") as file:
        return {row["file"]: row for row in csv.DictReader(file)}


def test_a_second_run_does_what_is_new_or_changed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in "abc":
        np.save(tmp_path / f"{name}.npy", moving_scene(12))
    out = tmp_path / "out"
    rest = ["--frames", "3", "--geometry", "none", "--out", str(out)]

    def run(names: str, *words: str) -> int:
        denoiser = use(monkeypatch, Smoothing())
        sources = [str(tmp_path / f"{name}.npy") for name in names]
        assert options.main([*sources, *words, *rest]) == 0
        return denoiser.count

    one = run("a")
    both = run("ab")
    assert both == one
    assert "already denoised: 1 file" in capsys.readouterr().out
    assert run("ab") == 0
    assert sorted(rows_of(out)) == ["a.npy", "b.npy"]
    np.save(tmp_path / "a.npy", moving_scene(13))
    assert one < run("abc") < 3 * one
    (out / "b.npy").unlink()
    assert run("abc") == one
    assert run("abc", "--strength", "0.5") > 2 * one
    assert run("abc", "--strength", "0.5", "--again") > 2 * one


def test_a_new_image_changes_its_sequence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where neighbours count; alone, images are independent."""
    frames = moving_scene(6)
    folder = tmp_path / "in"
    for window, expected in (("1", 1), ("3", 6)):
        for number in range(5):
            write(folder / f"f{number}.png", frames[number] / np.float32(255))
        (folder / "f5.png").unlink(missing_ok=True)
        words = [str(folder), "--frames", window, "--geometry", "none"]
        words += ["--out", str(tmp_path / window)]
        use(monkeypatch, Smoothing())
        assert options.main(words) == 0
        write(folder / "f5.png", frames[5] / np.float32(255))
        denoiser = use(monkeypatch, Smoothing())
        assert options.main(words) == 0
        assert denoiser.count >= expected
        assert (denoiser.count == 1) == (expected == 1)
        assert len(rows_of(tmp_path / window)) == 6


@pytest.mark.slow
def test_the_table_says_what_became_of_each_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    np.save(tmp_path / "a.npy", moving_scene(12))
    write_video(tmp_path / "b.avi")
    write_images(tmp_path / "c")
    use(monkeypatch, Smoothing())
    sources = [str(tmp_path / name) for name in ("a.npy", "b.avi", "c")]
    out = tmp_path / "out"
    words = ["--frames", "3", "--geometry", "none", "--out", str(out)]
    assert options.main([*sources, *words]) == 0
    rows = rows_of(out)
    assert len(rows) == 2 + FRAMES
    assert rows["a.npy"]["frames"] == "12"
    assert rows["b.avi"]["colour_maps"] == "jet"
    assert rows["b.avi"]["repeated_frames"] == "1"
    assert 1 < float(rows["f00.png"]["fused_frames"]) <= 3
    assert int(rows["a.npy"]["strength_measured_on"]) > 3
    said = capsys.readouterr().out.splitlines()
    for name in ("a.npy: 12 frames", "b.avi: 44 frames", "f00.png to f43.png: 44 frames"):
        assert sum(line.startswith(name) for line in said) == 1
