"""Folders of real sonar images as training data."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from simnfnd.factory.errors import FactoryError
from simnfnd.models.data.pairs import Image, Sample, SampleRef

IMAGE_SUFFIXES = (".png", ".tif", ".tiff", ".jpg", ".jpeg", ".bmp")
FULL_SCALE = {"uint8": 255.0, "uint16": 65535.0, "float32": 1.0}
"""dtype -> grey value of full scale, of the pixels that are read and written."""


def list_images(folder: str | Path, key: str = "data.folder") -> tuple[SampleRef, ...]:
    """The images of a folder and its subfolders, in the order of their names.

    `scene` is the subfolder.  Raises FactoryError, naming `key`, when there is none.
    """
    root = Path(folder).expanduser()
    if not root.is_dir():
        raise FactoryError(f"{key}={folder}: no such folder")
    found = [
        path
        for path in sorted(root.rglob("*"))
        if path.suffix.lower() in IMAGE_SUFFIXES and path.is_file()
    ]
    if not found:
        raise FactoryError(f"{key}={folder}: holds no image ({', '.join(IMAGE_SUFFIXES)})")
    return tuple(
        SampleRef(path, 0, path.parent.relative_to(root).as_posix(), path.name) for path in found
    )


def decode(path: Path) -> npt.NDArray[Any]:
    """An image as stored: (H, W) or (H, W, C).  Raises FactoryError when it cannot be read."""
    try:
        content = np.frombuffer(path.read_bytes(), dtype=np.uint8)
    except OSError as error:
        raise FactoryError(f"{path}: cannot be read ({error.strerror})") from error
    image = cv2.imdecode(content, cv2.IMREAD_UNCHANGED) if content.size else None
    if image is None:
        raise FactoryError(f"{path}: not a readable image")
    return image


def read_grey(path: Path) -> Image:
    """An image as (H, W) float32 in 0..1; colours become their luminance.  Raises FactoryError."""
    image = decode(path)
    full = FULL_SCALE.get(str(image.dtype))
    if full is None:
        raise FactoryError(f"{path}: pixels are {image.dtype}; expected {', '.join(FULL_SCALE)}")
    if image.ndim == 3:
        image = cv2.cvtColor(image[..., :3], cv2.COLOR_BGR2GRAY)
    grey = image.astype(np.float32) / np.float32(full)
    if not (grey.min() >= 0 and grey.max() <= 1):
        raise FactoryError(f"{path}: float pixels must lie in 0..1")
    return grey


def smallest_side(samples: tuple[SampleRef, ...]) -> tuple[int, SampleRef]:
    """The shortest side of all images, pixels, and the image that has it."""
    sides = [(min(decode(sample.path).shape[:2]), sample) for sample in samples]
    return min(sides, key=lambda found: found[0])


class NoisySource:
    """`data=self_supervised`: real images as they are; a `simnfnd.models.data.pairs.Source`."""

    def __init__(self, samples: tuple[SampleRef, ...]) -> None:
        self.samples = samples

    def __len__(self) -> int:
        return len(self.samples)

    def sample(self, index: int, visit: int | None) -> Sample:
        """See `Source`."""
        return Sample(read_grey(self.samples[index].path))
