"""What the description of a TIFF file says of its pages: their channels, slices and times.

ImageJ writes lines of `key=value`, tifffile the shape and the axes in JSON, microscopes OME-XML.
Pages of a channel, and of a slice where there are times as well, are a sequence of their own.
"""

from __future__ import annotations

import json
import math
import re
from dataclasses import dataclass

_IMAGEJ = "ImageJ="
_JSON = '{"shape"'
_OME = "<OME"
_MOST_PAGES = 1 << 30
_MOST_SAMPLES = 1 << 60
_LARGEST_INTERVAL_S = 1e6
_SECONDS_OF_UNIT = {
    "": 1.0, "s": 1.0, "sec": 1.0, "second": 1.0, "seconds": 1.0,
    "ms": 1e-3, "msec": 1e-3, "us": 1e-6, "\u00b5s": 1e-6, "min": 60.0, "h": 3600.0,
}  # fmt: skip
_NAMES = {"C": "channel", "Z": "slice", "I": "image"}
_PIXELS = re.compile(r"<Pixels\b[^>]*>")


@dataclass(frozen=True)
class PageAxes:
    """The axes along which the pages of a file are counted, the slowest first.

    names: a letter each: T time, C channel, Z slice, I image; others are unknown.  sizes: of each.
    interval_s: between two times; None: unknown.
    """

    names: str = "T"
    sizes: tuple[int, ...] = (1,)
    interval_s: float | None = None

    @property
    def page_count(self) -> int:
        """How many pages the axes span."""
        return math.prod(self.sizes)

    def sequence_of(self, page: int) -> str:
        """Which sequence a page belongs to, such as `channel 2`; empty where there is one."""
        time_axis = self._time_axis
        places = [
            f"{_NAMES.get(name, 'part')} {place + 1}"
            for axis, (name, size, place) in enumerate(
                zip(self.names, self.sizes, self._places(page), strict=True)
            )
            if axis != time_axis and size > 1
        ]
        return ", ".join(places)

    def time_s(self, page: int) -> float | None:
        """When a page was taken, seconds since the first; None: unknown."""
        if self.interval_s is None:
            return None
        return self._places(page)[self._time_axis] * self.interval_s

    @property
    def _time_axis(self) -> int:
        """The axis of time; ImageJ calls it slices where nobody told it better."""
        named = [self.names.find(name) for name in "TZ"]
        varying = [axis for axis in named if axis >= 0 and self.sizes[axis] > 1]
        if varying:
            return varying[0]
        unnamed = [axis for axis, name in enumerate(self.names) if name != "C"]
        return max(unnamed, key=lambda axis: self.sizes[axis], default=0)

    def _places(self, page: int) -> list[int]:
        places = []
        for size in reversed(self.sizes):
            page, place = divmod(page, size)
            places.append(place)
        return places[::-1]


def axes_of(text: str, page_shape: tuple[int, ...]) -> PageAxes | None:
    """The axes that a description states; None where it says nothing of pages.

    page_shape: of the array of a page, (H, W), (H, W, C), or (C, H, W) of planes.
    """
    if text.startswith(_IMAGEJ):
        return _axes_of_imagej(text)
    if text.startswith(_JSON):
        return _axes_of_json(text, page_shape)
    if _OME in text[:1000]:
        return _axes_of_ome(text)
    return None


def _axes_of_imagej(text: str) -> PageAxes | None:
    values = dict(re.findall(r"^(\w+)=(.*?)\s*$", text, re.MULTILINE))
    images = _count(values.get("images"))
    sizes = [_count(values.get(name)) for name in ("frames", "slices", "channels")]
    if math.prod(sizes) != images:
        sizes = [images, 1, 1]
    interval_s = _interval_of_imagej(values)
    return PageAxes("TZC", tuple(sizes), interval_s) if 0 < images < _MOST_PAGES else None


def _interval_of_imagej(values: dict[str, str]) -> float | None:
    seconds = _number(values.get("finterval")) * _SECONDS_OF_UNIT.get(values.get("tunit", ""), 0.0)
    if not seconds and _number(values.get("fps")):
        seconds = 1 / _number(values["fps"])
    return seconds if 0 < seconds < _LARGEST_INTERVAL_S else None


def _axes_of_json(text: str, page_shape: tuple[int, ...]) -> PageAxes | None:
    """The axes of the pages by the JSON of tifffile; None where it does not fit the pages."""
    try:
        values = json.loads(text)
    except (ValueError, RecursionError):
        return None
    shape = values.get("shape")
    is_shape = isinstance(shape, list) and all(isinstance(side, int) for side in shape)
    if not is_shape or min(shape, default=0) < 1 or math.prod(shape) > _MOST_SAMPLES:
        return None
    page_sides = list(page_shape)
    if shape[-1] == 1 and page_sides[-1] != 1:
        page_sides.append(1)
    count = len(shape) - len(page_sides)
    if count < 0 or shape[count:] != page_sides:
        return None
    sizes = tuple(shape[:count]) or (1,)
    names = str(values.get("axes", ""))[:count]
    if len(names) != len(sizes):
        # Nothing says which axis is time; the longest is, the first of equal ones.
        longest = sizes.index(max(sizes))
        names = "".join("T" if axis == longest else "Q" for axis in range(len(sizes)))
    return PageAxes(names, sizes)


def _axes_of_ome(text: str) -> PageAxes | None:
    images = [_axes_of_ome_image(element) for element in _PIXELS.findall(text)]
    if not images or images[0] is None or any(axes != images[0] for axes in images):
        return None
    axes = images[0]
    samples = re.search(r'SamplesPerPixel="(\d)"', text)
    sizes = axes.sizes
    if samples is not None and int(samples[1]) > 1:
        sizes = tuple(1 if name == "C" else n for name, n in zip(axes.names, sizes, strict=True))
    names = axes.names
    if len(images) > 1:  # one behind the other
        names = f"I{names}"
        sizes = (len(images), *sizes)
    is_known = 0 < math.prod(sizes) < _MOST_PAGES
    return PageAxes(names, sizes, axes.interval_s) if is_known else None


def _axes_of_ome_image(pixels: str) -> PageAxes | None:
    """The axes of one image.  pixels: the start of its element."""
    order = re.search(r'DimensionOrder="XY([CZT]{3})"', pixels)
    sizes = {axis: re.search(rf'\bSize{axis}="(\d{{1,9}})"', pixels) for axis in "CZT"}
    if order is None or not all(sizes.values()):
        return None
    names = order[1][::-1]
    counts = tuple(int(match[1]) for name in names if (match := sizes[name]) is not None)
    interval = re.search(r'TimeIncrement="([\d.eE+-]+)"', pixels)
    unit = re.search(r'TimeIncrementUnit="([^"]+)"', pixels)
    seconds = _number(interval and interval[1])
    seconds *= _SECONDS_OF_UNIT.get(unit[1] if unit else "s", 0.0)
    return PageAxes(names, counts, seconds if 0 < seconds < _LARGEST_INTERVAL_S else None)


def _count(text: str | None) -> int:
    """A count of ImageJ; 1 where it is not stated."""
    return int(text) if text is not None and re.fullmatch(r"\d{1,9}", text) else 1


def _number(text: str | None) -> float:
    """A positive number; 0 where there is none."""
    try:
        value = float(text or 0)
    except ValueError:
        return 0.0
    return value if 0 < value < math.inf else 0.0
