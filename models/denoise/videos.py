"""Denoised frames as a video or stack without loss, or as PNG files where neither holds them."""

from __future__ import annotations

import os
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
from ..recordings.base import TIFF_SUFFIXES, Recording
from ..recordings.levels import swapped
from ..recordings.pictures import StackFile

CODECS = {".avi": "FFV1", ".mkv": "FFV1", ".mov": "FFV1", ".mp4": "png "}
"""Suffix of a container -> the codec without loss that it holds."""


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
        if isinstance(self._source, ArrayFile | StackFile):
            picture = self._source.stored(self.count, picture)
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

    def _open(self, picture: npt.NDArray[Any]) -> None:
        height, width = picture.shape[:2]
        code = CODECS.get(self.path.suffix.lower())
        self.path.parent.mkdir(parents=True, exist_ok=True)
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
