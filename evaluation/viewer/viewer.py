"""`simnfnd view` and `simnfnd preview`: datasets and recordings, in the browser or on a sheet."""

from __future__ import annotations

import colorsys
import io
import re
from collections.abc import Sequence
from contextlib import closing, suppress
from functools import cached_property
from pathlib import Path

import numpy as np
from PIL import Image

from ...factory.common.array_types import Array, Floats, UInt8s
from ...factory.common.command_line import Parser
from ...factory.common.errors import FactoryError
from ...factory.common.files import real_path, write_atomically
from ...factory.dataset.layout import optional_layers
from ...factory.dataset.pair_dataset import PairDataset
from ...factory.dataset.preview import Shown as OnSheet
from ...factory.dataset.preview import draw, preview
from ...factory.dataset.reader import reading
from ...models.recordings import (
    DATASET,
    Recording,
    dataset_of,
    is_recording,
    kind_of,
    open_recording,
)
from ...models.recordings.views import fan_of, grey_of
from ..metrics.statistics import evenly
from .page_server import Answer, PageServer, UnknownPath, add_page_options, json_answer


def view(words: list[str]) -> None:
    """Serve what `words` ask for until Ctrl-C."""
    parser = Parser(prog="simnfnd view")
    parser.add_argument(
        "path", type=Path, help="dataset, DATASET/LOCATION/SCENE, recording, bag or video to show"
    )
    parser.add_argument("after", type=Path, nargs="?", help="the same recording, denoised")
    add_page_options(parser)
    arguments = parser.parse_args(words)
    with Viewer(open_shown(arguments.path, arguments.after), arguments.port) as viewer:
        viewer.serve_until_interrupted(opens_browser=not arguments.no_browser)


def sheet(words: list[str]) -> None:
    """Draw the contact sheet that `words` ask for."""
    parser = Parser(prog="simnfnd preview")
    parser.add_argument("dir", type=Path, help="folder of a dataset, or a recording")
    parser.add_argument(
        "--out", type=Path, help="image to write (default: DIR/preview.png; a recording needs it)"
    )
    parser.add_argument(
        "--pairs", type=int, default=8, help="number of pairs or frames to show (8)"
    )
    arguments = parser.parse_args(words)
    if is_recording(arguments.dir):
        path = _draw_recording(arguments.dir, arguments.out, arguments.pairs)
    else:
        path = preview(arguments.dir, out=arguments.out, pairs=arguments.pairs)
    print(f"preview: {path}")


def _draw_recording(source: Path, out: Path | None, frames: int) -> Path:
    """Draw evenly spread frames of a recording, pings as fans; returns the path."""
    if out is None:
        raise FactoryError(f"{source}: a recording has no folder of its own; give --out FILE.png")
    if frames < 1:
        raise FactoryError(f"--pairs must be at least 1, got {frames}")
    shown = []
    with closing(ShownRecording(source)) as recording:
        count = len(recording)
        for number in evenly(range(count), frames):
            image = recording.image(number, 0)
            grey = image.mean(axis=-1) if image.ndim == 3 else image
            shown.append(OnSheet(f"frame {number}", {"image": grey}, 255.0))
    write_atomically(out, draw(shown, source.name, f"{count} frames"), key="--out")
    return out


_RATE_HZ = 10.0
_MOST_RATE_HZ = 30.0
_PAGE = Path(__file__).with_name("view.html")
_LAYER_PATH = re.compile(r"/(?:image|facts)/(\d{1,12})(?:/(\d{1,3})\.png|\.json)")


class Viewer(PageServer):
    """Serves the page of `simnfnd view`."""

    verb = "view"

    def __init__(self, shown: Shown, port: int = 0) -> None:
        """See `PageServer`."""
        super().__init__(port)
        self.shown = shown

    def answer(self, path: str) -> Answer:
        """See `PageServer`."""
        shown = self.shown
        if path == "/":
            return Answer("text/html; charset=utf-8", _PAGE.read_bytes())
        if path == "/about.json":
            about = {"title": shown.title, "layers": shown.layers, "count": len(shown)}
            return json_answer({**about, "rate_hz": shown.rate_hz})
        match = _LAYER_PATH.fullmatch(path)
        number, layer = (int(text or 0) for text in match.groups()) if match else (len(shown), 0)
        if number >= len(shown) or layer >= len(shown.layers):
            raise UnknownPath
        if path.startswith("/facts"):
            return json_answer(shown.facts(number))
        buffer = io.BytesIO()
        Image.fromarray(shown.image(number, layer)).save(buffer, "PNG", compress_level=1)
        return Answer("image/png", buffer.getvalue())


Pixels = UInt8s
"""(H, W), or (H, W, 3): red, green, blue."""
Facts = dict[str, str | float | int | None]

_HUES = 180
_COLOURS = np.rint(
    [np.multiply(255, colorsys.hsv_to_rgb(h / _HUES, 0.63, 1)) for h in range(_HUES)]
)
_LABELS = ("segmentation", "instance")


