"""Bags and videos of a recorder that was stopped: whole frames and a warning, or a remedy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.common.ros_types import typestore
from simnfnd.models.recordings import open_recording
from simnfnd.models.recordings.rosbag import IMAGE
from tests.models.recordings.bag_files import image, write_bag
from tests.models.recordings.recording_files import pings, write_video
from tests.models.recordings.video_files import encode


@pytest.mark.parametrize(
    ("name", "tool"),
    [("a.bag", "rosbag reindex"), ("a.mcap", "mcap recover"), ("a.db3", "sqlite3")],
)
def test_a_bag_that_is_cut_short_names_the_tool(tmp_path: Path, name: str, tool: str) -> None:
    store = typestore(1 if name == "a.bag" else 2)
    messages = [image(store, number, frame) for number, frame in enumerate(pings(10, 120, 80))]
    path = write_bag(tmp_path / name, {"/sonar": (IMAGE, messages)})
    content = path.read_bytes()
    path.write_bytes(content[: int(0.7 * len(content))])
    with pytest.raises(FactoryError, match=f"{name}: .*`{tool}"):
        open_recording(path)


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
        said = "cut short" if name == "a.avi" else "says that it lasts 1.00 s and ends after 0.60 s"
        assert said in recording.warning
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
