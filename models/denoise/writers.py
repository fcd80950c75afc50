"""What `denoise` writes: images, videos and stacks without loss, and sheets to compare by."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from PIL import Image, TiffImagePlugin

from ...factory.common.array_types import Array
from ...factory.common.errors import FrameError
from ...factory.common.files import whole_file, write_atomically
from ..recordings.animations import Animation
from ..recordings.arrays import ArrayFile, write_array
from ..recordings.base import FULL_SCALE, PORTABLE_SUFFIXES, Recording, swapped
from ..recordings.portable_maps import encode_portable
from ..recordings.tiff_files import DESCRIPTION, StackFile, Tags
from ..recordings.videos import VideoFile
from .animation_writer import write_animation
from .removed import SHOWN
from .video_writer import TimedImage, target_of, write_video

COMPARED = 4  # images of one file that `--compare` shows
CAPTION_PX = 20  # height of the line with the names
_GAP_PX = 4

# JPEG is lossy at any quality; at 100 the least.  WebP is without loss above 100.
_QUALITY = {
    ".jpg": (cv2.IMWRITE_JPEG_QUALITY, 100),
    ".jpeg": (cv2.IMWRITE_JPEG_QUALITY, 100),
    ".webp": (cv2.IMWRITE_WEBP_QUALITY, 101),
}


class Compared(NamedTuple):
    """Panels of one image, (H, W) or (H, W, C) of one size; uint8, uint16 or float in 0..1.

    removed: see `Removed.shown`.  clean: None where it is unknown.
    label: which of several images it is, such as `frame 12`.
    """

    noisy: Array
    denoised: Array
    removed: Array
    clean: Array | None = None
    label: str = ""

    def panels(self) -> dict[str, Array]:
        """The panels by their captions, from left to right."""
        captions = {
            "noisy": self.noisy,
            "denoised": self.denoised,
            f"removed (+-{SHOWN:g} sd of the grain)": self.removed,
            "clean": self.clean,
        }
        return {caption: panel for caption, panel in captions.items() if panel is not None}


def write_frames(path: Path, images: Iterable[TimedImage], source: Recording) -> str:
    """Write the images of a recording in order, as a file of the same kind as `source`.

    images: (H, W) or (H, W, 3) BGR uint8 or uint16; of TIFF files and arrays also float32.
    A stack becomes pages of a TIFF file, an animation one of its format, an array a .npy file, a
    video what `target_of` says.  The file appears once it is whole.

    Returns a line that says where the images are and why, if that is not `path`; mostly empty.
    Raises FactoryError when the file cannot be written.
    """
    if isinstance(source, VideoFile):
        target, note = target_of(path, source.properties)
        with whole_file(target) as partial:
            lost = write_video(partial, target.suffix.lower(), images, source.properties)
        return note or lost
    with whole_file(path) as partial:
        if isinstance(source, Animation):
            write_animation(partial, path.suffix.lower(), images, source)
        elif isinstance(source, ArrayFile):
            with partial.open("wb") as file:
                write_array(file, (timed.image for timed in images), source.stored)
        else:
            tags = source.tags if isinstance(source, StackFile) else {}
            _write_pages(partial, images, tags)
    return ""


def _write_pages(partial: Path, images: Iterable[TimedImage], tags: Tags) -> None:
    """Write a TIFF file.  tags: of each page; the description is that of the first."""
    with TiffImagePlugin.AppendingTiffWriter(str(partial), new=True) as pages:
        for number, timed in enumerate(images):
            page = Image.fromarray(np.ascontiguousarray(swapped(timed.image)))
            page_tags = TiffImagePlugin.ImageFileDirectory_v2()
            for tag, value in tags.items():
                if tag == DESCRIPTION and number > 0:
                    continue
                if isinstance(value, tuple):
                    page_tags[tag] = TiffImagePlugin.IFDRational(*value)
                else:
                    page_tags[tag] = value
            page.save(pages, format="TIFF", compression="tiff_adobe_deflate", tiffinfo=page_tags)
            pages.newFrame()


def write_image(path: Path, image: Array, *, largest: int | None = None) -> None:
    """An image by the suffix of its name.  FrameError when the format does not hold it.

    largest: number of white in a portable map whose source has its own; None: full scale.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    is_map = path.suffix.lower() in PORTABLE_SUFFIXES and image.dtype.kind == "u"
    if is_map and (image.ndim == 2 or image.shape[2] == 3):
        write_atomically(path, encode_portable(image, largest), key="--out")
        return
    try:
        done, content = cv2.imencode(path.suffix, image, _QUALITY.get(path.suffix.lower(), ()))
    except cv2.error:  # WebP has 8 bits alone
        done = False
    if not done:
        raise FrameError(f"{path}: {image.dtype} pixels do not fit this file format")
    write_atomically(path, content.tobytes(), key="--out")


def write_compared(path: Path, rows: Sequence[Compared]) -> None:
    """A sheet of panels side by side, one row an image, with captions on top and labels."""
    first, *others = rows
    lines = [side_by_side(first.panels()), *(_joined(row.panels()) for row in others)]
    for row, line in zip(rows, lines, strict=True):
        _write_caption(line[-CAPTION_PX:], row.label, 0, row.noisy.shape[1])
    write_image(path, np.vstack(lines))


def side_by_side(panels: Mapping[str, Array]) -> Array:
    """(H, W, 3) uint8: panels of one size, (H, W) or (H, W, C), under their captions."""
    line = _joined(panels)
    width = next(iter(panels.values())).shape[1]
    header = np.full((CAPTION_PX, line.shape[1], 3), 24, np.uint8)
    for number, caption in enumerate(panels):
        _write_caption(header, caption, number * (width + _GAP_PX), width)
    return np.vstack([header, line])


def _joined(panels: Mapping[str, Array]) -> Array:
    """Panels from left to right with gaps between."""
    gap = np.full((len(next(iter(panels.values()))), _GAP_PX, 3), 128, np.uint8)
    parts = [part for panel in panels.values() for part in (gap, in_colour(panel))]
    return np.hstack(parts[1:])


def _write_caption(header: Array, caption: str, left: int, width: int) -> None:
    """Draw a caption into the header, no wider than its panel."""
    if not caption:
        return
    font = cv2.FONT_HERSHEY_SIMPLEX
    (full_width, _), _ = cv2.getTextSize(caption, font, 1.0, 1)
    scale = max(0.01, min(0.45, (width - 6) / full_width))
    white = (235, 235, 235)
    position = (left + 3, CAPTION_PX - 6)
    cv2.putText(header, caption, position, font, scale, white, 1, cv2.LINE_AA)


def in_colour(image: Array) -> Array:
    """An image, uint8, uint16 or float in 0..1, as (H, W, 3) uint8."""
    full = 1.0 if image.dtype.kind == "f" else FULL_SCALE[str(image.dtype)]
    levels = np.rint(np.clip(image / full, 0, 1) * 255).astype(np.uint8)
    return levels[..., :3] if levels.ndim == 3 else np.repeat(levels[..., None], 3, axis=2)
