"""Picture files, one or a folder of them, in the order of their names."""

from __future__ import annotations

from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Self

import numpy as np
from PIL import Image

from simnfnd.factory.errors import FactoryError, FrameError
from simnfnd.factory.recordings.base import Frame, Samples

SUFFIXES = (".png", ".tif", ".tiff", ".jpg", ".jpeg", ".bmp")
MOST_PIXELS = 1 << 26
DTYPES = ("uint8", "uint16", "float32")


class Pictures:
    """A `Recording` of pictures as they are stored, (H, W) or (H, W, colours)."""

    def __init__(self, path: Path) -> None:
        """A file, or a folder with files right in it.  Raises FactoryError when there are none."""
        self.path = path
        self.warning = ""
        self.files = [path]
        if path.is_dir():
            found = sorted(path.iterdir())
            self.files = [one for one in found if one.suffix.lower() in SUFFIXES and one.is_file()]
        if not self.files or not self.files[0].is_file():
            raise FactoryError(f"{path}: holds no picture ({', '.join(SUFFIXES)})")

    def __len__(self) -> int:
        return len(self.files)

    def __getitem__(self, number: int) -> Frame:
        if not 0 <= number < len(self):
            raise IndexError(f"{self.path}: picture {number} of {len(self)}")
        path = self.files[number]
        try:
            content = path.read_bytes()
        except OSError as error:
            raise FrameError(f"{path}: not a readable picture ({error.strerror})") from error
        return Frame(number, decoded(content, str(path)))

    def __iter__(self) -> Iterator[Frame]:
        for number in range(len(self)):
            yield self[number]

    def close(self) -> None:
        """Nothing is held open."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def decoded(content: bytes, what: str) -> Samples:
    """The pixels of a picture file, (H, W) or (H, W, colours).

    what: names it in errors.  Raises FrameError when it cannot be read or is too large.
    """
    import cv2  # an extra

    try:
        # Its size first: a small file can decode to gigabytes.
        with Image.open(BytesIO(content)) as header:
            width, height = header.size
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise FrameError(f"{what}: not a readable picture") from error
    if width * height > MOST_PIXELS:
        raise FrameError(f"{what}: {width} x {height} pixels are more than can be read")
    try:
        picture = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        picture = None
    if picture is None:
        raise FrameError(f"{what}: not a readable picture")
    if str(picture.dtype) not in DTYPES:
        raise FrameError(f"{what}: pixels are {picture.dtype}; expected {', '.join(DTYPES)}")
    return np.asarray(picture)
