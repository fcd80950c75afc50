"""Denoising of one file: what comes in comes out, denoised, under its own name."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from ...factory.errors import FactoryError, FrameError
from ...factory.files import write_atomically
from ...factory.sonar.geometry import FanGeometry
from ..recordings import Frame, Recording, open_recording
from ..recordings.aris import ArisFile
from ..recordings.arrays import ArrayFile
from ..recordings.base import ARRAY_SUFFIX, FULL_SCALE
from ..recordings.fan.pings import fan_of, grey_of, polar_geometry
from ..recordings.pictures import in_unit_range, read_picture
from ..recordings.video import VideoFile
from .compared import sheet
from .inputs import Item
from .temporal import Steady
from .videos import FrameFiles

SCHEMA = "simnfnd-denoised/1"

Gray = npt.NDArray[np.float32]
Denoise = Callable[..., Gray]
"""(H, W) float32 in 0..1, and where range and bearing are, if known -> the same, denoised.

Weights that see several pictures of a scene get them as `looks`, see `Denoiser`.
"""
Find = Callable[[Item, npt.NDArray[Any]], FanGeometry | None]
"""Where range and bearing are in a picture of an item; None where that is not known."""
Tick = Callable[[], object]
"""Called after every picture."""

COMPARED = 4
"""How many pictures of one file `--compare` shows."""


def denoise_image(
    image: npt.NDArray[Any],
    denoise: Denoise,
    geometry: FanGeometry | None = None,
    looks: Sequence[npt.NDArray[Any]] = (),
) -> npt.NDArray[Any]:
    """Denoise (H, W) or (H, W, C) uint8, uint16 or float32 (0..1); same shape and dtype out.

    looks: frames in their order, the image in the middle, all of its shape and dtype, for weights
    that see several.
    Colour channels are denoised one by one (once, when they are equal); an alpha channel stays.
    Raises ValueError for another dtype or shape, NaN, and floats outside 0..1.
    """
    full = FULL_SCALE.get(str(image.dtype))
    if full is None:
        raise ValueError(f"pixels are {image.dtype}; expected {', '.join(FULL_SCALE)}")
    if image.ndim not in (2, 3) or 0 in image.shape:
        raise ValueError(f"image has shape {image.shape}; expected (H, W) or (H, W, C)")
    if image.ndim == 2:
        image, planes = image[..., np.newaxis], [look[..., np.newaxis] for look in looks]
        result = denoise_image(image, denoise, geometry, planes)
        return result[..., 0]
    colours = image[..., :3] if image.shape[2] in (3, 4) else image[..., :1]
    if image.dtype == np.float32 and not (colours.min() >= 0 and colours.max() <= 1):
        raise ValueError("float pixels must lie in 0..1; divide by full scale")
    scaled = _planes(colours, full)
    beside = [_planes(look, full) for look in looks]
    result = image.copy()
    for channel, grey in enumerate(scaled):
        if channel and np.array_equal(grey, scaled[0]):
            result[..., channel] = result[..., 0]
            continue
        seen = [look[channel] for look in beside]
        denoised = denoise(grey, geometry, looks=seen) if seen else denoise(grey, geometry)
        if full > 1:
            denoised = np.rint(denoised.astype(np.float64) * full)
        result[..., channel] = denoised.astype(image.dtype)
    return result


def _planes(colours: npt.NDArray[Any], full: float) -> list[Gray]:
    """Each colour of (H, W, C) as float32 with full scale 1."""
    return [
        np.ascontiguousarray(colours[..., one], np.float32) / np.float32(full)
        for one in range(colours.shape[2])
    ]


def denoise_file(
    item: Item,
    out: Path,
    denoise: Denoise,
    geometry_of: Find,
    *,
    compare: bool,
    tick: Tick,
    steady: Steady | None = None,
) -> None:
    """Denoise one image file into `out`.  FrameError when it cannot be read."""

    def place(picture: npt.NDArray[Any]) -> FanGeometry | None:
        return geometry_of(item, picture)

    try:
        image = read_picture(item.source)
        if image.dtype == np.float32:
            in_unit_range(image, str(item.source))
        seen = (steady or Steady()).of_picture(item, image, place)
        denoised = seen.finished(denoise_image(seen.picture, denoise, seen.geometry, seen.looks))
    except (FactoryError, ValueError) as error:
        text = str(error)
        named = text if text.startswith(str(item.source)) else f"{item.source}: {text}"
        raise FrameError(named) from error
    if item.source.suffix.lower() == ARRAY_SUFFIX:
        with ArrayFile(item.source) as array, FrameFiles(out / item.relative, None, array) as files:
            files.add(denoised)
    else:
        _write_image(out / item.relative, denoised)
    if compare:
        write_compared(out, item.relative, [(image, denoised)])
    tick()


def denoise_video(
    item: Item,
    out: Path,
    denoise: Denoise,
    geometry_of: Find,
    *,
    compare: bool,
    tick: Tick,
    steady: Steady | None = None,
) -> None:
    """Denoise a video or stack into one without loss, or into PNG files of a folder of its name.

    See `FrameFiles` for which.  FrameError when it has no frames.
    """
    shown = []
    path = out / item.relative
    with _opened(item) as recording, FrameFiles(path, rate_of(recording), recording) as files:

        def place(picture: npt.NDArray[Any]) -> FanGeometry | None:
            return geometry_of(item, picture)

        for number, seen in enumerate((steady or Steady()).of_recording(recording, place)):
            found = denoise_image(seen.picture, denoise, seen.geometry, seen.looks)
            denoised = seen.finished(found)
            files.add(denoised)
            if number < COMPARED:
                shown.append((seen.original, denoised))
            tick()
    if compare:
        write_compared(out, item.relative, shown)


def denoise_pings(
    item: Item,
    out: Path,
    denoise: Denoise,
    *,
    compare: bool,
    tick: Tick,
    steady: Steady | None = None,
) -> str:
    """Denoise a sonar's own recording, ping by ping, ranges by beams.

    An ARIS recording becomes one, with the same headers; others a folder of its name with a fan
    (NNNNNN.png) and the samples (NNNNNN_polar.png, near range first) of each ping.
    Returns a warning, mostly empty.  FrameError when it cannot be read.
    """
    shown: list[tuple[Gray, Gray]] = []

    def denoised(recording: Recording) -> Iterator[tuple[Frame, npt.NDArray[Any]]]:
        # All of a ping was measured, so no place is needed to average.
        frames = (steady or Steady()).of_recording(recording, lambda _: None)
        for seen in frames:
            frame = seen.frame
            assert frame is not None
            assert frame.beams is not None
            geometry = polar_geometry(frame.beams, len(frame.samples))
            samples = seen.finished(denoise_image(seen.picture, denoise, geometry, seen.looks))
            if compare and frame.number < COMPARED:
                after = replace(frame, samples=samples)
                fans = (fan_of(grey_of(one), frame.beams)[0] for one in (frame, after))
                shown.append((next(fans), next(fans)))
            yield frame, samples
            tick()

    path = out / item.relative
    with _opened(item) as recording:
        if isinstance(recording, ArisFile):
            path.parent.mkdir(parents=True, exist_ok=True)
            recording.rewrite((samples for _, samples in denoised(recording)), path)
        else:
            for frame, samples in denoised(recording):
                assert frame.beams is not None
                full = FULL_SCALE[str(samples.dtype)]
                fan, _ = fan_of(grey_of(replace(frame, samples=samples)), frame.beams)
                fan = np.rint(fan * full).astype(samples.dtype) if full > 1 else fan
                _write_image(path / f"{frame.number:06d}.png", fan)
                _write_image(path / f"{frame.number:06d}_polar.png", samples)
        warning = recording.warning
    if compare:
        write_compared(out, item.relative, shown)
    return warning


def rate_of(recording: Recording) -> float | None:
    """Frames a second of a video; None where that is not known."""
    return recording.rate_hz if isinstance(recording, VideoFile) else None


def _opened(item: Item) -> Recording:
    try:
        return open_recording(item.source, item.levels)
    except FactoryError as error:
        raise FrameError(str(error)) from error


# JPEG is lossy at any quality; at 100 the least.  WebP is without loss above 100.
_QUALITY = {
    ".jpg": (cv2.IMWRITE_JPEG_QUALITY, 100),
    ".jpeg": (cv2.IMWRITE_JPEG_QUALITY, 100),
    ".webp": (cv2.IMWRITE_WEBP_QUALITY, 101),
}


def _write_image(path: Path, image: npt.NDArray[Any]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        done, content = cv2.imencode(path.suffix, image, _QUALITY.get(path.suffix.lower(), ()))
    except cv2.error:  # WebP has 8 bits alone
        done = False
    if not done:
        raise FrameError(f"{path}: {image.dtype} pixels do not fit this file format")
    write_atomically(path, content.tobytes())


def write_compared(out: Path, relative: Path, rows: Sequence[Sequence[npt.NDArray[Any]]]) -> None:
    """Noisy, denoised (and clean) side by side, one row a sample."""
    _write_image(out / "compare" / relative.with_suffix(".png"), sheet(rows))
