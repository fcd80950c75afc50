"""preview.png: a contact sheet of a dataset, read back from its shards and drawn with Pillow.

Pillow takes a tenth of a second where a plotting library takes three, and every install has it.
"""

from __future__ import annotations

import functools
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageColor, ImageDraw, ImageFont

from ...errors import FactoryError
from ...files import write_atomically
from ..format.axes import image_axes
from ..format.manifest import MANIFEST_NAME, load_manifest
from ..format.schema import VALUE_RANGES
from ..read.image_stack import ImageStack
from ..read.reader import check_in_isolation, listed_shards, reading
from ..read.source import CORE, SampleName, manifest_source, read_image
from ..write.folder import PREVIEW_NAME

# Colours of every picture that the factory draws.
BACKGROUND, PANEL, LINE = "#0d1117", "#161b22", "#30363d"
TEXT, FAINT = "#e6edf3", "#8b949e"
AMBER, BLUE = "#d98f2b", "#39a0c8"
# Black over amber to near white, as imaging sonars show echoes; shadows in the opposite hue.
_ECHO = ("#000000", "#3a1c08", "#8c4a12", "#d98f2b", "#f7d488", "#fffdf2")
_SHADOW = ("#000000", BLUE)

_PANEL, _GAP = 340, 12  # pixels: a panel's width, and between panels
_LEFT, _UNDER, _OVER, _HEAD, _EDGE = 92, 58, 46, 78, 30


@dataclass(frozen=True, eq=False)
class Shown:
    """One sample with what its panels need.

    heading: the line above.  images: panel name -> (H, W).  full_scale: value that is white.
    labels: of rows and columns.  extent: left, right, bottom and top of the axes.
    """

    heading: str
    images: Mapping[str, npt.NDArray[np.generic]]
    full_scale: float
    labels: tuple[str, str]
    extent: tuple[float, float, float, float]


def preview(
    dataset_dir: Path | str,
    out: Path | str | None = None,
    pairs: int = 8,
    *,
    trusted: bool = False,
) -> Path:
    """Draw `pairs` samples, spread over the scenes, as noisy | clean | shadow; returns the path.

    out: the PNG to write; None is preview.png in the dataset's folder.
    trusted: leave out the check of the shards in another process; for datasets just made.
    Raises FactoryError when the folder holds no dataset, or one without samples.
    """
    directory = Path(dataset_dir)
    manifest = load_manifest(directory)
    if manifest is None:
        raise FactoryError(f"{directory}: no {MANIFEST_NAME}; give the folder of a dataset")
    if pairs < 1:
        raise FactoryError(f"pairs must be at least 1, got {pairs}")
    if manifest.shards and not trusted:
        check_in_isolation(listed_shards(directory, "all", manifest))
    chosen = spread(list(manifest_source(directory, manifest).names()), pairs)
    title = f"{manifest.samples('train')} train and {manifest.samples('test')} test pairs"
    content = draw([_load(name) for name in chosen], title, f"config {manifest.config_hash[:8]}")
    path = directory / PREVIEW_NAME if out is None else Path(out)
    # Whoever asks for a preview alone has no key dataset.dir to change.
    write_atomically(path, content, key="dataset.dir" if trusted else "--out")
    return path


def side_by_side(directories: Mapping[str, Path], out: Path, pairs: int = 4) -> None:
    """Draw `pairs` frames that two datasets, just made, have in common; both in one row.

    directories: the name of each, and its folder.
    """
    tables = {}
    for name, folder in directories.items():
        if (manifest := load_manifest(folder)) is None:
            raise FactoryError(f"{folder}: no {MANIFEST_NAME}; give the folder of a dataset")
        names = manifest_source(folder, manifest).names()
        tables[name] = {(at.location, at.scene, at.frame, at.variant): at for at in names}
    first = next(iter(tables.values()))
    common = [key for key in first if all(key in table for table in tables.values())]
    keys = [
        (at.location, at.scene, at.frame, at.variant)
        for at in spread([first[key] for key in common], pairs)
    ]
    shown = [
        replace(sample, heading=f"{name}   {sample.heading}")
        for key in keys
        for name, table in tables.items()
        for sample in [_load(table[key])]
    ]
    write_atomically(out, draw(shown, " and ".join(directories), ""), key="dataset.dir")


