"""What `denoise` writes: pictures, videos and stacks without loss, and sheets to compare by."""

from __future__ import annotations

import glob
import itertools
import os
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from PIL import Image, TiffImagePlugin

from ...factory.errors import FrameError
from ...factory.files import explain_os_errors, write_atomically
from ...factory.quiet import quiet_stderr
from ..recordings.base import FULL_SCALE, TIFF_SUFFIXES, Recording, swapped
from ..recordings.pictures import ArrayFile, write_array

Picture = npt.NDArray[Any]
Frames = Iterator[Picture]

CODECS = {".avi": "FFV1", ".mkv": "FFV1", ".mov": "FFV1", ".mp4": "png "}
"""Suffix of a container -> the codec without loss that it holds."""
COMPARED = 4  # pictures of one file that `--compare` shows
CAPTION_PX = 20  # height of the line with the names
_NAMES = ("noisy", "denoised", "clean")
_GAP_PX = 4

# JPEG is lossy at any quality; at 100 the least.  WebP is without loss above 100.
_QUALITY = {
    ".jpg": (cv2.IMWRITE_JPEG_QUALITY, 100),
    ".jpeg": (cv2.IMWRITE_JPEG_QUALITY, 100),
    ".webp": (cv2.IMWRITE_WEBP_QUALITY, 101),
}


def write_frames(
    path: Path,
    pictures: Iterable[Picture],
    rate_hz: float | None,
    source: Recording | None = None,
) -> None:
    """Write frames in order, (H, W) or (H, W, 3) uint8; of TIFF and arrays also uint16 or float32.

    They become a video at `path` when its container has a codec without loss (any other would add
    artefacts of its own), the frame rate is known and both sides are even, as the writer cuts odd
    ones; pages of a TIFF file where `path` is one; a .npy file where `source` is an array;
    NNNNNN.png in a folder of that name otherwise.  Files appear when they are whole.
    rate_hz: frames a second; None: unknown.  source: whose frames they are.
    """
    frames = iter(pictures)
    first = next(frames, None)
    if first is None:
        return
    frames = itertools.chain([first], frames)
    is_video = path.suffix.lower() in CODECS and not path.is_dir()
    is_video = is_video and first.shape[0] % 2 == first.shape[1] % 2 == 0
    path.parent.mkdir(parents=True, exist_ok=True)
    for stale in path.parent.glob(f".{glob.escape(path.stem)}.*.tmp{path.suffix}"):
        stale.unlink(missing_ok=True)  # of a run that was killed
    partial = path.with_name(f".{path.stem}.{os.getpid()}.tmp{path.suffix}")
    with explain_os_errors(path, "--out"):
        try:
            if path.suffix.lower() in TIFF_SUFFIXES:
                with TiffImagePlugin.AppendingTiffWriter(str(partial), new=True) as pages:
                    for picture in frames:
                        page = Image.fromarray(np.ascontiguousarray(swapped(picture)))
                        page.save(pages, format="TIFF", compression="tiff_adobe_deflate")
                        pages.newFrame()
            elif isinstance(source, ArrayFile):
                with partial.open("wb") as file:
                    write_array(file, frames, source.stored)
            elif is_video and rate_hz:
                _write_video(partial, frames, path, first.shape, rate_hz)
            else:
                for number, picture in enumerate(frames):
                    write_image(path / f"{number:06d}.png", picture)
                return
            os.replace(partial, path)
        finally:
            partial.unlink(missing_ok=True)


def _write_video(
    partial: Path, frames: Frames, path: Path, shape: tuple[int, ...], rate_hz: float
) -> None:
    count, code = 0, cv2.VideoWriter.fourcc(*CODECS[path.suffix.lower()])
    # OpenCV tells everybody that MP4 has another name for PNG.
    with quiet_stderr():
        writer = cv2.VideoWriter(str(partial), code, rate_hz, (shape[1], shape[0]))
    try:
        for picture in frames:
            grey = picture.ndim == 2
            writer.write(cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR) if grey else picture)
            count += 1
    finally:
        writer.release()
    # The writer does not say when the disk is full.
    capture = cv2.VideoCapture(str(partial))
    held = int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
    capture.release()
    if held != count:
        raise FrameError(f"{path}: holds {max(held, 0)} of {count} frames; is the disk full?")


def write_image(path: Path, image: Picture) -> None:
    """A picture by the suffix of its name.  FrameError when the format does not hold it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        done, content = cv2.imencode(path.suffix, image, _QUALITY.get(path.suffix.lower(), ()))
    except cv2.error:  # WebP has 8 bits alone
        done = False
    if not done:
        raise FrameError(f"{path}: {image.dtype} pixels do not fit this file format")
    write_atomically(path, content.tobytes(), key="--out")


def write_compared(path: Path, rows: Sequence[Sequence[Picture]]) -> None:
    """Noisy, denoised (and clean) side by side, one row a sample, named on top.

    rows: pictures (H, W) or (H, W, C) of one size; uint8, uint16 or float in 0..1.
    """
    gap = np.full((len(rows[0][0]), _GAP_PX, 3), 128, np.uint8)
    lines = [
        np.hstack([part for image in images for part in (gap, _shown(image))][1:])
        for images in rows
    ]
    names = np.full((CAPTION_PX, lines[0].shape[1], 3), 24, np.uint8)
    width = rows[0][0].shape[1]
    for number, name in enumerate(_NAMES[: len(rows[0])]):
        left, font = 3 + number * (width + _GAP_PX), cv2.FONT_HERSHEY_SIMPLEX
        (long, _), _ = cv2.getTextSize(name, font, 1.0, 1)
        size = max(0.01, min(0.45, (width - 6) / long))  # no wider than its picture
        cv2.putText(names, name, (left, CAPTION_PX - 6), font, size, (235,) * 3, 1, cv2.LINE_AA)
    write_image(path, np.vstack([names, *lines]))


def _shown(image: Picture) -> Picture:
    """As (H, W, 3) uint8."""
    full = 1.0 if image.dtype.kind == "f" else FULL_SCALE[str(image.dtype)]
    levels = np.rint(np.clip(image / full, 0, 1) * 255).astype(np.uint8)
    return levels[..., :3] if levels.ndim == 3 else np.repeat(levels[..., None], 3, axis=2)
