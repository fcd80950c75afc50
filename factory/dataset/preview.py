"""Contact sheets of datasets, read back from their shards and drawn with Pillow.

Pillow takes a tenth of a second where a plotting library takes three, and every install has it.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont, ImageOps

from ..common.array_types import Array
from ..common.errors import FactoryError
from ..common.files import write_atomically
from .folder import PREVIEW_NAME
from .pair_dataset import PairDataset, SampleName
from .reader import ImageStack, reading, value_range
from .schema import CORE

_BACKGROUND = "#0d1117"
_TEXT = "#e6edf3"
_FAINT = "#8b949e"
# Black over amber to near white, as imaging sonars show echoes; shadows in the opposite hue.
_ECHO = ("#000000", "#fffdf2", "#b26c1e")
_SHADOW = ("#000000", "#39a0c8")

_PANEL_PX = 340  # width of a panel
_LINE_PX = 24  # height of a line of text, and of the gaps between panels


@dataclass(frozen=True, eq=False)
class Shown:
    """One sample.

    heading: the line above.  images: panel name -> (H, W).  full_scale: value that is white.
    """

    heading: str
    images: Mapping[str, Array]
    full_scale: float


def preview(
    directory: Path, out: Path | None = None, pairs: int = 8, *, trusted: bool = False
) -> Path:
    """Draw `pairs` samples, evenly spread, as noisy | clean | shadow; returns the path.

    out: the PNG to write; None is preview.png in the dataset's folder.
    trusted: leave out the check of the shards in another process; for datasets just made.
    Raises FactoryError when the folder holds no dataset, or one without samples.
    """
    if pairs < 1:
        raise FactoryError(f"pairs must be at least 1, got {pairs}")
    dataset = PairDataset(directory, "all", trusted=trusted)
    counts = dataset.splits
    title = f"{counts.get('train', 0)} train and {counts.get('test', 0)} test pairs"
    chosen = [load(name) for name in spread(list(dataset.names()), pairs)]
    content = draw(chosen, title, f"config {dataset.config_hash[:8]}")
    path = out or directory / PREVIEW_NAME
    # Whoever asks for a preview alone has no key dataset.dir to change.
    write_atomically(path, content, key="dataset.dir" if trusted else "--out")
    return path


def side_by_side(
    points: Sequence[tuple[str, Path]], out: Path, frames: int = 3, *, whole: bool = False
) -> bool:
    """Draw the same frames of several datasets; False where no sample is in all of them.

    points: label and folder of each, just made.  whole: noisy | clean | shadow of each, datasets
    beside each other; else a row for each dataset, its noisy images and the first clean one.
    """
    tables = [
        {
            (sample.location, sample.scene, sample.frame, sample.variant): sample
            for sample in pairs.names()
        }
        for pairs in (PairDataset(folder, "all", trusted=True) for _, folder in points)
    ]
    common = [name for name in tables[0] if all(name in table for table in tables)]
    rows = [[load(table[name]) for name in spread(common, frames)] for table in tables]
    labels = [label for label, _ in points]
    if not common:
        return False
    if whole:
        shown = [
            replace(sample, heading=f"{label}   {sample.heading}")
            for samples in zip(*rows, strict=True)
            for label, sample in zip(labels, samples, strict=True)
        ]
        sheet = draw(shown, " and ".join(labels), "", wide=len(labels))
    else:
        shown = []
        for label, samples in zip(labels, rows, strict=True):
            noisy = {f"noisy, {k + 1}": sample.images["noisy"] for k, sample in enumerate(samples)}
            images = {"clean, 1": samples[0].images["clean"], **noisy}
            shown.append(replace(samples[0], heading=label, images=images))
        sheet = draw(shown, f"{len(shown)} datasets", "the same frames of each", wide=1)
    write_atomically(out, sheet)
    return True


def spread(samples: Sequence[Any], count: int) -> list[Any]:
    """`count` samples (or all), evenly spread, in their order."""
    count = min(count, len(samples))
    return [samples[(2 * k + 1) * len(samples) // (2 * count)] for k in range(count)]


def load(name: SampleName) -> Shown:
    """One sample with its images read."""
    with reading(name.path) as file:
        images = {panel: ImageStack(file[panel])[name.row] for panel in CORE}
        record = file["meta"][name.row]
        full_scale = value_range(file)
    sample_name = " / ".join(part for part in (name.location, name.scene, name.frame) if part)
    heading = f"{name.split}   {sample_name}   variant {name.variant}"
    if {"range_min_m", "range_max_m"} <= set(record.dtype.names):
        heading += f"   {record['range_min_m']:.3g} to {record['range_max_m']:.3g} m"
    return Shown(heading, images, full_scale)


def draw(shown: Sequence[Shown], title: str, note: str, wide: int = 2) -> bytes:
    """PNG of the samples, `wide` side by side, under a title, with a small note beside it."""
    wide = min(len(shown), wide)
    first = next(iter(shown[0].images.values()))
    height = round(_PANEL_PX * min(max(first.shape[0] / first.shape[1], 0.5), 1.6))
    block_width = len(shown[0].images) * (_PANEL_PX + _LINE_PX)
    block_height = 2 * _LINE_PX + height + _LINE_PX  # two lines above a panel, a gap below
    head = 3 * _LINE_PX
    rows = -(-len(shown) // wide)
    size = (wide * block_width + _LINE_PX, head + rows * block_height)
    sheet = Image.new("RGB", size, _BACKGROUND)
    pen = ImageDraw.Draw(sheet)

    def write(corner: tuple[int, int], text: str, colour: str, font: float, anchor: str) -> None:
        pen.text(corner, text, colour, ImageFont.load_default(font), anchor=anchor)

    small = 0.75 * _LINE_PX
    write((_LINE_PX, head // 2), title, _TEXT, _LINE_PX, "lm")
    write((sheet.width - _LINE_PX, head // 2), note, _FAINT, small, "rm")
    for number, sample in enumerate(shown):
        row, column = divmod(number, wide)
        left = column * block_width + _LINE_PX
        top = head + row * block_height + 2 * _LINE_PX
        write((left, top - _LINE_PX), sample.heading, _TEXT, small, "lb")
        for name, image in sample.images.items():
            write((left, top), name, _FAINT, small, "lb")
            full, colours = (1.0, _SHADOW) if name == "shadow" else (sample.full_scale, _ECHO)
            share = np.nan_to_num(np.asarray(image, np.float32) / np.float32(full))
            grey = Image.fromarray(np.clip(np.rint(share * 255), 0, 255).astype(np.uint8))
            smaller = grey.width > _PANEL_PX or height < grey.height
            way = Image.Resampling.BOX if smaller else Image.Resampling.NEAREST
            panel = ImageOps.colorize(grey.resize((_PANEL_PX, height), way), *colours)
            sheet.paste(panel, (left, top))
            left += _PANEL_PX + _LINE_PX
    buffer = io.BytesIO()
    sheet.save(buffer, "PNG", compress_level=1)
    return buffer.getvalue()
