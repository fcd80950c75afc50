"""Bags and videos of a recorder that was stopped: whole frames, and a warning."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.common.ros_types import SONAR, typestore
from simnfnd.models.recordings import open_recording
from simnfnd.models.recordings.rosbag import IMAGE, RosBag
from tests.models.recordings.bag_files import image, sonar, write_bag
from tests.models.recordings.recording_files import pings, write_video
from tests.models.recordings.video_files import encode


@pytest.mark.parametrize("compression", ["", "lz4"])
def test_a_bag_of_ros_1_without_its_index(tmp_path: Path, compression: str) -> None:
    _whole_frames(tmp_path / "a.bag", SONAR, compression)


@pytest.mark.parametrize(("name", "kind"), [("a.mcap", SONAR), ("a.mcap", IMAGE), ("a.db3", IMAGE)])
def test_a_bag_of_ros_2_that_is_cut_short(tmp_path: Path, name: str, kind: str) -> None:
    _whole_frames(tmp_path / name, kind, "")


def _whole_frames(path: Path, kind: str, compression: str) -> None:
    version = 1 if path.suffix == ".bag" else 2
    make = sonar if kind == SONAR else image
    samples = pings(10, 120, 80)
    messages = [make(typestore(version), number, frame) for number, frame in enumerate(samples)]
    write_bag(path, {"/sonar": (kind, messages)}, compression=compression)
    with open_recording(path) as recording:
        times_s = [frame.time_s for frame in recording]
    content = path.read_bytes()
    path.write_bytes(content[: int(0.7 * len(content))])
    with open_recording(path) as recording:
        assert isinstance(recording, RosBag)
        frames = list(recording)
        assert "cut short" in recording.warning
        assert len(recording) == len(frames)
        assert 3 <= len(frames) <= 7
        np.testing.assert_array_equal([frame.samples for frame in frames], samples[: len(frames)])
        assert [frame.time_s for frame in frames] == times_s[: len(frames)]
        recording.rewrite(
            (255 - frame.samples for frame in frames), path.with_name(f"b{path.suffix}")
        )
    with open_recording(path.with_name(f"b{path.suffix}")) as again:
        assert not again.warning
        np.testing.assert_array_equal(
            [frame.samples for frame in again], 255 - samples[: len(frames)]
        )


@pytest.mark.parametrize("name", ["a.avi", "a.mkv", "a.webm"])
def test_a_video_that_is_cut_short(tmp_path: Path, name: str) -> None:
    frames = pings(10, 48, 64)
    webm = {"codec": "libvpx-vp9", "stored": "yuv420p", "options": {"lossless": "1"}}
    path = encode(tmp_path / name, frames, **(webm if name == "a.webm" else {}))  # type: ignore[arg-type]
    with open_recording(path) as recording:
        whole = [frame.samples for frame in recording]
        assert not recording.warning
    content = path.read_bytes()
    path.write_bytes(content[: int(0.7 * len(content))])
    with open_recording(path) as recording:
        actual = [frame.samples for frame in recording]
        assert "cut short" in recording.warning
        assert len(recording) == len(actual)
    assert 5 <= len(actual) <= 8
    np.testing.assert_array_equal(actual, whole[: len(actual)])


def test_a_video_without_its_index_names_the_remedy(tmp_path: Path) -> None:
    path = encode(tmp_path / "a.mp4", pings(10, 48, 64), codec="png")
    content = path.read_bytes()
    path.write_bytes(content[: int(0.7 * len(content))])
    with pytest.raises(FactoryError, match=r"a\.mp4: .*moov"):
        open_recording(path)


def test_damaged_frames_are_left_out_and_counted(tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.avi", pings(8, 48, 64))
    content = bytearray(path.read_bytes())
    third = content.index(b"00dc", content.index(b"00dc", content.index(b"00dc") + 4) + 4)
    content[third + 8 : third + 12] = b"\0\0\0\0"  # no image begins so
    path.write_bytes(content)
    with open_recording(path) as recording:
        assert len(list(recording)) in (7, 8)
        assert len(recording) == len(list(recording))


def test_a_wrong_duration_is_said_and_a_missing_one_is_not(tmp_path: Path) -> None:
    path = encode(tmp_path / "a.mkv", pings(8, 48, 64))
    content = bytearray(path.read_bytes())
    place = content.index(b"\x44\x89\x88")
    longer = bytearray(content)
    missing = bytearray(content)
    longer[place + 3 : place + 11] = np.array(9000.0, ">f8").tobytes()
    missing[place : place + 11] = b"\xec\x89" + bytes(9)
    for changed, words in ((longer, "says that it lasts 9.00 s"), (missing, "")):
        path.write_bytes(changed)
        with open_recording(path) as recording:
            assert len(list(recording)) == 8
            assert words in recording.warning
            assert bool(words) == bool(recording.warning)
