"""Static recordings that targets can be inserted into."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from ...factory.common.array_types import Bools, Float32s
from ...factory.common.errors import FactoryError
from ...factory.dataset.fan_geometry import FanGeometry
from ...models.recordings.fan_finder import find_geometry
from ...models.recordings.static import find_groups
from ...models.recordings.views import presentation_of
from ..judging.recorded import Stretch
from ..metrics.measure import Grey
from ..metrics.statistics import evenly
from ..real.groups import sector_of
from .targets import Frames, blurred

LEAST_FRAMES = 20

_INSONIFIED_LEVELS = (16 / 255, 170 / 255)  # grey values of the smoothed mean of all frames
_INSONIFIED_SIGMA_PX = 2.0  # of its blur
_MARGIN_PX = 31  # side of the neighbourhood that has to be insonified as well
_SEARCHED_FRAMES = 5  # in which the fan is looked for, until it is found
_COMPARED_FRAMES = 12  # frames that are compared to tell whether the sonar is at rest
_SAME_SHARE = 0.75  # share of them that must show one scene
_FURTHEST_PX = 2.0  # how far the scene may shift between them


@dataclass(frozen=True, eq=False)
class StaticRecording:
    """Frames of a sonar at rest.

    frames: (N, H, W) float32 in 0..1.  insonified: (H, W) bool, where targets may be.
    full_scale: greatest level of the file; frames with targets are rounded to its levels.
    """

    name: str
    frames: Frames
    insonified: Bools
    geometry: FanGeometry | None
    full_scale: int

    def stored(self, frames: Frames) -> npt.NDArray[np.unsignedinteger]:
        """Frames as the recording would store them."""
        dtype = np.uint8 if self.full_scale == 255 else np.uint16
        levels: npt.NDArray[np.unsignedinteger] = np.rint(frames * self.full_scale).astype(dtype)
        return levels


def open_static(stretch: Stretch, frame_limit: int) -> StaticRecording:
    """The first frames of a recording.

    Raises FactoryError for one that moves, is too short, or shows no insonified area.
    """
    name = stretch.name
    shots = stretch.shots[:frame_limit]
    if len(shots) < LEAST_FRAMES:
        raise FactoryError(
            f"{name}: has {len(shots)} frames; targets need a static recording of at least "
            f"{LEAST_FRAMES}"
        )
    images: list[Grey] = []
    for shot in shots:
        image, geometry = shot.read()
        if images and image.shape != images[0].shape:
            raise FactoryError(
                f"{name}: {shot.name} has {image.shape[1]}x{image.shape[0]} pixels, the first "
                f"frame {images[0].shape[1]}x{images[0].shape[0]}; give frames of one size"
            )
        images.append(image)
    frames = np.stack(images)
    # A dark recording is brightened as for display.
    gain = presentation_of(frames.mean(axis=0), None).gain
    frames = np.minimum(frames * gain, np.float32(1))
    if geometry is None:
        geometry = _find_fan(frames)
    insonified = insonified_area(frames)
    if not insonified.any():
        raise FactoryError(
            f"{name}: no insonified area is {_MARGIN_PX} pixels wide; give larger or brighter "
            "frames"
        )
    check_static(name, frames, sector_of(frames[0], geometry))
    eight_bits = np.allclose(frames[0] * 255, np.rint(frames[0] * 255), atol=1e-3)
    return StaticRecording(name, frames, insonified, geometry, 255 if eight_bits else 65535)


def _find_fan(frames: Frames) -> FanGeometry | None:
    """The fan of a recording, which may begin with a title."""
    for number in evenly(range(len(frames)), _SEARCHED_FRAMES):
        geometry = find_geometry(frames[number])
        if geometry is not None:
            return geometry
    return None


def insonified_area(frames: Frames) -> Bools:
    """(H, W) bool: neither dark nor saturated, with a margin."""
    level = blurred(frames.mean(axis=0), _INSONIFIED_SIGMA_PX)
    lowest, highest = _INSONIFIED_LEVELS
    is_insonified = ((level > lowest) & (level < highest)).astype(np.uint8)
    return cv2.erode(is_insonified, np.ones((_MARGIN_PX, _MARGIN_PX), np.uint8)) > 0


def check_static(name: str, frames: Frames, sector: Bools) -> None:
    """Raises FactoryError for a recording whose sonar moves."""
    numbers = evenly(range(len(frames)), _COMPARED_FRAMES)
    compared: Sequence[Float32s] = [frames[number] for number in numbers]
    sectors = [sector] * len(numbers)
    least = int(np.ceil(_SAME_SHARE * len(numbers)))
    if not find_groups(compared, sectors, least=least, furthest_px=_FURTHEST_PX):
        raise FactoryError(
            f"{name}: the sonar moves; targets are inserted into static recordings alone, give "
            "a stretch in which it is at rest"
        )
