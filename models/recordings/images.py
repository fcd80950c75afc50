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
    swapped,
)
from .names import in_order
from .orientation import EXIF_ORIENTATION, UPRIGHT, Orientation, orientation_of_exif
from .portable_maps import decode_portable, portable_header
from .tiff import BITS, ORIENTATION, TIFF_HEADS, Directory, directories_of, with_upright_tags


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
        content = path.read_bytes()
    except OSError as error:
        raise FrameError(f"{path}: not a readable image ({error.strerror})") from error
    return decoded(content, str(path))


def decoded(content: bytes, name: str) -> Array:
    """The pixels of an image file, (H, W) or (H, W, colours), as people should see it.

    name: names it in errors.  Raises FrameError when it cannot be read or is too large.
    """
    map_header = portable_header(content)
    if map_header is not None:
        return decode_portable(content, map_header, name)
    # Its size first: a small file can decode to gigabytes.
    directory: Directory | None = None
    if content[:4] in TIFF_HEADS:
        content, directory = _tiff_header(content, name)
        orientation = orientation_of_exif(directory.number(ORIENTATION, 1))
    else:
        with _opened(BytesIO(content), name) as header:
            ask_pixels(name, *header.size)
            orientation = _orientation_of(header)
    if directory is not None and directory.is_planar and directory.number(BITS, 8) > 8:
        return as_samples(orientation.upright(read_page(BytesIO(content), name)), name)
    # libjpeg and libtiff write to the terminal about damage that they pass over.
    with explained(f"{name}: not a readable image"), quiet_stderr():
        image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
        if image is None and directory is not None:
            image = read_page(BytesIO(content), name)
    if image is None:
        raise FrameError(f"{name}: not a readable image")
    pixels: Array = np.asarray(image)
    if directory is not None and directory.is_white_zero:
        pixels = with_white_zero(pixels)
    return as_samples(orientation.upright(pixels), name)


def read_page(file: Path | IO[bytes], name: str, page: int = 0) -> Array:
    """A page of a TIFF file of a kind that OpenCV and Pillow misread, (H, W) or (H, W, C) BGR.

    They take colours of 16 bits that lie one behind the other for interleaved ones, and do not
    know small tiles and floats of 16 bits.  name: names the file in errors.  Raises FrameError.
    """
    import tifffile

    with explained(f"{name}: cannot be read", reason=True), tifffile.TiffFile(file) as tiff:
        tiff_page = tiff.pages[page]
        pixels = np.asarray(tiff_page.asarray())
        is_planar = pixels.ndim == 3 and tiff_page.axes.startswith("S")
        if is_planar:
            pixels = np.moveaxis(pixels, 0, -1)
        return np.ascontiguousarray(swapped(pixels))


def with_white_zero(page: Array) -> Array:
    """A page in which 0 is white as one in which it is black; floats are in 0..1."""
    white = np.iinfo(page.dtype).max if page.dtype.kind == "u" else page.dtype.type(1)
    return np.asarray(white - page, page.dtype)


def _tiff_header(content: bytes, name: str) -> tuple[bytes, Directory]:
    """The file with its first page said to be upright, and what it says of this page.

    OpenCV turns some pages itself and fails at others.
    """
    directories, _ = directories_of(BytesIO(content), len(content), most=1)
    if not directories:
        raise FrameError(f"{name}: not a readable image; it is damaged or cut short")
    ask_pixels(name, *directories[0].size)
    return with_upright_tags(content, directories[0]), directories[0]


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
