"""The images of the camera that `dataset.layers` asks for: rgb and depth."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from functools import cached_property
from typing import TYPE_CHECKING, Protocol

import numpy as np

from ...common.array_types import Array
from ...common.errors import FactoryError, FrameError
from ...dataset.frame_ref import FrameRef
from ...dataset.schema import CAMERA_LAYERS
from ..frames.frame import Frame

if TYPE_CHECKING:
    from ..config.root import FactoryConfig
    from ..scenes import Reader

Frames = tuple[FrameRef, ...]
Choose = Callable[[Frames, "FactoryConfig"], Frames]


class CameraLayers(Protocol):
    """Gives the images of the camera that `dataset.layers` asks for."""

    def layers(self, ref: FrameRef) -> Mapping[str, Array]:
        """The requested of rgb (H, W, 3) uint8 and depth (H, W) float32, m, NaN where unknown."""


def camera_images(frame: Frame, names: Collection[str]) -> Mapping[str, Array]:
    """The images of rgb and depth that are among `names`; see `CameraLayers`."""
    depth_m = np.where(frame.valid, frame.depth_m, np.float32(np.nan))
    images = {"rgb": frame.rgb, "depth": depth_m}
    return {name: image for name, image in images.items() if name in names}


class FrameCamera:
    """The camera's images of one frame in memory."""

    def __init__(self, frame: Frame, names: Collection[str]) -> None:
        self._frame = frame
        self._names = names

    def layers(self, ref: FrameRef) -> Mapping[str, Array]:
        """See `CameraLayers`."""
        return camera_images(self._frame, self._names)


class Camera:
    """The layers rgb and depth of frames.

    A render has lost the colour and rounds the depth, so frames whose images are asked for are
    read, or made, once more.
    """

    def __init__(self, config: FactoryConfig, chosen: Choose) -> None:
        """Reads nothing where `dataset.layers` asks for none.  chosen: frames of those found."""
        self._config = config
        self._chosen = chosen
        self._requested = CAMERA_LAYERS.intersection(config.dataset.layers)

    def layers(self, ref: FrameRef) -> Mapping[str, Array]:
        """The requested of rgb (H, W, 3) uint8 and depth (H, W) float32, m, NaN where unknown.

        Raises FrameError when the frame is bad, or of another size than the first frame of the
        dataset: its images have one size.
        """
        if not self._requested:
            return {}
        frame = self._reader.load(ref)
        # Procedural frames all have the size of the settings, and take long to make.
        if self._config.scenes.kind != "seabed":
            self._check_size(ref, frame.depth_m.shape)
        return camera_images(frame, self._requested)

    def _check_size(self, ref: FrameRef, size: tuple[int, ...]) -> None:
        """Raise FrameError unless the frame is as large, (H, W), as the dataset's first."""
        first_ref, first_size = self._first
        if size == first_size:
            return

        size_text = "x".join(map(str, reversed(size)))
        first_size_text = "x".join(map(str, reversed(first_size)))
        raise FrameError(
            f"{ref.name}: its image is {size_text}, that of {first_ref.name} {first_size_text}; "
            "make one dataset of each size (scenes, frames.only), or leave "
            f"{', '.join(sorted(self._requested))} out of dataset.layers"
        )

    @cached_property
    def _reader(self) -> Reader:
        from ..scenes import open_reader

        return open_reader(self._config.scenes)

    @cached_property
    def _first(self) -> tuple[FrameRef, tuple[int, ...]]:
        """The first readable frame and its (H, W), the same in all processes."""
        for ref in self._chosen(self._reader.discover().frames, self._config):
            with suppress(FrameError):
                return ref, self._reader.load(ref).depth_m.shape
        raise FactoryError("dataset.layers: no frame of the recordings can be read")