def spread(samples: Sequence[SampleName], count: int) -> list[SampleName]:
    """`count` samples (or all), as evenly over splits and scenes as they allow, in their order."""
    scenes: dict[tuple[str, str, str], list[int]] = {}
    for number, sample in enumerate(samples):
        scenes.setdefault((sample.split, sample.location, sample.scene), []).append(number)
    groups = list(scenes.values())
    if len(groups) > count:
        groups = [groups[(2 * k + 1) * len(groups) // (2 * count)] for k in range(count)]
    shares = [0] * len(groups)
    for _ in range(min(count, sum(map(len, groups)))):
        open_groups = [g for g, group in enumerate(groups) if shares[g] < len(group)]
        shares[min(open_groups, key=lambda g: shares[g])] += 1
    numbers = [
        group[(2 * k + 1) * len(group) // (2 * share)]
        for group, share in zip(groups, shares, strict=True)
        for k in range(share)
    ]
    return [samples[number] for number in sorted(numbers)]


def _load(name: SampleName) -> Shown:
    with reading(name.path) as file:
        images = {panel: read_image(ImageStack(file[panel]), panel, name.row) for panel in CORE}
        record = file["meta"][name.row]
        rows, columns = (
            _metric(axis.name, axis.units, axis.values, record)
            for axis in image_axes(file["noisy"])
        )
    place = " / ".join(part for part in (name.location, name.scene, name.frame) if part)
    return Shown(
        f"{name.split}   {place}   variant {name.variant}",
        images,
        VALUE_RANGES[str(images["noisy"].dtype)][1],
        (rows[1], columns[1]),
        (*_edges(columns[0]), *_edges(rows[0])[::-1]),
    )


def _metric(
    label: str, units: str, values: npt.NDArray[np.float64], record: np.void
) -> tuple[npt.NDArray[np.float64], str]:
    """An axis and its label, in metres where the sample's own scale is on record."""
    names = record.dtype.names or ()
    if units == "px" and {"metres_per_pixel", "range_max_m"} <= set(names):
        metres = values * float(record["metres_per_pixel"])
        values = float(record["range_max_m"]) - metres if label == "ahead" else metres
        units = "m"
    elif units == "1" and label == "range" and {"range_min_m", "range_max_m"} <= set(names):
        near, far = float(record["range_min_m"]), float(record["range_max_m"])
        values, units = near + values * (far - near), "m"
    return values, f"{label} [{units}]"


def _edges(values: npt.NDArray[np.float64]) -> tuple[float, float]:
    """Outer edges of the first and last pixel of an axis of pixel centres."""
    if len(values) < 2:
        return float(values[0]) - 0.5, float(values[0]) + 0.5
    first, last = values[1] - values[0], values[-1] - values[-2]
    return float(values[0] - first / 2), float(values[-1] + last / 2)


def draw(shown: Sequence[Shown], title: str, note: str) -> bytes:
    """PNG of the samples, two side by side, under a title, with a small note beside it."""
    wide = 2 if len(shown) > 1 else 1
    tall = -(-len(shown) // wide)
    first = next(iter(shown[0].images.values()))
    height = round(_PANEL * min(max(first.shape[0] / first.shape[1], 0.5), 1.6))
    block = (_LEFT + len(shown[0].images) * (_PANEL + _GAP) + _EDGE, _OVER + height + _UNDER)
    size = (wide * block[0] + _EDGE, _HEAD + tall * block[1])
    sheet = Image.new("RGB", size, BACKGROUND)
    pen = ImageDraw.Draw(sheet)
    pen.text((_EDGE, _HEAD // 2), title, TEXT, _font(26), anchor="lm")
    pen.text((size[0] - _EDGE, _HEAD // 2), note, FAINT, _font(18), anchor="rm")
    for number, sample in enumerate(shown):
        row, column = divmod(number, wide)
        x, y = column * block[0] + _LEFT, _HEAD + row * block[1] + _OVER
        pen.text((x, y - 24), sample.heading, TEXT, _font(18), anchor="lb")
        _axis_of_rows(pen, sample, x, y, height)
        for panel, name in enumerate(sample.images):
            left = x + panel * (_PANEL + _GAP)
            sheet.paste(_panel(sample, name, height), (left, y))
            _frame(pen, sample, name, left, y, height)
    buffer = io.BytesIO()
    sheet.save(buffer, "PNG", compress_level=1)
    return buffer.getvalue()


def _panel(sample: Shown, name: str, height: int) -> Image.Image:
    """A picture in colours, as large as a panel."""
    full = 1.0 if name == "shadow" else sample.full_scale
    share = np.nan_to_num(np.asarray(sample.images[name], dtype=np.float32) / np.float32(full))
    picture = Image.fromarray(np.clip(np.rint(share * 255), 0, 255).astype(np.uint8))
    smaller = picture.width > _PANEL or height < picture.height
    ways = Image.Resampling
    fitting = picture.resize((_PANEL, height), ways.BOX if smaller else ways.NEAREST)
    colours = _SHADOW if name == "shadow" else _ECHO
    return Image.fromarray(_table(colours)[np.asarray(fitting)])


def _frame(
    pen: ImageDraw.ImageDraw, sample: Shown, name: str, left: int, top: int, height: int
) -> None:
    """Outline, name and the axis of the columns."""
    west, east, _, _ = sample.extent
    bottom = top + height - 1
    pen.rectangle((left, top, left + _PANEL - 1, bottom), outline=LINE)
    pen.text((left, top - 4), name, FAINT, _font(15), anchor="lb")
    for value in _ticks(west, east):
        x = left + (value - west) / (east - west) * _PANEL
        pen.line((x, bottom, x, bottom + 4), FAINT)
        pen.text((x, bottom + 7), f"{value:g}", FAINT, _font(13), anchor="mt")
    middle = left + _PANEL / 2
    pen.text((middle, bottom + 24), sample.labels[1], FAINT, _font(15), anchor="mt")


def _axis_of_rows(
    pen: ImageDraw.ImageDraw, sample: Shown, left: int, top: int, height: int
) -> None:
    _, _, south, north = sample.extent
    pen.text((left - 7, top - 4), sample.labels[0], FAINT, _font(15), anchor="rb")
    for value in _ticks(south, north):
        y = top + (north - value) / (north - south) * height
        pen.line((left - 4, y, left, y), FAINT)
        pen.text((left - 7, y), f"{value:g}", FAINT, _font(13), anchor="rm")


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
    where, even = np.linspace(0, 1, 256), np.linspace(0, 1, len(stops))
    channels = [np.interp(where, even, stops[:, k]) for k in range(3)]
    return np.asarray(np.rint(np.stack(channels, axis=-1)), np.uint8)
