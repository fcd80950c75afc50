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

Frames = Iterator[npt.NDArray[Any]]

CODECS = {".avi": "FFV1", ".mkv": "FFV1", ".mov": "FFV1", ".mp4": "png "}
"""Suffix of a container -> the codec without loss that it holds."""

COMPARED = 4
"""How many pictures of one file `--compare` shows."""

CAPTION_PX = 20
"""Height of the line with the names."""

_NAMES = ("noisy", "denoised", "clean")
_GAP_PX = 4
_FONT = cv2.FONT_HERSHEY_SIMPLEX

# JPEG is lossy at any quality; at 100 the least.  WebP is without loss above 100.
_QUALITY = {
    ".jpg": (cv2.IMWRITE_JPEG_QUALITY, 100),
    ".jpeg": (cv2.IMWRITE_JPEG_QUALITY, 100),
    ".webp": (cv2.IMWRITE_WEBP_QUALITY, 101),
}


def write_frames(
    path: Path,
    pictures: Iterable[npt.NDArray[Any]],
    rate_hz: float | None,
    source: Recording | None = None,
) -> None:
    """Write frames in order, (H, W) or (H, W, 3) uint8; of TIFF and arrays also uint16 or float32.

    They become a video at `path` when its container has a codec without loss (any other would add
    artefacts of its own), the frame rate is known and both sides are even, as the writer cuts odd
    ones; pages of a TIFF file where `path` is one; a .npy file where `source` is an array;
    NNNNNN.png in a folder of that name otherwise.  Files appear when they are whole.
    rate_hz: frames a second; None: unknown.  source: whose frames they are.
    Raises FrameError when another file has the place of a folder.
    """
    frames = iter(pictures)
    first = next(frames, None)
    if first is None:
        return
    frames = itertools.chain([first], frames)
    path.parent.mkdir(parents=True, exist_ok=True)
    _remove_stale(path)
    partial = path.with_name(f".{path.stem}.{os.getpid()}.tmp{path.suffix}")
    try:
        if path.suffix.lower() in TIFF_SUFFIXES:
            _write_pages(partial, frames, path)
        elif isinstance(source, ArrayFile):
            with explain_os_errors(path, "--out"), partial.open("wb") as file:
                write_array(file, frames, source.stored)
        elif (video := _video(partial, first.shape, rate_hz)) is not None and not path.is_dir():
            _write_video(partial, frames, path, video)
        else:
            _write_pictures(path, frames)
            return
        with explain_os_errors(path, "--out"):
            os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)


def _remove_stale(path: Path) -> None:
    """What runs that were killed left of this very file."""
    for stale in path.parent.glob(f".{glob.escape(path.stem)}.*.tmp{path.suffix}"):
        number = stale.name.removesuffix(f".tmp{path.suffix}").rpartition(".")[2]
        if number.isdecimal() and not Path("/proc", number).exists():
            stale.unlink(missing_ok=True)


def _write_pages(partial: Path, frames: Frames, path: Path) -> None:
    """Pages of a TIFF file, each compressed without loss."""
    with explain_os_errors(path, "--out"):
        writer = TiffImagePlugin.AppendingTiffWriter(str(partial), new=True)
    try:
        for picture in frames:
            page = Image.fromarray(np.ascontiguousarray(swapped(picture)))
            with explain_os_errors(path, "--out"):
                page.save(writer, format="TIFF", compression="tiff_adobe_deflate")
                writer.newFrame()
    finally:
        with explain_os_errors(path, "--out"):
            writer.close()


def _video(partial: Path, shape: tuple[int, ...], rate_hz: float | None) -> cv2.VideoWriter | None:
    """A writer without loss; None where the container, the rate or the size do not allow it."""
    code = CODECS.get(partial.suffix.lower())
    if not code or not rate_hz or shape[0] % 2 or shape[1] % 2:
        return None
    # OpenCV tells everybody that MP4 has another name for PNG.
    with quiet_stderr():
        fourcc = cv2.VideoWriter.fourcc(*code)
        writer = cv2.VideoWriter(str(partial), fourcc, rate_hz, (shape[1], shape[0]))
    return writer if writer.isOpened() else None


def _write_video(partial: Path, frames: Frames, path: Path, writer: cv2.VideoWriter) -> None:
    count = 0
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


def _write_pictures(path: Path, frames: Frames) -> None:
    if path.is_file():
        raise FrameError(f"{path}: is there already; remove it, or give another --out")
    path.mkdir(exist_ok=True)
    for number, picture in enumerate(frames):
        write_image(path / f"{number:06d}.png", picture)


def write_image(path: Path, image: npt.NDArray[Any]) -> None:
    """A picture by the suffix of its name.  FrameError when the format does not hold it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        done, content = cv2.imencode(path.suffix, image, _QUALITY.get(path.suffix.lower(), ()))
    except cv2.error:  # WebP has 8 bits alone
        done = False
    if not done:
        raise FrameError(f"{path}: {image.dtype} pixels do not fit this file format")
    write_atomically(path, content.tobytes(), key="--out")


def write_compared(path: Path, rows: Sequence[Sequence[npt.NDArray[Any]]]) -> None:
    """Noisy, denoised (and clean) side by side, one row a sample, named on top.

    rows: pictures (H, W) or (H, W, C) of one size; uint8, uint16 or float in 0..1.
    """
    lines = [_side_by_side([_shown(image) for image in images]) for images in rows]
    first = _shown(rows[0][0])
    names = [_name(text, first) for text in _NAMES[: len(rows[0])]]
    write_image(path, np.concatenate([_side_by_side(names), *lines], axis=0))


def _side_by_side(panels: Sequence[npt.NDArray[np.uint8]]) -> npt.NDArray[np.uint8]:
    gap = np.full((panels[0].shape[0], _GAP_PX, *panels[0].shape[2:]), 128, np.uint8)
    return np.concatenate([part for panel in panels for part in (gap, panel)][1:], axis=1)


def _name(text: str, like: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    """The text, light on dark, as wide as a panel and no wider than fits."""
    width = like.shape[1]
    band = np.full((CAPTION_PX, width), 24, np.uint8)
    (long, _), _ = cv2.getTextSize(text, _FONT, 1.0, 1)
    size = min(0.45, (width - 6) / long)
    if size > 0:
        cv2.putText(band, text, (3, CAPTION_PX - 6), _FONT, size, (235,), 1, cv2.LINE_AA)
    if like.ndim == 2:
        return band
    name = np.full((CAPTION_PX, width, like.shape[2]), 255, np.uint8)  # an alpha stays opaque
    name[..., :3] = band[..., None]
    return name


def _shown(image: npt.NDArray[Any]) -> npt.NDArray[np.uint8]:
    full = 1.0 if image.dtype.kind == "f" else FULL_SCALE[str(image.dtype)]
    return np.asarray(np.rint(np.clip(image / full, 0, 1) * 255), dtype=np.uint8)
