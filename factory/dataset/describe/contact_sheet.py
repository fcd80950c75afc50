"""A contact sheet drawn with Pillow: panels of samples with axes, on a dark ground.

Pillow takes a tenth of a second where a plotting library takes three, and every install has it.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageColor, ImageDraw, ImageFont

from . import palette

_PANEL, _GAP = 340, 12  # pixels: a panel's width, and between panels
_LEFT, _UNDER, _OVER, _HEAD, _EDGE = 92, 58, 46, 78, 30


@dataclass(frozen=True, eq=False)
class Shown:
    """One sample with what its panels need.

    heading: the line above.  images: panel name -> (H, W).  full_scale: value that is white.
    labels: of rows and columns.  extent: left, right, bottom and top of the axes.  same_units: both
    axes are in one unit, so a pixel keeps its shape.
    """

    heading: str
    images: Mapping[str, npt.NDArray[np.generic]]
    full_scale: float
    labels: tuple[str, str]
    extent: tuple[float, float, float, float]
    same_units: bool


def draw(shown: Sequence[Shown], title: str, note: str) -> Image.Image:
    """The samples, two side by side, under a title, with a small note beside it."""
    wide = 2 if len(shown) > 1 else 1
    tall = -(-len(shown) // wide)
    first = next(iter(shown[0].images.values()))
    aspect = min(max(first.shape[0] / first.shape[1], 0.5), 1.6) if shown[0].same_units else 1.0
    height = round(_PANEL * aspect)
    block = (_LEFT + len(shown[0].images) * (_PANEL + _GAP) + _EDGE, _OVER + height + _UNDER)
    size = (wide * block[0] + _EDGE, _HEAD + tall * block[1])
    sheet = Image.new("RGB", size, palette.BACKGROUND)
    pen = ImageDraw.Draw(sheet)
    pen.text((_EDGE, _HEAD // 2), title, palette.TEXT, _font(26), anchor="lm")
    pen.text((size[0] - _EDGE, _HEAD // 2), note, palette.FAINT, _font(18), anchor="rm")
    for number, sample in enumerate(shown):
        row, column = divmod(number, wide)
        x, y = column * block[0] + _LEFT, _HEAD + row * block[1] + _OVER
        pen.text((x, y - 24), sample.heading, palette.TEXT, _font(18), anchor="lb")
        for panel, name in enumerate(sample.images):
            left = x + panel * (_PANEL + _GAP)
            _panel(sheet, pen, sample, name, (left, y, _PANEL, height), first=panel == 0)
    return sheet


def _panel(
    sheet: Image.Image,
    pen: ImageDraw.ImageDraw,
    sample: Shown,
    name: str,
    box: tuple[int, int, int, int],
    *,
    first: bool,
) -> None:
    left, top, width, height = box
    west, east, south, north = sample.extent
    if sample.same_units:  # as large as fits, in the middle
        scale = min(width / abs(east - west), height / abs(north - south))
        fitted = max(round(scale * abs(east - west)), 1), max(round(scale * abs(north - south)), 1)
        left, top = left + (width - fitted[0]) // 2, top + (height - fitted[1]) // 2
        width, height = fitted
    colours = palette.SHADOW if name == "shadow" else palette.ECHO
    full = 1.0 if name == "shadow" else sample.full_scale
    share = np.nan_to_num(np.asarray(sample.images[name], dtype=np.float32) / np.float32(full))
    codes = np.clip(np.rint(share * 255), 0, 255).astype(np.uint8)
    picture = Image.fromarray(codes)
    smaller = width < picture.width or height < picture.height
    ways = Image.Resampling
    fitting = picture.resize((width, height), ways.BOX if smaller else ways.NEAREST)
    sheet.paste(Image.fromarray(_table(colours)[np.asarray(fitting)]), (left, top))
    right, bottom = left + width - 1, top + height - 1
    pen.rectangle((left, top, right, bottom), outline=palette.LINE)
    pen.text((left, top - 4), name, palette.FAINT, _font(15), anchor="lb")
    for value in _ticks(west, east):
        x = left + (value - west) / (east - west) * width
        pen.line((x, bottom, x, bottom + 4), palette.FAINT)
        pen.text((x, bottom + 7), f"{value:g}", palette.FAINT, _font(13), anchor="mt")
    middle = (left + right) / 2
    pen.text((middle, bottom + 24), sample.labels[1], palette.FAINT, _font(15), anchor="mt")
    if not first:
        return
    for value in _ticks(south, north):
        y = top + (north - value) / (north - south) * height
        pen.line((left - 4, y, left, y), palette.FAINT)
        pen.text((left - 7, y), f"{value:g}", palette.FAINT, _font(13), anchor="rm")
    text = _turned(sample.labels[0])
    place = (max(left - 52 - text.width, 0), (top + bottom - text.height) // 2)
    sheet.paste(ImageColor.getrgb(palette.FAINT), place, text)


def _turned(text: str) -> Image.Image:
    """A mask of a line of text that runs upward."""
    left, top, right, bottom = (int(edge) for edge in _font(15).getbbox(text))
    mask = Image.new("L", (right + 2, bottom + 2))
    ImageDraw.Draw(mask).text((0, 0), text, 255, _font(15))
    return mask.crop((left, top, right + 1, bottom + 1)).transpose(Image.Transpose.ROTATE_90)


def _ticks(one: float, other: float) -> list[float]:
    """Four to nine round numbers between two, in order."""
    low, high = min(one, other), max(one, other)
    if not high > low:
        return [low]
    power = 10.0 ** np.floor(np.log10((high - low) / 4))
    step = next(s * power for s in (5, 2, 1) if (high - low) / (s * power) >= 4 or s == 1)
    numbers = np.arange(np.ceil(low / step), np.floor(high / step) + 1)
    return [float(round(number * step, 10)) for number in numbers]


@functools.cache
def _font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size)


@functools.cache
def _table(colours: tuple[str, ...]) -> npt.NDArray[np.uint8]:
    """(256, 3) from the first colour to the last, evenly."""
    stops = np.array([ImageColor.getrgb(colour)[:3] for colour in colours], dtype=np.float64)
    where = np.linspace(0, 1, 256)
    even = np.linspace(0, 1, len(stops))
    channels = [np.interp(where, even, stops[:, k]) for k in range(3)]
    return np.asarray(np.rint(np.stack(channels, axis=-1)), np.uint8)
