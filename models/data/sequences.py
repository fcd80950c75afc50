"""`data=sequences`: windows of recordings in which objects move, from a dataset of recordings.

The reference of a window contains its moving objects at their mean level: the clean image of its
middle frame, on the static scene as this sonar shows it (the mean of all other frames of the
recording, static speckle included) or as it is without speckle (`data.reference`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from ...factory.common.array_types import Bools, Float32s
from ...factory.common.errors import FactoryError
from ...factory.common.seeds import stream
from ...factory.dataset import PairDataset
from ...factory.dataset.fan_geometry import FanGeometry, recorded_sonar
from ..networks import averaged
from ..settings import SequencesData
from .pairs import Data, ImageSource, TrainingImage, spread

_HELD_RECORDINGS = 8
_LAYERS = ("noisy", "clean", "static")
# An object shows where it changes the clean image by as much as noise changes a frame; its pixels
# are widened by the grain of a beam.
_LEAST_CHANGE = 8 / 255
_WIDENED_PX = 5


@dataclass(frozen=True, eq=False)
class FrameWindow:
    """T frames of one recording, and what they should show.

    noisy, clean, static: (T, H, W) float32 in 0..1.
    reference: (H, W) float32, what the middle frame shows without noise, moving objects included.
    moving: (T, H, W) bool, pixels that show a moving object.
    corner: row and column of the window in the image.  geometry: of the image, where it is known.
    """

    noisy: Float32s
    clean: Float32s
    static: Float32s
    reference: Float32s
    moving: Bools
    corner: tuple[int, int] = (0, 0)
    geometry: FanGeometry | None = None

    def cropped(self, top: int, left: int, side: int) -> FrameWindow:
        """The square of `side` pixels from a corner on."""
        part = np.s_[..., top : top + side, left : left + side]
        return FrameWindow(
            noisy=self.noisy[part],
            clean=self.clean[part],
            static=self.static[part],
            reference=self.reference[part],
            moving=self.moving[part],
            corner=(top, left),
            geometry=self.geometry,
        )


@dataclass(frozen=True)
class WindowRef:
    """The window of a recording that begins at its frame number `start`."""

    recording: str
    start: int


class SequenceSource(ImageSource):
    """Windows by their index; the same index and visit give the same window in any process."""

    images: tuple[WindowRef, ...]

    def __init__(
        self, folder: Path, windows: tuple[WindowRef, ...], data: SequencesData, seed: int
    ) -> None:
        """folder: of a dataset with the layer `static`."""
        self.images = windows
        self.data = data
        self.seed = seed
        self._pairs = PairDataset(folder, "train", layers=_LAYERS, scaled=True, trusted=True)
        self._sonar = recorded_sonar(self._pairs.form.config)
        self._standing = lru_cache(maxsize=_HELD_RECORDINGS)(self._standing_scene)

    def window(self, index: int) -> FrameWindow:
        """A whole window."""
        ref = self.images[index]
        sequence = self._pairs.recordings.window(ref.recording, ref.start, self.data.frames)
        assert sequence.static is not None
        changed = np.abs(sequence.clean - sequence.static) > _LEAST_CHANGE
        kernel = np.ones((_WIDENED_PX, _WIDENED_PX), np.uint8)
        moving = np.stack([cv2.dilate(frame.astype(np.uint8), kernel) > 0 for frame in changed])
        middle = self.data.frames // 2
        reference = sequence.clean[middle]
        if self.data.reference == "standing":
            reference = np.where(moving[middle], reference, self._standing(ref.recording))
        return FrameWindow(
            noisy=sequence.noisy,
            clean=sequence.clean,
            static=sequence.static,
            reference=np.asarray(reference, np.float32),
            moving=moving,
            geometry=self._geometry(ref.recording),
        )

    def crops(self, index: int, visit: int, side: int) -> list[FrameWindow]:
        """`data.crops` squares of a window; `data.targets` of them show a moving object.

        side: pixels; of a smaller image the whole.
        """
        window = self.window(index)
        height, width = window.reference.shape
        side = min(side, height, width)
        rng = stream(self.seed, "sequences", index, visit)
        crops = []
        for _ in range(self.data.crops):
            top = int(rng.integers(height - side + 1))
            left = int(rng.integers(width - side + 1))
            if rng.random() < self.data.targets:
                top, left = _around_target(window, side, rng, (top, left))
            crops.append(window.cropped(top, left, side))
        return crops

    def sample(self, index: int, visit: int | None) -> TrainingImage:
        """The window as an ideal fusion gives it to a network, and its reference.

        Where nothing moves the mean of all its frames, where an object is its middle frame alone.
        At a visit a random number of frames is averaged, at validation all.
        """
        window = self.window(index)
        count = len(window.noisy)
        if visit is not None:
            count = int(stream(self.seed, "sequences", index, visit).integers(1, count + 1))
        middle = len(window.noisy) // 2
        first = min(max(middle - count // 2, 0), len(window.noisy) - count)
        members = slice(first, first + count)
        is_averaged = ~window.moving[members]
        is_averaged &= ~window.moving[middle]
        is_averaged[middle - first] = True
        numbers = is_averaged.sum(axis=0)
        mean = (window.noisy[members] * is_averaged).sum(axis=0) / numbers
        return TrainingImage(
            noisy=np.asarray(mean, np.float32),
            clean=window.reference,
            geometry=window.geometry,
            frames=averaged(numbers),
        )

    def _standing_scene(self, recording: str) -> Float32s:
        """(H, W) the mean of the frames in which nothing moves there, else the clean scene."""
        sequence = self._pairs.sequence(recording)
        assert sequence.static is not None
        still = np.abs(sequence.clean - sequence.static) <= _LEAST_CHANGE
        numbers = still.sum(axis=0)
        mean = (sequence.noisy * still).sum(axis=0) / np.maximum(numbers, 1)
        return np.asarray(np.where(numbers > 0, mean, sequence.static[0]), np.float32)

    def _geometry(self, recording: str) -> FanGeometry | None:
        if self._sonar is None:
            return None
        record = self._pairs.recordings.record(recording)
        low, high = (np.deg2rad(record[f"azimuth_{end}_deg"]) for end in ("min", "max"))
        limits = float(record["range_min_m"]), float(record["range_max_m"])
        return FanGeometry.from_sonar(self._sonar, *limits, float(low), float(high))


def _around_target(
    window: FrameWindow, side: int, rng: np.random.Generator, otherwise: tuple[int, int]
) -> tuple[int, int]:
    """The corner of a square that shows a moving object of the middle frame, if there is one."""
    rows, columns = np.nonzero(window.moving[len(window.moving) // 2])
    if not len(rows):
        return otherwise
    place = int(rng.integers(len(rows)))
    height, width = window.reference.shape
    top = int(rows[place]) - int(rng.integers(side))
    left = int(columns[place]) - int(rng.integers(side))
    return min(max(top, 0), height - side), min(max(left, 0), width - side)


def open_sequences(folder: Path, data: SequencesData, seed: int) -> Data:
    """The windows of a dataset of recordings; some recordings are held out.

    Raises FactoryError: without the layer static, or fewer than two recordings with windows.
    """
    with PairDataset(folder, "train", layers=None) as pairs:
        if "static" not in pairs.layers:
            raise FactoryError(
                f"{folder}: data=sequences needs dataset.layers=[static]; make it with "
                "experiment=fish, or with moving objects and that layer"
            )
        recordings = pairs.recordings
        windows = {
            name: tuple(WindowRef(name, start) for start in recordings.starts(name, data.frames))
            for name in recordings.names
        }
        facts: dict[str, Any] = {
            "dataset.config_hash": pairs.config_hash,
            "dataset.pairs": len(pairs),
            "dataset.image": list(pairs.shape),
        }
    names = sorted(name for name, windows_of_recording in windows.items() if windows_of_recording)
    if len(names) < 2:
        raise FactoryError(
            f"{folder}: {len(names)} recording(s) of {data.frames} frames or more train; "
            "data=sequences needs two, one of them for validation"
        )
    count = min(max(1, round(data.validation * len(names))), len(names) - 1)
    held = {names[k] for k in stream(seed, "validation").permutation(len(names))[:count]}
    learning = tuple(ref for name in names if name not in held for ref in windows[name])
    validation = tuple(ref for name in names if name in held for ref in windows[name])
    print(f"recordings: {len(names)}, {count} of them for validation; {len(learning)} windows")
    facts["sequences.windows"] = len(learning)
    return Data(
        SequenceSource(folder, learning, data, seed),
        SequenceSource(folder, spread(validation, data.validation_limit), data, seed),
        facts,
    )
