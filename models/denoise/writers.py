"""What `denoise` writes: pictures, videos and stacks without loss, and sheets to compare by."""

from __future__ import annotations

import glob
import os
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import cv2
import numpy as np
import numpy.typing as npt
from PIL import Image, TiffImagePlugin

from ...factory.errors import FrameError
from ...factory.files import explain_os_errors, write_atomically
from ...factory.quiet import quiet_stderr
from ..recordings.arrays import ArrayFile, NpyWriter
from ..recordings.base import FULL_SCALE, TIFF_SUFFIXES, Recording, swapped

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


class FrameFiles:
    """Takes the frames of a video in order; use it in a `with` statement.

    They become a video at `path` when its container has a codec without loss (any other would add
    artefacts of its own), the frame rate is known and both sides are even, as the writer cuts odd
    ones; pages of a TIFF file where `path` is one; a .npy file where `source` is an array;
    NNNNNN.png in a folder of that name otherwise.  Files appear when they are whole.
    """

    def __init__(self, path: Path, rate_hz: float | None, source: Recording | None = None) -> None:
        """rate_hz: frames a second; None: unknown.  source: whose frames they are."""
        self.path = path
        self.rate_hz = rate_hz
        self.count = 0
        self._writer: cv2.VideoWriter | None = None
        self._source = source
        self._stack: StackWriter | NpyWriter | None = None
        self._partial = path.with_name(f".{path.stem}.{os.getpid()}.tmp{path.suffix}")

    def add(self, picture: npt.NDArray[Any]) -> None:
        """The next frame, (H, W) or (H, W, 3) uint8; of TIFF and arrays also uint16 or float32.

        Raises FrameError when another file has the place of a folder.
        """
        if isinstance(self._source, ArrayFile):
            picture = picture.astype(self._source.header.dtype)
        if not self.count:
            self._open(picture)
        if self._stack is not None:
            with explain_os_errors(self.path, "--out"):
                self._stack.add(picture)
        elif self._writer is not None:
            grey = picture.ndim == 2
            self._writer.write(cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR) if grey else picture)
        else:
            done, content = cv2.imencode(".png", picture)
            assert done
            write_atomically(self.path / f"{self.count:06d}.png", content.tobytes(), key="--out")
        self.count += 1

    def _remove_stale(self) -> None:
        """What runs that were killed left of this very file."""
        for path in self.path.parent.glob(
            f".{glob.escape(self.path.stem)}.*.tmp{self.path.suffix}"
        ):
            number = path.name.removesuffix(f".tmp{self.path.suffix}").rpartition(".")[2]
            if number.isdecimal() and not Path("/proc", number).exists():
                path.unlink(missing_ok=True)

    def _open(self, picture: npt.NDArray[Any]) -> None:
        height, width = picture.shape[:2]
        code = CODECS.get(self.path.suffix.lower())
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self._remove_stale()
        if self.path.suffix.lower() in TIFF_SUFFIXES:
            self._stack = StackWriter(self._partial)
            return
        if isinstance(self._source, ArrayFile):
            with explain_os_errors(self.path, "--out"):
                self._stack = NpyWriter(self._partial, self._source.header)
            return
        if code and self.rate_hz and not (height % 2 or width % 2) and not self.path.is_dir():
            fourcc = cv2.VideoWriter.fourcc(*code)
            # OpenCV tells everybody that MP4 has another name for PNG.
            with quiet_stderr():
                writer = cv2.VideoWriter(str(self._partial), fourcc, self.rate_hz, (width, height))
            if writer.isOpened():
                self._writer = writer
                return
            writer.release()
            self._partial.unlink(missing_ok=True)
        if self.path.is_file():
            raise FrameError(f"{self.path}: is there already; remove it, or give another --out")
        self.path.mkdir(exist_ok=True)

    def _finish(self) -> None:
        assert self._writer is not None
        self._writer.release()
        # The writer does not say when the disk is full.
        capture = cv2.VideoCapture(str(self._partial))
        held = int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
        capture.release()
        if held != self.count:
            raise FrameError(
                f"{self.path}: holds {max(held, 0)} of {self.count} frames; is the disk full?"
            )
        self._appear()

    def _appear(self) -> None:
        with explain_os_errors(self.path, "--out"):
            os.replace(self._partial, self.path)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            if self._stack is not None:
                with explain_os_errors(self.path, "--out"):
                    self._stack.close()
                if kind is None:
                    self._appear()
            elif self._writer is not None and kind is None:
                self._finish()
        finally:
            if self._writer is not None:
                self._writer.release()
            self._partial.unlink(missing_ok=True)


class StackWriter:
    """Takes pages in order, each compressed without loss; close it."""

    def __init__(self, path: Path) -> None:
        self._writer = TiffImagePlugin.AppendingTiffWriter(str(path), new=True)

    def add(self, picture: npt.NDArray[Any]) -> None:
        """The next page, (H, W) uint8, uint16 or float32 or (H, W, 3) uint8 BGR."""
        page = Image.fromarray(np.ascontiguousarray(swapped(picture)))
        page.save(self._writer, format="TIFF", compression="tiff_adobe_deflate")
        self._writer.newFrame()

    def close(self) -> None:
        """Write the end of the file."""
        self._writer.close()


def write_image(path: Path, image: npt.NDArray[Any]) -> None:
    """A picture by the suffix of its name.  FrameError when the format does not hold it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        done, content = cv2.imencode(path.suffix, image, _QUALITY.get(path.suffix.lower(), ()))
    except cv2.error:  # WebP has 8 bits alone
        done = False
    if not done:
        raise FrameError(f"{path}: {image.dtype} pixels do not fit this file format")
    write_atomically(path, content.tobytes())


def write_compared(path: Path, rows: Sequence[Sequence[npt.NDArray[Any]]]) -> None:
    """Noisy, denoised (and clean) side by side, one row a sample."""
    write_image(path, sheet(rows))


def sheet(rows: Sequence[Sequence[npt.NDArray[Any]]]) -> npt.NDArray[np.uint8]:
    """Noisy, denoised (and clean) side by side, one row a sample, named on top.

    rows: pictures (H, W) or (H, W, C) of one size; uint8, uint16 or float in 0..1.
    Returns (CAPTION_PX + rows * H, W', ...) uint8.
    """
    lines = [_side_by_side([_shown(image) for image in images]) for images in rows]
    first = _shown(rows[0][0])
    names = [_name(text, first) for text in _NAMES[: len(rows[0])]]
    return np.concatenate([_side_by_side(names), *lines], axis=0)


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
