"""preview.png: a contact sheet of a dataset, read back from its shards and drawn with Pillow.

Pillow takes a tenth of a second where a plotting library takes three, and every install has it.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageColor, ImageDraw, ImageFont

from ..errors import FactoryError
from ..files import write_atomically
from .folder import PREVIEW_NAME
from .pair_dataset import PairDataset, SampleName
from .reader import ImageStack, reading
from .schema import CORE, VALUE_RANGES

_BACKGROUND, _TEXT, _FAINT = "#0d1117", "#e6edf3", "#8b949e"
# Black over amber to near white, as imaging sonars show echoes; shadows in the opposite hue.
_ECHO = ("#000000", "#3a1c08", "#8c4a12", "#d98f2b", "#f7d488", "#fffdf2")
_SHADOW = ("#000000", "#39a0c8")

_PANEL, _GAP = 340, 12  # pixels: a panel's width, and between panels
_OVER, _HEAD, _EDGE = 56, 78, 30


@dataclass(frozen=True, eq=False)
class Shown:
    """One sample.

    heading: the line above.  images: panel name -> (H, W).  full_scale: value that is white.
    """

    heading: str
    images: Mapping[str, npt.NDArray[np.generic]]
    full_scale: float


def preview(
    dataset_dir: Path | str,
    out: Path | str | None = None,
    pairs: int = 8,
    *,
    trusted: bool = False,
) -> Path:
    """Draw `pairs` samples, evenly spread, as noisy | clean | shadow; returns the path.

    out: the PNG to write; None is preview.png in the dataset's folder.
    trusted: leave out the check of the shards in another process; for datasets just made.
    Raises FactoryError when the folder holds no dataset, or one without samples.
    """
    directory = Path(dataset_dir)
    if pairs < 1:
        raise FactoryError(f"pairs must be at least 1, got {pairs}")
    dataset = PairDataset(directory, "all", trusted=trusted)
    counts = dataset.splits
    title = f"{counts.get('train', 0)} train and {counts.get('test', 0)} test pairs"
    chosen = [load(name) for name in spread(list(dataset.names()), pairs)]
    content = draw(chosen, title, f"config {dataset.config_hash[:8]}")
    path = directory / PREVIEW_NAME if out is None else Path(out)
    # Whoever asks for a preview alone has no key dataset.dir to change.
    write_atomically(path, content, key="dataset.dir" if trusted else "--out")
    return path


def side_by_side(directories: Mapping[str, Path], out: Path, pairs: int = 4) -> None:
    """Draw `pairs` frames of two datasets, just made, both in one row.

    directories: the name of each, and its folder.
    """
    rows = {row[0]: row for row in in_common(list(directories.values()), trusted=True)}
    shown = []
    for first in spread(list(rows), pairs):
        for name, sample in zip(directories, rows[first], strict=True):
            one = load(sample)
            shown.append(replace(one, heading=f"{name}   {one.heading}"))
    write_atomically(out, draw(shown, " and ".join(directories), ""), key="dataset.dir")


def in_common(
    directories: Sequence[Path], *, trusted: bool = False
) -> list[tuple[SampleName, ...]]:
    """What all datasets have of the same frame and variant, one of each, in order.

    trusted: as of `preview`.
    """
    tables = [
        {(one.location, one.scene, one.frame, one.variant): one for one in pairs.names()}
        for pairs in (PairDataset(folder, "all", trusted=trusted) for folder in directories)
    ]
    common = [name for name in tables[0] if all(name in table for table in tables)]
    return [tuple(table[name] for table in tables) for name in common]


def spread(samples: Sequence[SampleName], count: int) -> list[SampleName]:
    """`count` samples (or all), evenly spread, in their order."""
    count = min(count, len(samples))
    return [samples[(2 * k + 1) * len(samples) // (2 * count)] for k in range(count)]


def load(name: SampleName) -> Shown:
    """One sample with its images read."""
    with reading(name.path) as file:
        images = {panel: ImageStack(file[panel])[name.row] for panel in CORE}
        record = file["meta"][name.row]
    place = " / ".join(part for part in (name.location, name.scene, name.frame) if part)
    heading = f"{name.split}   {place}   variant {name.variant}"
    if {"range_min_m", "range_max_m"} <= set(record.dtype.names):
        heading += f"   {record['range_min_m']:.3g} to {record['range_max_m']:.3g} m"
    return Shown(heading, images, VALUE_RANGES[str(images["noisy"].dtype)][1])


def draw(shown: Sequence[Shown], title: str, note: str) -> bytes:
    """PNG of the samples, two side by side, under a title, with a small note beside it."""
    wide = 2 if len(shown) > 1 else 1
    tall = -(-len(shown) // wide)
    first = next(iter(shown[0].images.values()))
    height = round(_PANEL * min(max(first.shape[0] / first.shape[1], 0.5), 1.6))
    block = (len(shown[0].images) * (_PANEL + _GAP) + _EDGE, _OVER + height + _GAP)
    sheet = Image.new("RGB", (wide * block[0] + _EDGE, _HEAD + tall * block[1]), _BACKGROUND)
    pen = ImageDraw.Draw(sheet)
    pen.text((_EDGE, _HEAD // 2), title, _TEXT, ImageFont.load_default(26), anchor="lm")
    right = (sheet.width - _EDGE, _HEAD // 2)
    pen.text(right, note, _FAINT, ImageFont.load_default(18), anchor="rm")
    for number, sample in enumerate(shown):
        row, column = divmod(number, wide)
        left, top = column * block[0] + _EDGE, _HEAD + row * block[1] + _OVER
        pen.text((left, top - 24), sample.heading, _TEXT, ImageFont.load_default(18), anchor="lb")
        for name, image in sample.images.items():
            pen.text((left, top - 4), name, _FAINT, ImageFont.load_default(15), anchor="lb")
            full, colours = (1.0, _SHADOW) if name == "shadow" else (sample.full_scale, _ECHO)
            sheet.paste(_panel(image, full, colours, height), (left, top))
            left += _PANEL + _GAP
    buffer = io.BytesIO()
    sheet.save(buffer, "PNG", compress_level=1)
    return buffer.getvalue()


def _panel(
    image: npt.NDArray[np.generic], full_scale: float, colours: Sequence[str], height: int
) -> Image.Image:
    """A picture in colours, as large as a panel."""
    share = np.nan_to_num(np.asarray(image, dtype=np.float32) / np.float32(full_scale))
    picture = Image.fromarray(np.clip(np.rint(share * 255), 0, 255).astype(np.uint8))
    smaller = picture.width > _PANEL or height < picture.height
    way = Image.Resampling.BOX if smaller else Image.Resampling.NEAREST
    fitting = picture.resize((_PANEL, height), way)
    stops = np.array([ImageColor.getrgb(colour)[:3] for colour in colours], dtype=np.float64)
    where, even = np.linspace(0, 1, 256), np.linspace(0, 1, len(stops))
    table = np.stack([np.interp(where, even, stops[:, k]) for k in range(3)], axis=-1)
    return Image.fromarray(np.rint(table).astype(np.uint8)[np.asarray(fitting)])
