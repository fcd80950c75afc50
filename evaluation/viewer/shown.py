"""What the page shows: the samples of a dataset, or the frames of a recording."""

from __future__ import annotations

import colorsys
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ...factory.dataset.format.layout import optional_layers
from ...factory.dataset.format.manifest import MANIFEST_NAME
from ...factory.dataset.read.pair_dataset import PairDataset
from ...factory.dataset.read.reader import reading
from ...factory.errors import FactoryError
from ...models.recordings import Frame, Recording, open_recording
from ...models.recordings.base import FULL_SCALE
from ...models.recordings.fan.pings import fan_of, grey_of
from ...models.recordings.pictures import Pictures

Picture = npt.NDArray[np.uint8]
"""(H, W), or (H, W, 3) in the order of OpenCV."""
Facts = dict[str, str | float | int | None]

Ranges = Mapping[str, tuple[float, float]]
"""Column -> least and largest value."""


_HUES = 180
# (hues, 3) blue, green and red.
_COLOURS = np.rint(
    [
        [255 * part for part in colorsys.hsv_to_rgb(h / _HUES, 160 / 255, 1)][::-1]
        for h in range(_HUES)
    ]
).astype(np.uint8)
_LABELS = ("segmentation", "instance")


class ShownDataset:
    """All samples of a dataset.

    layers: of each, the first is shown before the second.  scenes, ranges: what samples may be
    chosen by: names of scenes, and columns of numbers that differ.
    """

    def __init__(self, folder: Path) -> None:
        """Raises FactoryError when it is no dataset."""
        self.title = folder.resolve().name
        first = PairDataset(folder, "all")
        with reading(first.paths[0]) as file:
            self.layers = ("noisy", "clean", "shadow", *optional_layers(file))
        # Checked a moment ago.
        self._pairs = PairDataset(folder, "all", layers=self.layers, scaled=True, trusted=True)
        self._table = self._pairs.meta()
        self._scenes = _scenes(self._table)
        self._numbers = {
            name: values
            for name in self._table.dtype.names or ()
            if (values := self._table[name]).dtype.kind in "iuf"
            and len(np.unique(values[np.isfinite(values)])) > 1
        }
        self.scenes: tuple[str, ...] = tuple(sorted(set(self._scenes)))
        self.ranges: Ranges = {
            name: (float(np.nanmin(values)), float(np.nanmax(values)))
            for name, values in self._numbers.items()
        }

    def __len__(self) -> int:
        return len(self._pairs)

    def picture(self, number: int, layer: int) -> Picture:
        """One layer of one.  Raises FactoryError when it is damaged."""
        name = self.layers[layer]
        image = self._pairs[number][name]
        if name == "rgb":
            return np.ascontiguousarray(image[..., ::-1])
        return _coloured(image) if name in _LABELS else _grey(image)

    def facts(self, number: int) -> Facts:
        """Names and values of the row of /meta.  Raises FactoryError when it is damaged."""
        row, found = self._table[number], Facts()
        for name in self._table.dtype.names or ():
            value = row[name]
            if isinstance(value, bytes):
                found[name] = value.decode(errors="replace")
            else:
                found[name] = value.item() if np.isfinite(value) else None
        return found

    def found(self, scene: str | None, ranges: Ranges) -> list[int]:
        """Numbers of those of a scene (None: any) whose values lie in all ranges, ends included.

        A value that was not drawn lies in no range.  Raises LookupError for a scene or column that
        there is not.
        """
        if scene not in (None, *self.scenes):
            raise LookupError(scene)
        fits = np.array([scene in (None, name) for name in self._scenes])
        for name, (least, most) in ranges.items():
            fits &= (self._numbers[name] >= least) & (self._numbers[name] <= most)
        return [int(number) for number in np.flatnonzero(fits)]


class ShownRecording:
    """The frames of a recording, and of the same one denoised; as `ShownDataset`."""

    def __init__(self, path: Path, after: Path | None = None) -> None:
        """Raises FactoryError when one cannot be read."""
        self.title = path.resolve().name
        self.layers: tuple[str, ...] = ("before", "after") if after else ("recorded",)
        self.scenes: tuple[str, ...] = ()  # nothing to choose by
        self.ranges: Ranges = {}
        self._recordings = [_opened(one) for one in (path, after) if one is not None]

    def __len__(self) -> int:
        return min(map(len, self._recordings))

    def picture(self, number: int, layer: int) -> Picture:
        """Of pings the fan."""
        return _seen(self._recordings[layer][number])

    def facts(self, number: int) -> Facts:
        """What the file says of the frame."""
        frame = self._recordings[0][number]
        found: Facts = {"time_s": frame.time_s, "samples": "x".join(map(str, frame.samples.shape))}
        if frame.beams is not None:
            found |= {
                "range_min_m": frame.beams.range_min_m,
                "range_max_m": frame.beams.range_max_m,
            }
        for part in (frame.device, frame.pose):
            found |= {name: value for name, value in vars(part).items() if value is not None}
        return found

    def found(self, scene: str | None, ranges: Ranges) -> list[int]:
        """All, as there is nothing to choose by."""
        if scene is not None or ranges:
            raise LookupError("a recording is not filtered")
        return list(range(len(self)))


Shown = ShownDataset | ShownRecording


def open_shown(path: Path, after: Path | None = None) -> Shown:
    """A dataset by its manifest or else a recording.  Raises FactoryError when it is neither."""
    if (path / MANIFEST_NAME).is_file():
        if after is not None:
            raise FactoryError(f"{after}: a dataset is shown alone, its layers beside each other")
        return ShownDataset(path)
    return ShownRecording(path, after)


def _scenes(table: npt.NDArray[np.void]) -> list[str]:
    """`location/scene` of each row, or what of it there is."""
    columns = [
        [value.decode(errors="replace") for value in table[name].tolist()]
        for name in ("location", "scene")
        if name in (table.dtype.names or ()) and table[name].dtype.kind == "S"
    ]
    return ["/".join(filter(None, words)) for words in zip(*columns, strict=True)]


def _opened(path: Path) -> Recording:
    recording = open_recording(path)
    if isinstance(recording, Pictures):
        # Those of denoised pings have their samples beside the fans.
        fans = [file for file in recording.files if not file.stem.endswith("_polar")]
        recording.files = fans or recording.files
    return recording


def _seen(frame: Frame) -> Picture:
    if frame.beams is not None:
        return _grey(fan_of(grey_of(frame), frame.beams)[0])
    picture = frame.samples[..., :3] if frame.samples.ndim == 3 else frame.samples
    full = FULL_SCALE[str(picture.dtype)]
    return _grey(picture.astype(np.float32) / np.float32(full))


def _grey(image: npt.NDArray[np.generic]) -> Picture:
    """0..1 or a mask as it is; metres and radians from their least to their largest."""
    values = image.astype(np.float32)
    known = np.isfinite(values)
    low, high = (values[known].min(), values[known].max()) if known.any() else (0, 1)
    if low < 0 or high > 1:
        values = (values - low) / max(float(high - low), 1e-9)
    return np.asarray(np.rint(np.where(known, values, 0) * 255), np.uint8)


def _coloured(labels: npt.NDArray[np.generic]) -> Picture:
    """Numbers as colours that neighbours do not share; 0 is black."""
    numbers = labels.astype(np.int64)
    return np.asarray(np.where(numbers[..., None] > 0, _COLOURS[numbers * 67 % _HUES], 0), np.uint8)
