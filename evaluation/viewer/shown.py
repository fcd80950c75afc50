"""What the page shows: the samples of a dataset, or the frames of a recording."""

from __future__ import annotations

import colorsys
from functools import cached_property
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ...factory.dataset.format.layout import optional_layers
from ...factory.dataset.format.manifest import MANIFEST_NAME
from ...factory.dataset.read.pair_dataset import PairDataset
from ...factory.dataset.read.reader import reading
from ...factory.errors import FactoryError
from ...models.recordings import Recording, open_recording
from ...models.recordings.pictures import Pictures
from ...models.recordings.views import fan_of, grey_of

Picture = npt.NDArray[np.uint8]
"""(H, W), or (H, W, 3): red, green, blue."""
Facts = dict[str, str | float | int | None]

_HUES = 180
_COLOURS = np.rint(
    [np.multiply(255, colorsys.hsv_to_rgb(h / _HUES, 0.63, 1)) for h in range(_HUES)]
)
_LABELS = ("segmentation", "instance")


class ShownDataset:
    """All samples of a dataset; layers: of each, the first is shown before the second."""

    def __init__(self, folder: Path) -> None:
        """Raises FactoryError when it is no dataset."""
        self.title = folder.resolve().name
        with reading(PairDataset(folder, "all").paths[0]) as file:
            self.layers = ("noisy", "clean", "shadow", *optional_layers(file))
        # Checked a moment ago.
        self._pairs = PairDataset(folder, "all", layers=self.layers, scaled=True, trusted=True)
        self._table = self._pairs.meta()

    def __len__(self) -> int:
        return len(self._pairs)

    def picture(self, number: int, layer: int) -> Picture:
        """One layer of one.  Raises FactoryError when it is damaged."""
        name = self.layers[layer]
        image = self._pairs[number][name]
        if name in _LABELS:
            # Colours that neighbours do not share; 0 is black.
            numbers = image.astype(np.int64)[..., None]
            colours = _COLOURS[numbers[..., 0] * 67 % _HUES]
            return np.asarray(np.where(numbers > 0, colours, 0), np.uint8)
        return np.asarray(image, np.uint8) if name == "rgb" else _grey(image)

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


class ShownRecording:
    """The frames of a recording, and of the same one denoised; as `ShownDataset`."""

    def __init__(self, path: Path, after: Path | None = None) -> None:
        """Raises FactoryError when one cannot be read."""
        self.title = path.resolve().name
        self.layers: tuple[str, ...] = ("before", "after") if after else ("recorded",)
        self._recordings = [_opened(one) for one in (path, after) if one is not None]

    def __len__(self) -> int:
        return min(map(len, self._recordings))

    def picture(self, number: int, layer: int) -> Picture:
        """Of pings the fan."""
        frame = self._recordings[layer][number]
        grey = grey_of(frame)
        if frame.beams is not None:
            black, white = self._window
            fan = fan_of(grey, frame.beams)[0]
            return _grey(np.clip((fan - black) / (white - black), 0, 1))
        return _grey(grey[..., 2::-1] if grey.ndim == 3 else grey)

    @cached_property
    def _window(self) -> tuple[float, float]:
        """Grey values of pings shown black and white: raw ones fill a part of the scale."""
        black, white = np.quantile(grey_of(self._recordings[0][0]), (0.01, 0.999))
        return (float(black), float(white)) if white > black else (0.0, 1.0)

    def close(self) -> None:
        """Let go of the files."""
        for recording in self._recordings:
            recording.close()

    def facts(self, number: int) -> Facts:
        """What the file says of the frame."""
        frame = self._recordings[0][number]
        found: Facts = {"time_s": frame.time_s, "samples": "x".join(map(str, frame.samples.shape))}
        if frame.beams is not None:
            found["range_min_m"] = frame.beams.range_min_m
            found["range_max_m"] = frame.beams.range_max_m
        for part in (frame.device, frame.pose):
            found |= {name: value for name, value in vars(part).items() if value is not None}
        return found


Shown = ShownDataset | ShownRecording


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


def _grey(image: npt.NDArray[np.generic]) -> Picture:
    """0..1 or a mask as it is; metres and radians from their least to their largest."""
    values = image.astype(np.float32)
    known = np.isfinite(values)
    low, high = (values[known].min(), values[known].max()) if known.any() else (0, 1)
    if low < 0 or high > 1:
        values = (values - low) / max(float(high - low), 1e-9)
    return np.asarray(np.rint(np.where(known, values, 0) * 255), np.uint8)
