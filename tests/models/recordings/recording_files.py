"""Small recordings of every format, written by the tests from the formats' documents."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import scipy.io
from PIL import Image

from simnfnd.factory.common.array_types import UInt8s
from tests.project_files import ROOT

DATA = ROOT.parent / "shared" / "data"
"""Recordings of real sonars; tests on them are skipped where they are not."""


def pings(count: int, ranges: int, beams: int) -> UInt8s:
    """(count, ranges, beams) uint8, near range first, beams from left to right."""
    return np.random.default_rng(7).integers(0, 256, (count, ranges, beams), dtype=np.uint8)


def write_aris(path: Path, samples: UInt8s, *, telephoto: bool = False, **changed: int) -> Path:
    """An ARIS 3000 or 1800 recording from 2 m on, 20 us a sample, 1500 m/s.

    changed: other values of integers of the frame headers, as `offset_436=1`.
    """
    count, ranges, beams = samples.shape
    mode = {48: 1, 96: 3, 64: 6, 128: 9}[beams]
    head = bytearray(1024)
    struct.pack_into("<II", head, 0, 0x05464444, count)
    parts = [bytes(head)]
    for number, frame in enumerate(samples):
        header = bytearray(1024)
        put = [
            ("<I", 0, number), ("<Q", 4, 1_700_000_000_000_000 + 100_000 * number),
            ("<I", 12, 0x05464444), ("<I", 68, 20), ("<f", 128, 4.5), ("<f", 160, 123.0),
            ("<f", 164, -2.0), ("<f", 168, 1.0), ("<d", 172, 54.3), ("<d", 180, 10.1),
            ("<f", 244, 15.0), ("<f", 248, -5.0), ("<I", 436, mode), ("<I", 440, 1),
            ("<I", 452, 20), ("<f", 464, 1500.0), ("<I", 468, ranges), ("<I", 476, 2667),
            ("<I", 480, int(telephoto)), ("<I", 484, 1 if beams in (64, 128) else 0),
            ("<I", 488, 1234), ("<I", 516, 1),
        ]  # fmt: skip
        for kind, offset, value in put:
            struct.pack_into(kind, header, offset, value)
        for name, value in changed.items():
            struct.pack_into("<I", header, int(name.removeprefix("offset_")), value)
        # Beam 0 is the rightmost.
        parts += [bytes(header), frame[:, ::-1].tobytes()]
    path.write_bytes(b"".join(parts))
    return path


def write_ddf(
    path: Path,
    samples: UInt8s,
    *,
    version: int = 3,
    serial: int = 100,
    high: bool = True,
    flags: int = 0,
    reverse: bool = False,
    code: int = 2,
    year: int = 2011,
) -> Path:
    """A DIDSON recording whose window has start 4; its computer's clock is at 1.4e9 s."""
    count, ranges, beams = samples.shape
    file_size, frame_size = {3: (512, 256), 4: (1024, 1024)}[version]
    head = bytearray(file_size)
    head[:4] = b"DDF" + bytes([version])
    for offset, value in (
        (4, count), (12, int(high)), (16, beams), (24, ranges), (40, int(reverse)), (44, serial),
    ):  # fmt: skip
        struct.pack_into("<i", head, offset, value)
    struct.pack_into("<f", head, 20, 48000.0)
    parts = [bytes(head)]
    for number, frame in enumerate(samples):
        header = bytearray(frame_size)
        struct.pack_into("<8i", header, 16, 0, year, 6, 15, 12, 30, 45 + number, 25)
        put = ((0, number), (4, 1_400_000_000), (52, 4), (56, code), (68, 30), (192, flags))
        for offset, value in put:
            struct.pack_into("<i", header, offset, value)
        struct.pack_into("<f", header, 152, 200.0)
        parts += [bytes(header), (frame if reverse else frame[:, ::-1]).tobytes()]
    path.write_bytes(b"".join(parts))
    return path


