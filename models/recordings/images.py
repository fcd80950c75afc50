"""Image files, one or a folder of them by name."""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import IO

import cv2
import numpy as np
from PIL import Image

from ...factory.common.array_types import Array
from ...factory.common.errors import FactoryError, FrameError
from ...factory.common.quiet import quiet_stderr
from .arrays import ArrayFile, is_table
from .base import (
    ARRAY_SUFFIX,
    IMAGE_SUFFIXES,
    TOO_LARGE,
    Recording,
    SonarFrame,
    as_samples,
    ask_pixels,
    explained,
)
from .names import in_order
from .orientation import EXIF_ORIENTATION, UPRIGHT, Orientation, orientation_of_exif
from .portable_maps import decode_portable, portable_header
from .tiff_files import TIFF_HEADS, read_tiff


class ImageFiles(Recording):
    """A `Recording` of image files: one, those given, or all right in a folder, by name.

    Those of a folder come in the order of their sequences, see `names`.
    """

    def __init__(self, path: Path, files: Sequence[Path] = ()) -> None:
        """files: below the folder `path`.  Raises FactoryError when there are none."""
        self._listed_files = files
        super().__init__(path)

    def _open(self) -> None:
        self.files = list(self._listed_files) or [self.path]
        if self.path.is_dir() and not self._listed_files:
            files = sorted(file for file in self.path.iterdir() if file.is_file())
            kinds = IMAGE_SUFFIXES
            images = [file for file in files if file.suffix.lower() in kinds]
            self.files = in_order([file for file in images if not is_table(file)])
        self.count = len(self.files)
        if not self.count:
            raise FactoryError(f"{self.path}: holds no image ({', '.join(IMAGE_SUFFIXES)})")

    def _read(self, number: int) -> SonarFrame:
        return SonarFrame(number, read_image(self.files[number]))


def read_image(path: Path) -> Array:
    """The pixels of a file as stored, (H, W) or (H, W, colours).  Raises FrameError; see `decoded`.

    Of a TIFF of several pages, and of an array of several images, the first.
    """
    if path.suffix.lower() == ARRAY_SUFFIX:
        with explained(f"{path}: not a readable array"), ArrayFile(path) as array:
            return array[0].samples
    try:
        with path.open("rb") as file:
            is_tiff = file.read(4) in TIFF_HEADS
        content = b"" if is_tiff else path.read_bytes()
    except OSError as error:
        raise FrameError(f"{path}: not a readable image ({error.strerror})") from error
    if is_tiff:
        return read_tiff(path)
    return decoded(content, str(path))


def decoded(content: bytes, name: str) -> Array:
    """The pixels of an image file, (H, W) or (H, W, colours), as people should see it.

    name: names it in errors.  Raises FrameError when it cannot be read or is too large.
    """
    map_header = portable_header(content)
    if map_header is not None:
        return decode_portable(content, map_header, name)
    # Its size first: a small file can decode to gigabytes.
    with _opened(BytesIO(content), name) as header:
        ask_pixels(name, *header.size)
        orientation = _orientation_of(header)
    # libjpeg writes to the terminal about damage that it passes over.
    with explained(f"{name}: not a readable image"), quiet_stderr():
        image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise FrameError(f"{name}: not a readable image")
    return as_samples(orientation.upright(np.asarray(image)), name)


def _orientation_of(header: Image.Image) -> Orientation:
    """Orientation that the tag of an image file states; upright where it is damaged."""
    try:
        with explained("no Exif"):
            return orientation_of_exif(header.getexif().get(EXIF_ORIENTATION))
    except FrameError:
        return UPRIGHT


def _opened(file: IO[bytes], name: str) -> Image.Image:
    """An image whose pixels are not read yet.  Raises FrameError."""
    with explained(f"{name}: not a readable image"):
        try:
            return Image.open(file)
        except Image.DecompressionBombError as error:
            raise FrameError(f"{name}: {TOO_LARGE}") from error
