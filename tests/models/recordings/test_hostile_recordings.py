"""Strangers' recordings: one line, little memory, little time, and no other file or address."""

from __future__ import annotations

import resource
import socket
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from simnfnd.factory.common.errors import FactoryError, FrameError
from simnfnd.factory.common.ros_types import SONAR, typestore
from simnfnd.models.recordings import base, open_recording
from simnfnd.models.recordings.images import read_image
from simnfnd.models.recordings.rosbag import COMPRESSED, IMAGE
from simnfnd.models.recordings.sonar_files import ArisFile
from tests.models.recordings.bag_files import compressed, image, sonar, write_bag
from tests.models.recordings.mutations import MUTATIONS, mutated, use
from tests.models.recordings.recording_files import (
    pings,
    write_aris,
    write_array,
    write_black_png,
    write_ddf,
    write_gif,
    write_log,
    write_oculus,
    write_stack,
    write_video,
)


def _png(path: Path) -> Path:
    assert cv2.imwrite(str(path), pings(1, 60, 48)[0])
    return path


def _bag(path: Path, kind: str, compression: str = "") -> Path:
    store = typestore(1 if path.suffix == ".bag" else 2)
    makers: dict[str, Callable[..., Any]] = {SONAR: sonar, IMAGE: image, COMPRESSED: compressed}
    make = makers[kind]
    messages = [make(store, number, ping) for number, ping in enumerate(pings(3, 12, 8))]
    return write_bag(path, {"/sonar": (kind, messages)}, compression=compression)


WRITERS: dict[str, Callable[[Path], Path]] = {
    "a.aris": lambda path: write_aris(path, pings(3, 16, 48)),
    "a.ddf": lambda path: write_ddf(path, pings(3, 16, 48)),
    "a.raw": lambda path: write_oculus(path, pings(3, 16, 16)),
    "b.raw": lambda path: write_oculus(path, pings(3, 16, 16), version=2, gains=True),
    "a.oculus": lambda path: write_log(path, pings(3, 16, 16), packed=True),
    "a.avi": lambda path: write_video(path, pings(4, 48, 64)),
    "a.tif": lambda path: write_stack(path, pings(4, 48, 64)),
    "a.gif": lambda path: write_gif(path, pings(4, 48, 64)),
    "a.png": _png,
    **{
        name: lambda path: write_array(path, pings(4, 48, 64))
        for name in ("a.npy", "a.npz", "a.mat")
    },
    "a.bag": lambda path: _bag(path, SONAR),
    "b.bag": lambda path: _bag(path, COMPRESSED, "lz4"),
    "a.mcap": lambda path: _bag(path, SONAR),
    "a.db3": lambda path: _bag(path, IMAGE),
}


@pytest.mark.parametrize("name", WRITERS)
def test_mutations(tmp_path: Path, name: str) -> None:
    path = WRITERS[name](tmp_path / name)
    use(path)
    whole = path.read_bytes()
    rng = np.random.default_rng(20)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    started = time.monotonic()
    refused = 0
    for number in range(MUTATIONS):
        path.write_bytes(mutated(whole, rng))
        try:
            # A file of SQLite takes a tenth of a second to reach the disk.
            use(path, again=number % 10 == 0)
        except FactoryError as error:
            refused += 1
            text = str(error)
            assert "\n" not in text, number
            assert str(path) in text
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    assert grown < 300_000, "kilobytes"
    assert time.monotonic() - started < 60
    assert refused > 1


@pytest.mark.parametrize(
    "suffix", [".aris", ".ddf", ".raw", ".avi", ".png", ".bag", ".mcap", ".db3"]
)
@pytest.mark.parametrize("content", [b"", b"DDF", b"\0" * 5000, b"GIF89a" * 1000])
def test_foreign_files(tmp_path: Path, suffix: str, content: bytes) -> None:
    path = tmp_path / f"a{suffix}"
    path.write_bytes(content)
    with pytest.raises(FactoryError) as caught:
        use(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


_LISTS = ("#EXTM3U\n#EXTINF:1,\nfile://{}\n#EXT-X-ENDLIST\n", "ffconcat version 1.0\nfile {}")


@pytest.mark.parametrize("text", _LISTS)
def test_a_video_that_lists_other_files_is_not_opened(
    tmp_path: Path, text: str, capfd: pytest.CaptureFixture[str]
) -> None:
    secret = write_video(tmp_path / "secret.avi", pings(4, 48, 64))
    path = tmp_path / "a.avi"
    path.write_text(text.format(secret))
    with pytest.raises(FactoryError, match=r"a\.avi: .*AVI, MP4"):
        open_recording(path)
    path.write_bytes(b"RIFF\x40\0\0\0AVI " + path.read_bytes())
    with pytest.raises(FactoryError, match=r"a\.avi: not a readable video"):
        open_recording(path)
    assert capfd.readouterr() == ("", "")


def test_a_file_named_as_an_address_is_that_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(0.2)
        name = f"tcp:127.0.0.1:{server.getsockname()[1]}.avi"
        write_video(tmp_path / "a.avi", pings(4, 48, 64)).rename(name)
        with open_recording(name) as recording:
            assert len(list(recording)) == 4
        with pytest.raises(TimeoutError):
            server.accept()


def test_damage_that_libraries_pass_over_stays_off_the_terminal(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert cv2.imwrite(str(tmp_path / "a.jpg"), pings(1, 64, 64)[0])
    content = (tmp_path / "a.jpg").read_bytes()
    (tmp_path / "a.jpg").write_bytes(content[: len(content) // 2] + b"\0" * 40 + b"\xff\xd9")
    read_image(tmp_path / "a.jpg")
    path = write_video(tmp_path / "a.avi", pings(4, 48, 64))
    content = path.read_bytes()
    path.write_bytes(content[:6000] + bytes(2000) + content[8000:])
    with open_recording(path) as recording:
        list(recording)
    assert capfd.readouterr() == ("", "")


def test_an_image_that_is_too_large_says_how_large_is_allowed(tmp_path: Path) -> None:
    write_black_png(tmp_path / "a.png", 9000)
    with pytest.raises(FrameError, match=r"a\.png: .*67,108,864"):
        read_image(tmp_path / "a.png")


def test_a_stack_that_unpacks_to_too_much_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(base, "ALWAYS_BYTES", 1 << 16)
    pages = [np.zeros((1024, 1024), np.uint16)] * 5
    path = tmp_path / "a.tif"
    assert cv2.imwritemulti(str(path), pages, (cv2.IMWRITE_TIFF_COMPRESSION, 8))
    with pytest.raises(FactoryError, match=r"a\.tif: unpacks to 10,485,760"):
        open_recording(path)


def test_an_error_of_the_source_names_the_source(tmp_path: Path) -> None:
    """Not the file that is written."""
    source = ArisFile(write_aris(tmp_path / "a.aris", pings(3, 20, 48)))
    with (tmp_path / "a.aris").open("r+b") as file:
        file.truncate(2000)
    with pytest.raises(FrameError, match=r"a\.aris: ends within"):
        source.rewrite(pings(3, 20, 48), tmp_path / "b.aris")
    source.close()
    assert not (tmp_path / "b.aris").exists()