def write_oculus(
    path: Path,
    samples: npt.NDArray[np.unsignedinteger],
    *,
    version: int = 1,
    gains: bool = False,
    others: bool = True,
) -> Path:
    """Raw Oculus pings of 2 cm a range from -30 to 30 degrees, among messages of another kind."""
    parts = []
    for frame in samples:
        ranges, beams = frame.shape
        rows = [b"\1\2\3\4" * gains + row.tobytes() for row in frame]
        bearings = np.linspace(-3000, 3000, beams).astype("<i2").tobytes()
        fire = struct.pack("<5B4d", 2, 0, 0, 127, 0x19 | 4 * gains, 5.0, 50.0, 0.0, 35.0)
        bits = frame.dtype.itemsize - 1
        size = 202 if version == 2 else 122
        offset = size + len(bearings) + 6  # some bytes in between
        image = b"".join(rows)
        total = offset + len(image)
        if version == 2:
            body = fire + struct.pack("<9I", *range(9))
            body += struct.pack("<II8d", 1, 0, 1.2e6, 10.0, 1.0, 90.0, 3.0, -4.0, 1490.0, 77.5)
            body += struct.pack("<Bd2H7I", bits, 0.02, ranges, beams, 0, 0, 0, 0,
                                offset, len(image), total)  # fmt: skip
        else:
            body = fire + struct.pack("<II4dI", 1, 0, 1.2e6, 10.0, 1.0, 1490.0, 77)
            body += struct.pack("<Bd2H3I", bits, 0.02, ranges, beams, offset, len(image), total)
        body += bearings + bytes(6) + image
        code = 2 if version == 2 else 0
        parts.append(struct.pack("<5HIH", 0x4F53, 7892, 0, 0x23, code, len(body), 0) + body)
        if others:
            parts.append(struct.pack("<5HIH", 0x4F53, 7892, 0, 0xFF, 0, 3, 0) + b"abc")
    path.write_bytes(b"".join(parts))
    return path


def write_black_png(path: Path, side: int) -> Path:
    """A square image of zeros, a thousandth as large as what it unpacks to; never in memory."""
    packer = zlib.compressobj(1)
    rows = b"".join(packer.compress(bytes(side + 1)) for _ in range(side)) + packer.flush()
    chunks = [(b"IHDR", struct.pack(">IIBBBBB", side, side, 8, 0, 0, 0, 0)), (b"IDAT", rows)]
    parts = [b"\x89PNG\r\n\x1a\n"]
    for kind, content in (*chunks, (b"IEND", b"")):
        crc = zlib.crc32(kind + content)
        parts.append(struct.pack(">I", len(content)) + kind + content + struct.pack(">I", crc))
    path.write_bytes(b"".join(parts))
    return path


def write_stack(path: Path, pages: Any) -> Path:
    """A TIFF file of several pages, uint8, uint16 or float32; colours are BGR."""
    assert cv2.imwritemulti(str(path), list(pages))
    return path


def write_video(path: Path, frames: UInt8s) -> Path:
    """Motion JPEG in an AVI, ten frames a second."""
    height, width = frames.shape[1:3]
    code = cv2.VideoWriter.fourcc(*"MJPG")
    writer = cv2.VideoWriter(str(path), code, 10.0, (width, height))
    assert writer.isOpened()
    for frame in frames:
        writer.write(cv2.cvtColor(frame, cv2.COLOR_GRAY2BGR))
    writer.release()
    return path


def write_gif(path: Path, frames: Any) -> Path:
    """An animated GIF, grey or RGB."""
    first, *others = map(Image.fromarray, frames)
    first.save(path, save_all=True, append_images=others)
    return path


def write_log(path: Path, samples: UInt8s, *, packed: bool = False) -> Path:
    """A log of ViewPoint with a ping in every other item; each second later from 1.6e9 s on."""
    parts = [struct.pack("<2I16s2H4xqd", 0x11223344, 48, b"Oculus", 1, 0, 0, 1.6e9)]
    for number in range(len(samples)):
        message = write_oculus(path, samples[number : number + 1], others=False).read_bytes()
        stored = struct.pack(">I", len(message)) + zlib.compress(message) if packed else message
        for kind, content in ((1, b"settings"), (10, stored)):
            head = (0xAABBCCDD, 40, kind, 0, 1.6e9 + number, packed, len(message), len(content))
            parts.append(struct.pack("<2I2H4xdH2x2I4x", *head) + content)
    path.write_bytes(b"".join(parts))
    return path


def write_array(path: Path, images: Any, **others: Any) -> Path:
    """Images (N, H, W) or (N, H, W, 3) named `frames`, and what else lies beside them.

    a.npz, a.mat: compressed; b.npz, b.mat: plain.
    """
    arrays = {"frames": np.asarray(images), **others}
    plain = path.stem == "b"
    if path.suffix == ".npy":
        np.save(path, images)
    elif path.suffix == ".npz":
        (np.savez if plain else np.savez_compressed)(path, **arrays)
    else:
        named = {name: matlab(array) for name, array in arrays.items()}
        scipy.io.savemat(path, named, do_compression=not plain)
    return path


def matlab(array: Any) -> Any:
    """An array of images as MATLAB keeps them, the number of the image last."""
    array = np.asarray(array)
    return np.moveaxis(array, 0, -1) if array.ndim > 2 else array
