"""A package reads its recorder's files; what it gives is checked as built-in readers are."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import simnfnd
from simnfnd.command import main
from simnfnd.extensions import (
    Beams,
    RecordingEntry,
    RecordingFrame,
    SonarPose,
    register_recording,
)
from simnfnd.factory.common import extensions
from simnfnd.factory.common.errors import FactoryError, FrameError
from simnfnd.models.recordings import kind_of
from simnfnd.models.recordings.extension_files import checked_frame
from tests.models.recordings.recording_files import pings, write_aris
from tests.project_files import ROOT


@pytest.fixture(autouse=True)
def _nothing_stays() -> Iterator[None]:
    yield
    for kind, name in list(extensions._registered):
        if kind == "recording":
            extensions._registered.pop((kind, name))


@pytest.fixture
def entry() -> RecordingEntry:
    """That of docs/how-to/extending.md."""
    page = (ROOT / "docs/how-to/extending.md").read_text(encoding="utf-8")
    code = re.search(r"```python\n# mine/ping_file.py\n(.*?)```", page, re.DOTALL)
    assert code is not None
    module: dict[str, Any] = {}
    exec(code[1], module)
    found: RecordingEntry = module["PING_FILE"]
    return found


def write_pings(path: Path, count: int = 3) -> np.ndarray:
    samples = pings(count, 24, 16)
    parts = [struct.pack("<4sHHff", b"PING", 24, 16, 10.0, 90.0)]
    for number, frame in enumerate(samples):
        parts += [struct.pack("<d", 1.7e9 + number), frame.tobytes()]
    path.write_bytes(b"".join(parts))
    return samples


def test_a_recorders_file_is_a_recording(tmp_path: Path, entry: RecordingEntry) -> None:
    path = tmp_path / "dive.pings"
    samples = write_pings(path)
    assert kind_of(path) is None
    register_recording(entry)
    with simnfnd.open_recording(path) as recording:
        assert len(recording) == 3
        frame = recording[1]
    np.testing.assert_array_equal(frame.samples, samples[1])
    assert frame.time_s == 1.7e9 + 1
    assert frame.geometry is not None
    assert frame.geometry.range_max_m == 10
    assert main(["denoise", str(tmp_path), "--out", str(tmp_path / "out"), "--frames", "1"]) == 0
    assert len(list((tmp_path / "out/dive.pings").glob("*_polar.png"))) == 3
    table = tmp_path / "frames.csv"
    assert main(["export", str(path), "--to", "csv", "--out", str(table)]) == 0
    assert len(table.read_text().splitlines()) == 4


def test_what_a_package_raises_costs_a_line(tmp_path: Path, entry: RecordingEntry) -> None:
    register_recording(entry)
    path = tmp_path / "a.pings"
    write_pings(path)
    content = path.read_bytes()
    for damaged in (b"", content[:10], b"PONG" + content[4:], content[:100]):
        path.write_bytes(damaged)
        with pytest.raises(FactoryError, match=r"a\.pings") as raised:
            simnfnd.open_recording(path)
        assert "\n" not in str(raised.value)
    odd = content.replace(struct.pack("<f", 90.0), struct.pack("<f", 300.0))
    path.write_bytes(odd)
    with simnfnd.open_recording(path) as recording, pytest.raises(FrameError, match="bearings"):
        recording[0]


BEAMS = Beams((-0.1, 0.0, 0.1), 1.0, 5.0)
GOOD = RecordingFrame(0, np.zeros((4, 3), np.uint8), BEAMS)


@pytest.mark.parametrize(
    "change",
    [
        lambda frame: None,
        lambda frame: replace(frame, number=1),
        lambda frame: replace(frame, samples=frame.samples.astype(np.int32)),
        lambda frame: replace(frame, samples=np.full((4, 3), np.nan, np.float32)),
        lambda frame: replace(frame, samples=np.zeros((9000, 3), np.uint8)),
        lambda frame: replace(frame, beams=replace(BEAMS, azimuths_rad=(0.1, 0.0, -0.1))),
        lambda frame: replace(frame, beams=replace(BEAMS, range_max_m=np.inf)),
        lambda frame: replace(frame, pose=SonarPose(heading_deg=np.inf)),
        lambda frame: replace(frame, beams=None, samples=np.zeros((4, 3, 5), np.uint8)),
    ],
)
def test_frames_are_checked(change: Callable[[RecordingFrame], Any]) -> None:
    with pytest.raises(FrameError, match=r"^the frame: "):
        checked_frame(change(GOOD), 0, "the frame")


def test_sound_frames_pass() -> None:
    """In native byte order and one piece."""
    wide = np.zeros((4, 6), ">u2")[:, ::2]
    frame = checked_frame(replace(GOOD, samples=wide), 0, "a")
    assert frame.samples.dtype == np.uint16
    assert frame.samples.dtype.isnative
    assert frame.samples.flags.c_contiguous


def test_suffixes_are_kept_apart(tmp_path: Path, entry: RecordingEntry) -> None:
    """A known suffix needs a look at the file; other files of it stay what they were."""
    for suffixes in ((".aris",), (), ("son",), (".SON",)):
        with pytest.raises(ValueError, match="ping_file"):
            register_recording(replace(entry, suffixes=suffixes))
    with pytest.raises(ValueError, match="one of that kind"):
        register_recording(replace(entry, kind="aris", suffixes=(".pings",)))

    def accepts(path: Path) -> bool:
        with path.open("rb") as file:
            return file.read(4) == b"PING"

    register_recording(replace(entry, suffixes=(".aris",), accepts=accepts))
    write_pings(tmp_path / "a.aris")
    assert kind_of(tmp_path / "a.aris") == "ping_file"
    assert kind_of(write_aris(tmp_path / "b.aris", pings(1, 24, 48))) == "aris"
