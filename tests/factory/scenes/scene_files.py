"""Small recordings as files: pictures, depth maps, trees of FLSea, a calibration."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image

from simnfnd.factory.scenes import Scenes, open_reader
from simnfnd.factory.scenes.base import Reader
from simnfnd.factory.settings import build

PINHOLE = [20.0, 20.0, 11.5, 7.5]

Array = npt.NDArray[Any]
RGB = np.arange(16 * 24 * 3, dtype=np.uint8).reshape(16, 24, 3)
DEPTH = np.linspace(0.5, 6, 16 * 24, dtype=np.float32).reshape(16, 24)


def reader(kind: str, root: Path, **values: object) -> Reader:
    settings: Any = build(Scenes, {"kind": kind, "root": str(root), **values}, "scenes")
    return open_reader(settings)


def write(path: Path, array: Array) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    options = {"compression": "tiff_lzw"} if path.suffix.startswith(".tif") else {}
    Image.fromarray(array).save(path, **options)
    return path


def flsea_frame(
    scene: Path, stamp: str, depth: Array | None = DEPTH, ending: str = "_SeaErra_abs_depth"
) -> None:
    write(scene / "imgs" / f"{stamp}.tiff", RGB)
    if depth is not None:
        write(scene / "depth" / f"{stamp}{ending}.tif", depth)


def names(reader: Reader) -> list[str]:
    return [ref.name for ref in reader.discover().frames]
