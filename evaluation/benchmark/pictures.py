"""Pictures of the benchmark on disk, and what they are known by."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from ...factory.errors import FactoryError
from ...factory.files import write_atomically
from ...factory.small_files import one_line, read_regular

Pixels = npt.NDArray[Any]
Gray8 = npt.NDArray[np.uint8]

_MOST_BYTES = 1 << 27
_FULL = {"uint8": 255.0, "uint16": 65535.0, "bool": 1.0}


def digest_of(picture: Pixels) -> str:
    """SHA-256 of the pixels and their size; the same whatever program compressed the file."""
    height, width = picture.shape
    head = f"{height}x{width} {picture.dtype}\n".encode()
    return hashlib.sha256(head + np.ascontiguousarray(picture).tobytes()).hexdigest()


def in_8_bits(picture: Pixels, what: str) -> Gray8:
    """(H, W) uint8 of uint8, uint16, or floats in 0..1 (clipped).

    what: named in the FactoryError for other types, and for NaN.
    """
    if picture.dtype == np.uint8:
        return np.ascontiguousarray(picture)
    if picture.dtype.kind != "f" and picture.dtype != np.uint16:
        raise FactoryError(f"{what}: {picture.dtype} pixels; expected uint8, or floats in 0..1")
    if not np.isfinite(picture).all():
        raise FactoryError(f"{what}: has NaN or infinite pixels")
    full = 1.0 if picture.dtype.kind == "f" else 65535.0
    return np.asarray(np.rint(np.clip(picture / full, 0, 1) * 255), np.uint8)


def in_unit_range(picture: Pixels) -> npt.NDArray[np.float32]:
    """(H, W) float32 in 0..1 of a stored picture."""
    return picture.astype(np.float32) / np.float32(_FULL[str(picture.dtype)])


def write(path: Path, picture: Pixels) -> str:
    """Write a picture as PNG, a mask (bool) as 0 and 255; returns its digest."""
    stored = picture.astype(np.uint8) * 255 if picture.dtype == bool else picture
    done, content = cv2.imencode(".png", stored)
    assert done
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, content.tobytes(), durable=False, key="--out")
    return digest_of(stored)


def read(path: Path, wanted: str | None = None) -> Pixels:
    """(H, W) uint8 or uint16 of a file; of equal colours one.

    wanted: the digest that it must have.
    Raises FactoryError when it is no grey picture, or another one.
    """
    try:
        content = read_regular(path, _MOST_BYTES)
    except OSError as error:
        raise FactoryError(f"{path}: cannot be read ({one_line(error)})") from error
    found = (
        cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED) if content else None
    )
    if found is None or str(found.dtype) not in ("uint8", "uint16"):
        raise FactoryError(f"{path}: not a picture of 8 or 16 bits")
    if found.ndim == 3:
        colours = found[..., : 3 if found.shape[2] > 2 else 1]
        if not (colours == colours[..., :1]).all():
            raise FactoryError(f"{path}: in colour; sonar pictures are grey, convert it first")
        found = np.ascontiguousarray(colours[..., 0])
    if wanted is not None and digest_of(found) != wanted:
        raise FactoryError(
            f"{path}: not the picture of this benchmark (its hash differs); make the folder anew"
        )
    return found
