"""What the page shows: the samples of a dataset, or the frames of a recording."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
import numpy.typing as npt

from simnfnd.factory.dataset.format.layout import optional_layers
from simnfnd.factory.dataset.format.manifest import MANIFEST_NAME
from simnfnd.factory.dataset.read.pair_dataset import PairDataset
from simnfnd.factory.dataset.read.reader import reading
from simnfnd.factory.errors import FactoryError
from simnfnd.factory.recordings import Frame, Recording, open_recording
from simnfnd.factory.recordings.fans import FULL_SCALE, fan_of, grey_of
from simnfnd.factory.recordings.pictures import Pictures

Picture = npt.NDArray[np.uint8]
"""(H, W), or (H, W, 3) in the order of OpenCV."""
Facts = dict[str, str | float | int | None]

_LABELS = ("segmentation", "instance")


class Shown(Protocol):
    """Pictures by number, each in several layers of one size, and what is known of each.

    layers: their names, at least one; the page begins with the first before the second.
    """

    title: str
    layers: tuple[str, ...]

    def __len__(self) -> int:
        """How many there are."""
        ...

    def picture(self, number: int, layer: int) -> Picture:
        """One layer of one.  Raises FactoryError when it is damaged."""
        ...

    def facts(self, number: int) -> Facts:
        """Names and values, in the order to show them.  Raises FactoryError as well."""
        ...


class ShownDataset:
    """All samples of a dataset; a `Shown`."""

    def __init__(self, folder: Path) -> None:
        """Raises FactoryError when it is no dataset."""
        self.title = folder.resolve().name
        first = PairDataset(folder, "all")
        with reading(first.paths[0]) as file:
            self.layers = ("noisy", "clean", "shadow", *optional_layers(file))
        # Checked a moment ago.
        self._pairs = PairDataset(folder, "all", layers=self.layers, scaled=True, trusted=True)
        self._table = self._pairs.meta()

    def __len__(self) -> int:
        return len(self._pairs)

    def picture(self, number: int, layer: int) -> Picture:
        """See `Shown`."""
        name = self.layers[layer]
        image = self._pairs[number][name]
        return _coloured(image) if name in _LABELS else _grey(image)

    def facts(self, number: int) -> Facts:
        """See `Shown`: the row of /meta."""
        row, found = self._table[number], Facts()
        for name in self._table.dtype.names or ():
            value = row[name]
            if isinstance(value, bytes):
                found[name] = value.decode(errors="replace")
            else:
                found[name] = value.item() if np.isfinite(value) else None
        return found


class ShownRecording:
    """The frames of a recording, and of the same one denoised; a `Shown`."""

    def __init__(self, path: Path, after: Path | None = None) -> None:
        """Raises FactoryError when one cannot be read."""
        self.title = path.resolve().name
        self.layers: tuple[str, ...] = ("before", "after") if after else ("recorded",)
        self._recordings = [_opened(one) for one in (path, after) if one is not None]

    def __len__(self) -> int:
        return min(map(len, self._recordings))

    def picture(self, number: int, layer: int) -> Picture:
        """See `Shown`; of pings the fan."""
        return _seen(self._recordings[layer][number])

    def facts(self, number: int) -> Facts:
        """See `Shown`: what the file says of the frame."""
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


def open_shown(path: Path, after: Path | None = None) -> Shown:
    """A dataset by its manifest or else a recording.  Raises FactoryError when it is neither."""
    if (path / MANIFEST_NAME).is_file():
        if after is not None:
            raise FactoryError(f"{after}: a dataset is shown alone, its layers beside each other")
        return ShownDataset(path)
    return ShownRecording(path, after)


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
    hue = (numbers * 67 % 180).astype(np.uint8)
    on = np.where(numbers > 0, 255, 0).astype(np.uint8)
    hsv = np.stack([hue, np.full_like(hue, 160), on], axis=-1)
    return np.asarray(cv2.cvtColor(hsv, cv2.COLOR_HSV2BGR), np.uint8)
