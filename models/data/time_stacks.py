"""Means of frames as training images: of static recordings, and of drawn images.

In time, the static part is the target: the mean of other frames of a recording, or a drawn
image with its speckle under fresh noise.  A network that learns it removes from an average the
noise that is left and keeps what averaging has brought out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from ...factory.common.array_types import Float32s, UInt8s
from ...factory.common.errors import FactoryError
from ...factory.common.seeds import stream
from ...factory.dataset.fan_geometry import FanGeometry
from ..networks import averaged
from ..recordings.fan_finder import find_geometry
from ..recordings.static import find_groups, shifted
from ..recordings.views import presentation_of
from ..settings import MixedData
from .images import list_images, read_sample
from .pairs import ImageSource, SampleRef, TrainingImage
from .targets import draw_targets, insert_targets
from .water import with_water

_LEAST_FRAMES = 10
"""Frames of a recording that can be a target: the mean of two or five keeps the speckle of a static
scene, and a network learns to leave it (docs/research/real-sonar.md, bright ranges)."""
_ALIKE = 0.75  # likeness of two frames in a row from which on a recording is static
_AROUND = 25  # frames before and after whose mean is a target
_MOST = 7  # frames that are averaged, at most; of short recordings half of them
_MOVED = 0.045  # difference of smoothed means that says that something moved
_SINGLE = 0.4  # part of the visits of a recording that show a single frame
_UNEVEN = 0.45  # part of the means with uneven weights
_OFF = 0.25  # part of the means that contain misaligned frames
_OFF_PX = 0.5  # standard deviation of their misalignment
_AS_RECORDED = 0.4  # part of the visits of a recording that are not shown at another size and gain
_SCALES = (0.55, 1.15)
_GAINS = (0.5, 1.3)
# log2 of the frames from which on a pixel has its full weight in the loss.  A single frame amid
# several has none, for its target has speckle that may go.
_FULL = 0.7


@dataclass(frozen=True, eq=False)
class Stack:
    """The frames of a static recording, (T, H, W) uint8, ten or more."""

    frames: UInt8s
    geometry: FanGeometry

    def sample(self, rng: np.random.Generator) -> TrainingImage:
        """A single frame or a mean of several, towards the mean of others, NaN where unknown."""
        count = len(self.frames)
        most = min(_MOST, count // 2)
        if rng.random() < _SINGLE:
            number = int(rng.integers(count))
            grey = _grey(self.frames[number])
            return TrainingImage(grey, self._target([number]), None, self.geometry)
        several = int(rng.integers(2, most + 1))
        first = int(rng.integers(count - several + 1))
        members = list(range(first, first + several))
        others = np.delete(np.arange(several), rng.integers(several))
        stack = _grey(self.frames[members])
        if rng.random() < _OFF:
            for number in others:
                stack[number] = shifted(stack[number], rng.uniform(-_OFF_PX, _OFF_PX, 2))
        weights = np.ones_like(stack)
        if rng.random() < _UNEVEN:
            weights[others] = smooth_field(rng, stack.shape[1:])
        weights /= weights.sum(axis=0)
        mean = np.asarray((weights * stack).sum(axis=0), np.float32)
        frames = averaged(1 / np.square(weights).sum(axis=0))
        return TrainingImage(mean, self._target(members), None, self.geometry, frames)

    def _target(self, members: Sequence[int]) -> Float32s:
        """The mean of frames around the members, NaN where something moved."""
        near = members[0] - _AROUND
        far = members[-1] + _AROUND + 1
        inside = [i for i in range(max(0, near), min(len(self.frames), far)) if i not in members]
        target = self.frames[inside].mean(axis=0, dtype=np.float32) / np.float32(255)
        own = self.frames[list(members)].mean(axis=0, dtype=np.float32) / np.float32(255)
        change = cv2.GaussianBlur(own, (0, 0), 2) - cv2.GaussianBlur(target, (0, 0), 2)
        return np.asarray(np.where(np.abs(change) < _MOVED, target, np.nan), np.float32)


def open_stacks(paths: Sequence[str], least_side: int) -> tuple[Stack, ...]:
    """The recordings of files and folders whose geometry is known or found.

    least_side: of a frame, pixels.  Raises FactoryError where there are none.
    """
    stacks = []
    for path in paths:
        refs = list_images(path, "data.recordings")
        for scene in dict.fromkeys(ref.scene for ref in refs):
            shown = [_shown(ref) for ref in refs if ref.scene == scene]
            first, geometry = shown[0]
            shape = first.shape
            frames = np.stack([grey for grey, _ in shown if grey.shape == shape])
            if geometry is None or min(shape) < least_side:
                continue
            sector = geometry.maps(0, 0, *shape)["sector"] > 0
            alike = find_groups(
                list(frames[:2]), [sector] * 2, least=2, alike=_ALIKE, furthest_px=1.0
            )
            if alike and len(frames) >= _LEAST_FRAMES:
                stacks.append(Stack(np.rint(frames * 255).astype(np.uint8), geometry))
    if paths and not stacks:
        raise FactoryError(
            f"data.recordings: no recording there has {_LEAST_FRAMES} frames of a static scene, of "
            f"{least_side} pixels or more, with a fan that can be found"
        )
    return tuple(stacks)


def _shown(ref: SampleRef) -> tuple[Float32s, FanGeometry | None]:
    """A frame as networks are shown it."""
    grey, geometry = read_sample(ref)
    if geometry is None:
        presentation = presentation_of(grey, find_geometry(grey))
        grey = presentation.shown(grey)
        geometry = presentation.geometry
    return grey, geometry


class MixedSource(ImageSource):
    """`data=mixed`, what the network that ships learns from.

    Images of drawn devices as single frames and as means of frames, the paper's points, and
    recordings, each with a part of the visits.
    """

    def __init__(
        self,
        devices: ImageSource,
        points: ImageSource,
        stacks: Sequence[Stack],
        data: MixedData,
        seed: int,
    ) -> None:
        """devices: drawn pairs, one for each render.  points: those of the same renders."""
        self.images = self.devices = devices
        self.points = points
        self.stacks = tuple(stacks)
        self.data = data
        self.seed = seed

    def sample(self, index: int, visit: int | None) -> TrainingImage:
        """See `ImageSource`."""
        if visit is None:
            return self.devices.sample(index, None)
        rng = stream(self.seed, "mixed", index, visit)
        data = self.data
        kind = rng.random()
        if kind < data.points_share:
            return self.points.sample(index, visit)
        if kind < data.points_share + data.recordings_share and self.stacks:
            stack = self.stacks[int(rng.integers(len(self.stacks)))]
            sample = resized(stack.sample(rng), rng)
        else:
            sample = self.devices.sample(index, visit)
            if rng.random() < data.water:
                sample = with_water(sample, rng)
            if rng.random() < data.several:
                sample = standing(sample, rng)
        if rng.random() < data.targets:
            sample = insert_targets(sample, draw_targets(rng, sample.noisy.shape))
        return sample


def resized(sample: TrainingImage, rng: np.random.Generator) -> TrainingImage:
    """A recorded image as another display shows it: larger or smaller, brighter or darker."""
    if rng.random() < _AS_RECORDED or sample.geometry is None:
        return sample
    height, width = sample.noisy.shape
    scale = rng.uniform(*_SCALES)
    rows, columns = round(scale * height), round(scale * width)
    interpolation = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    gain = np.float32(rng.uniform(*_GAINS))

    def shown(image: Float32s) -> Float32s:
        return np.asarray(
            np.clip(gain * cv2.resize(image, (columns, rows), interpolation=interpolation), 0, 1)
        )

    frames = sample.frames
    if frames is not None:
        frames = np.asarray(
            cv2.resize(frames, (columns, rows), interpolation=cv2.INTER_LINEAR), np.float32
        )
    return replace(
        sample,
        noisy=shown(sample.noisy),
        clean=shown(sample.clean),
        geometry=sample.geometry.scaled(rows, columns, scale),
        frames=frames,
    )


def standing(sample: TrainingImage, rng: np.random.Generator) -> TrainingImage:
    """A drawn pair as the mean of frames: some of its speckle is static, the rest is fresh."""
    part = np.float32(rng.choice([0.0, 0.3, 0.6, 1.0]))
    target = sample.clean + part * (sample.noisy - sample.clean)
    count: float | Float32s = float(np.exp(rng.uniform(np.log(1.5), np.log(20))))
    if rng.random() < _UNEVEN:
        count = 1 + (count - 1) * smooth_field(rng, target.shape)
    frames = np.broadcast_to(averaged(count), target.shape).copy()
    noise = temporal_noise(rng, target) * np.exp2(-frames / 2) * rng.uniform(0.9, 1.5)
    noisy = np.asarray(np.clip(target + noise, 0, 1), np.float32)
    # Where a single frame is left, speckle may go: the target says too little there.
    weight = np.clip(2 * frames / _FULL, 0, 1)
    unknown = rng.random(target.shape) > weight
    return replace(
        sample,
        noisy=noisy,
        clean=np.where(unknown, np.nan, target).astype(np.float32),
        shadow=None,
        frames=frames,
    )


def temporal_noise(rng: np.random.Generator, image: Float32s) -> Float32s:
    """The difference of one frame from the static part: nothing in black, some grain wide."""
    grain = rng.standard_normal(image.shape, dtype=np.float32)
    across = rng.uniform(0.2, 1.3)
    down = rng.uniform(0.2, 1.1)
    if max(across, down) > 0.25:
        grain = np.asarray(cv2.GaussianBlur(grain, (0, 0), across, sigmaY=down), np.float32)
        grain /= grain.std()
    level = np.clip(image / rng.uniform(0.03, 0.2), 0, 1)
    if rng.random() < 0.5:
        # Echoes of DIDSON recordings vary less where they are bright.
        level = level * np.clip(1 - (image - 0.25) / rng.uniform(0.5, 1.2), 0.35, 1)
    return np.asarray(rng.uniform(0.015, 0.07) * level * grain * (image > 0.004), np.float32)


def smooth_field(rng: np.random.Generator, shape: tuple[int, ...]) -> Float32s:
    """(H, W) in 0..1, patches of 8 to 60 pixels with soft edges."""
    side = rng.uniform(8, 60)
    coarse = rng.random([int(size / side) + 3 for size in shape]).astype(np.float32)
    field = cv2.resize(coarse, shape[::-1], interpolation=cv2.INTER_CUBIC)
    field = (field - 0.5) * rng.uniform(1, 6) + rng.uniform(0.2, 0.9)
    return np.asarray(np.clip(field, 0, 1), np.float32)


def _grey(frames: UInt8s) -> Float32s:
    return frames.astype(np.float32) / np.float32(255)
