"""What the camera saw: layers rgb and depth, and columns of `/meta` with its intrinsics.

A render has lost the colour and rounds the depth, so frames whose pictures are asked for are read,
or made, once more.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from ..dataset.schema import CAMERA_LAYERS, Column
from ..errors import FactoryError, FrameError
from ..frame import Frame, FrameRef

if TYPE_CHECKING:
    from ..config import FactoryConfig
    from ..scenes import Reader

Picture = npt.NDArray[np.generic]
Frames = tuple[FrameRef, ...]
Choose = Callable[[Frames, "FactoryConfig"], Frames]

_LENS = (
    *(("fx", "px", "focal length across"), ("fy", "px", "focal length down")),
    *(("cx", "px", "column of the principal point"), ("cy", "px", "row of the principal point")),
    *(("k1", "1", "radial distortion r^2"), ("k2", "1", "radial distortion r^4")),
    *(("p1", "1", "tangential distortion"), ("p2", "1", "tangential distortion")),
)
COLUMNS = tuple(
    Column(f"camera.{name}{'_px' * (unit == 'px')}", "f8", unit, f"{what}, as OpenCV defines it")
    for name, unit, what in _LENS
)
"""Of the picture in rgb and depth; distortion is 0 where it was taken out or is not known."""


def row(frame: Frame) -> dict[str, float]:
    """The values of `COLUMNS` for a frame."""
    lens = frame.intrinsics
    numbers = (lens.fx, lens.fy, lens.cx, lens.cy, *lens.distortion, 0.0, 0.0, 0.0, 0.0)
    return {column.name: float(n) for column, n in zip(COLUMNS, numbers, strict=False)}


class Camera:
    """Gives the pictures of frames."""

    def __init__(self, config: FactoryConfig, chosen: Choose) -> None:
        """Reads nothing where `dataset.layers` asks for none.  chosen: frames of those found."""
        self._config, self._chosen = config, chosen
        self._requested = CAMERA_LAYERS.intersection(config.dataset.layers)

    def layers(self, ref: FrameRef) -> Mapping[str, Picture]:
        """The requested of rgb (H, W, 3) uint8 and depth (H, W) float32, m, NaN where unknown.

        Raises FrameError when the frame is bad, or of another size than the first frame of the
        dataset: its pictures have one size.
        """
        if not self._requested:
            return {}
        frame = self._reader.load(ref)
        # Procedural frames are as large as the settings say, and take long to make.
        if self._config.scenes.kind != "seabed" and frame.depth_m.shape != self._first[1]:
            name, size = self._first
            raise FrameError(
                f"{ref.name}: the camera's picture is {_text(frame.depth_m.shape)}, that of {name} "
                f"{_text(size)}; make one dataset of each size (scenes, frames.only), or leave "
                f"{', '.join(sorted(self._requested))} out of dataset.layers"
            )
        depth_m = np.where(frame.valid, frame.depth_m, np.float32(np.nan))
        pictures: dict[str, Picture] = {"rgb": frame.rgb, "depth": depth_m}
        return {name: picture for name, picture in pictures.items() if name in self._requested}

    @cached_property
    def _reader(self) -> Reader:
        from ..scenes import open_reader

        return open_reader(self._config.scenes)

    @cached_property
    def _first(self) -> tuple[str, tuple[int, ...]]:
        """Name and (H, W) of the first frame that can be read; of all processes the same."""
        for ref in self._chosen(self._reader.discover().frames, self._config):
            try:
                return ref.name, self._reader.load(ref).depth_m.shape
            except FrameError:
                continue
        raise FactoryError("dataset.layers: no frame of the recordings can be read")  # one was


def _text(size: tuple[int, ...]) -> str:
    return f"{size[1]}x{size[0]}"