class ShownDataset:
    """All samples of a dataset, or the frames of one recording in the order of time.

    layers: names of the layers; the page compares the first two.
    rate_hz: frames per second when played.
    """

    def __init__(self, folder: Path, recording: str = "") -> None:
        """recording: its name; empty: all samples.

        Raises FactoryError when it is no dataset, or has no such recording.
        """
        self.title = f"{real_path(folder).name} {recording}".rstrip()
        with reading(PairDataset(folder, "all").paths[0]) as file:
            self.layers = ("noisy", "clean", "shadow", *optional_layers(file))
        # Checked a moment ago.
        self._pairs = PairDataset(folder, "all", layers=self.layers, scaled=True, trusted=True)
        self._table = self._pairs.meta()
        self._samples: Sequence[int] = range(len(self._pairs))
        if recording:
            self._samples = self._pairs.recordings.samples(recording)
        times_s: list[float] = []
        if recording and "time_s" in (self._table.dtype.names or ()):
            times_s = self._table["time_s"][list(self._samples)].tolist()
        self.rate_hz = _rate_hz(times_s)

    def __len__(self) -> int:
        return len(self._samples)

    def image(self, number: int, layer: int) -> Pixels:
        """One layer of a sample as pixels.  Raises FactoryError when it is damaged."""
        name = self.layers[layer]
        image = self._pairs[self._samples[number]][name]
        if name in _LABELS:
            # Colours that neighbours do not share; 0 is black.
            numbers = image.astype(np.int64)[..., None]
            colours = _COLOURS[numbers[..., 0] * 67 % _HUES]
            return np.asarray(np.where(numbers > 0, colours, 0), np.uint8)
        return np.asarray(image, np.uint8) if name == "rgb" else _grey(image)

    def facts(self, number: int) -> Facts:
        """Names and values of the row of /meta.  Raises FactoryError when it is damaged."""
        row = self._table[self._samples[number]]
        facts = Facts()
        for name in self._table.dtype.names or ():
            value = row[name]
            if isinstance(value, bytes):
                facts[name] = value.decode(errors="replace")
            else:
                facts[name] = value.item() if np.isfinite(value) else None
        return facts


class ShownRecording:
    """The frames of a recording, and of the same one denoised; as `ShownDataset`."""

    def __init__(self, path: Path, after: Path | None = None) -> None:
        """Raises FactoryError when one cannot be read."""
        self.title = real_path(path).name
        self.layers: tuple[str, ...] = ("before", "after") if after else ("recorded",)
        self._recordings = [_opened(source) for source in (path, after) if source is not None]

    def __len__(self) -> int:
        return min(map(len, self._recordings))

    def image(self, number: int, layer: int) -> Pixels:
        """The image of a frame; of pings the fan."""
        frame = self._recordings[layer][number]
        grey = grey_of(frame)
        if frame.beams is not None:
            return self._windowed(fan_of(grey, frame.beams)[0])
        return _grey(grey[..., 2::-1] if grey.ndim == 3 else grey)

    def polar_image(self, number: int, layer: int) -> Pixels:
        """The samples of a ping, near range first; of images what `image` gives."""
        frame = self._recordings[layer][number]
        if frame.beams is None:
            return self.image(number, layer)
        return self._windowed(grey_of(frame))

    def _windowed(self, grey: Floats) -> Pixels:
        black, white = self._window
        return _grey(np.clip((grey - black) / (white - black), 0, 1))

    @cached_property
    def _window(self) -> tuple[float, float]:
        """Grey values of pings shown black and white: raw ones fill a part of the scale."""
        black, white = np.quantile(grey_of(self._recordings[0][0]), (0.01, 0.999))
        return (float(black), float(white)) if white > black else (0.0, 1.0)

    @cached_property
    def rate_hz(self) -> float:
        """Frames a second, by the times of the first two frames."""
        times_s: list[float | None] = []
        with suppress(FactoryError):
            times_s += [self._recordings[0][number].time_s for number in range(min(2, len(self)))]
        return _rate_hz(times_s)

    def close(self) -> None:
        """Close the files."""
        for recording in self._recordings:
            recording.close()

    def facts(self, number: int) -> Facts:
        """What the file says of the frame."""
        frame = self._recordings[0][number]
        facts: Facts = {"time_s": frame.time_s, "samples": "x".join(map(str, frame.samples.shape))}
        if frame.beams is not None:
            facts["range_min_m"] = frame.beams.range_min_m
            facts["range_max_m"] = frame.beams.range_max_m
        for part in (frame.device, frame.pose):
            facts |= {name: value for name, value in vars(part).items() if value is not None}
        return facts


def _rate_hz(times_s: Sequence[float | None]) -> float:
    """Frames a second of a recording, within what a browser can show; `_RATE_HZ` where unknown."""
    known = [time_s for time_s in times_s if time_s is not None and np.isfinite(time_s)]
    steps_s = np.diff(known)
    steps_s = steps_s[steps_s > 0]
    if not len(steps_s):
        return _RATE_HZ
    return float(np.clip(1 / np.median(steps_s), 1, _MOST_RATE_HZ))


Shown = ShownDataset | ShownRecording


def open_shown(path: Path, after: Path | None = None) -> Shown:
    """A dataset, a recording of one, or a recording.  Raises FactoryError when it is neither."""
    folder = dataset_of(path)
    if folder != path and kind_of(path) != DATASET:
        return ShownRecording(path, after)
    if after is not None:
        raise FactoryError(f"{after}: a dataset is shown alone, its layers beside each other")
    assert folder is not None
    return ShownDataset(folder, "" if folder == path else path.relative_to(folder).as_posix())


def _opened(path: Path) -> Recording:
    recording = open_recording(path)
    # Images of denoised pings have their samples beside the fans.
    fans = [file for file in recording.files if not file.stem.endswith("_polar")]
    if fans:
        recording.files = fans
        recording.count = len(fans)
    return recording


def _grey(image: Array) -> Pixels:
    """Grey pixels: 0..1 and masks keep their scale, metres and radians fill it."""
    values = image.astype(np.float32)
    known = np.isfinite(values)
    low, high = (values[known].min(), values[known].max()) if known.any() else (0, 1)
    if low < 0 or high > 1:
        values = (values - low) / max(float(high - low), 1e-9)
    return np.asarray(np.rint(np.where(known, values, 0) * 255), np.uint8)
