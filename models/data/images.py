"""Real sonar images as training data: pictures of folders, and frames of recordings."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path

from ...factory.errors import FactoryError
from ...factory.files import sha256_of
from ...factory.sonar.geometry import FanGeometry
from ..recordings import (
    PICTURE_SUFFIXES,
    is_recording,
    kind_of,
    open_recording,
)
from ..recordings.pictures import read_grey
from ..recordings.views import frame_picture
from .pairs import Image, SampleRef


def list_images(folder: str | Path, key: str = "data.folder") -> tuple[SampleRef, ...]:
    """The images of a folder and its subfolders and the frames of recordings in it, by name.

    folder: or one recording.  `scene` is the subfolder, and of a frame the recording.
    Raises FactoryError, naming `key`, when there is none.
    """
    root = Path(folder).expanduser()
    if is_recording(root):
        return _frames(root, root.name)
    if not root.is_dir():
        raise FactoryError(f"{key}={folder}: no such folder or recording")
    found: list[SampleRef] = []
    for path in sorted(root.rglob("*")):
        place = path.parent.relative_to(root).as_posix()
        if path.is_file() and is_recording(path):
            found += _frames(path, path.relative_to(root).as_posix())
        elif path.is_file() and kind_of(path) == "pictures":
            found.append(SampleRef(path, 0, place, path.name))
    if not found:
        kinds = ", ".join(PICTURE_SUFFIXES)
        raise FactoryError(f"{key}={folder}: holds no image ({kinds}) and no recording")
    return tuple(found)


def _frames(path: Path, scene: str) -> tuple[SampleRef, ...]:
    with open_recording(path) as recording:
        count = len(recording)
    return tuple(SampleRef(path, row, scene, f"{path.name}#{row}") for row in range(count))


def read_sample(sample: SampleRef) -> tuple[Image, FanGeometry | None]:
    """An image as (H, W) float32 in 0..1, and its geometry where its recording tells it.

    A ping becomes a fan.  Raises FactoryError when it cannot be read.
    """
    if not is_recording(sample.path):
        return read_grey(sample.path), None
    return frame_picture(sample.path, sample.row)


def smallest_side(samples: tuple[SampleRef, ...]) -> tuple[int, SampleRef]:
    """The shortest side of all images, pixels, and the image that has it."""
    # The frames of a recording are of one size, or nearly.
    firsts = [one for one in samples if one.row == 0]
    sides = [(min(read_sample(one)[0].shape), one) for one in firsts]
    return min(sides, key=lambda found: found[0])


def digest_of(samples: Sequence[SampleRef]) -> str:
    """Changes with the names and the content of image files, not with where they lie."""
    hashes = {path: sha256_of(path) for path in {sample.path for sample in samples}}
    found = [(sample.scene, sample.frame, hashes[sample.path]) for sample in samples]
    return hashlib.blake2b(repr(found).encode(), digest_size=8).hexdigest()
