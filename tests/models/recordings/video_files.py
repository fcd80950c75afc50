"""Small videos of any codec, depth, orientation and time, written by the tests through PyAV."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

MILLISECOND = Fraction(1, 1000)


def encode(
    path: Path,
    frames: Any,
    *,
    codec: str = "ffv1",
    pixels: str = "gray",
    stored: str = "gray",
    times_ms: Sequence[int] | None = None,
    rate: int = 10,
    turned_deg: int = 0,
    container: str | None = None,
    options: dict[str, str] | None = None,
) -> Path:
    """A video of frames at their times.

    stored: FFmpeg's pixel format of the stream.  pixels: that of `frames`, (H, W) or (H, W, 3).
    times_ms: of each frame; None: by the rate.  turned_deg: counter-clockwise, by a tag.
    """
    av: Any = import_module("av")
    with av.open(str(path), "w", format=container) as output:
        stream = output.add_stream(codec, rate=rate)
        stream.height, stream.width = frames[0].shape[:2]
        stream.pix_fmt = stored
        stream.options = options or {}
        if turned_deg:
            stream.set_display_rotation(turned_deg)
        unit = Fraction(1, rate)
        if times_ms is not None:
            unit = stream.time_base = stream.codec_context.time_base = MILLISECOND
        for number, image in enumerate(frames):
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format=pixels)
            frame.pts = number if times_ms is None else int(times_ms[number])
            frame.time_base = unit
            output.mux(stream.encode(frame))
        output.mux(stream.encode(None))
    return path


def decoded(path: Path) -> list[tuple[float, np.ndarray]]:
    """(seconds, pixels as they are stored) of each frame of a file, by PyAV alone."""
    av: Any = import_module("av")
    with av.open(str(path)) as container:
        return [
            (float(frame.pts * frame.time_base), frame.to_ndarray())
            for frame in container.decode(video=0)
        ]
