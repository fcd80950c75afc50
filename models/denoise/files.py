"""Denoising of files: what comes in comes out, denoised, under its own name."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ...factory.errors import FactoryError, FrameError
from ...factory.sonar.geometry import FanGeometry
from ..recordings import Frame, Recording, open_recording
from ..recordings.base import ARRAY_SUFFIX, FULL_SCALE, Beams
from ..recordings.pictures import ArrayFile, VideoFile, read_picture
from ..recordings.views import fan_of, grey_of, polar_geometry
from .inputs import Item
from .pictures import Denoising, Picture, Place, Seen
from .temporal.stream import Shot
from .writers import COMPARED, write_compared, write_frames, write_image

Find = Callable[[Item, Picture], FanGeometry | None]
"""Where range and bearing are in a picture of an item; None where that is not known."""

_FURTHEST_TURN_DEG = 20.0  # between two frames; a compass that says more is not to be trusted


@dataclass
class Job:
    """How files are denoised, and into which folder.

    topics: of bags, whose pictures; none: as `RosBag` says.  finished: of an earlier run.
    tick: called after every picture.
    """

    out: Path
    denoising: Denoising
    geometry_of: Find
    compare: bool = False
    topics: Sequence[str] = ()
    finished: frozenset[Path] = frozenset()
    tick: Callable[[], object] = field(default=lambda: None)


def denoise_files(items: Sequence[Item], job: Job) -> Iterator[tuple[Item, FrameError | None]]:
    """Denoise picture files that follow each other in time, or one.

    Gives each when it is written, and those that cannot be read with what is wrong with them.
    """
    failed: list[tuple[Item, FrameError]] = []
    left = [number for number, item in enumerate(items) if item.relative not in job.finished]
    if not left:
        return
    # A sequence that was begun goes on from a few frames before.
    first = max(0, left[0] - 2 * job.denoising.frames)

    def read() -> Iterator[Shot[Seen[Item]]]:
        for item in items[first:]:
            try:
                picture = read_picture(item.source)
                yield job.denoising.seen(item, picture, partial(job.geometry_of, item))
            except (FactoryError, ValueError) as error:
                text = str(error)
                named = text if text.startswith(str(item.source)) else f"{item.source}: {text}"
                failed.append((item, FrameError(named)))

    for seen, denoised in job.denoising.sequence(read(), alone=len(items) < 2):
        if seen.key.relative in job.finished:
            continue
        error = None
        try:
            _write_picture(seen.key, denoised, job.out)
            if job.compare:
                write_compared(job.out / seen.key.compared, [(seen.original, denoised)])
        except FrameError as found:
            error = found
        job.tick()
        yield seen.key, error
        yield from failed
        failed.clear()
    yield from failed


def denoise_recording(item: Item, job: Job) -> str:
    """Denoise a video, a stack, arrays, a bag, or a sonar's own recording, ping by ping.

    Pictures become what `write_frames` says.  An ARIS recording and a bag become one, with the same
    headers, stamps and other topics; other recordings a folder of their name with a fan
    (NNNNNN.png) and the samples (NNNNNN_polar.png, near range first) of each ping.  Frames of
    several topics of a bag are denoised one by one.
    Returns a warning, mostly empty.  FrameError when it cannot be read, or a folder of a bag's name
    is there already.
    """
    shown: list[tuple[Picture, Picture]] = []
    path = job.out / item.relative
    if item.kind == "bag" and path.is_dir():
        raise FrameError(f"{path}: is there already; remove it, or give another --out")
    with opened(item, job.topics) as recording:
        topics: tuple[str, ...] = getattr(recording, "topics", ())
        frames = _shown(_frames(item, recording, job, alone=len(topics) > 1), job, shown)
        rewrite = getattr(recording, "rewrite", None)  # of .aris and bags
        if item.kind == "video":
            rate_hz = recording.rate_hz if isinstance(recording, VideoFile) else None
            write_frames(path, (picture for _, picture in frames), rate_hz, recording)
        elif rewrite is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
            rewrite((samples for _, samples in frames), path)
        else:
            _write_pings(frames, path)
        # How many frames a video says to have is often wrong.
        warning = "" if item.kind == "video" else recording.warning
        if len(topics) > 1 and job.denoising.frames > 1 and not warning:
            warning = (
                f"{item.source}: frames of several topics were denoised one by one; choose of "
                f"{', '.join(topics)} with --topic to denoise them in time"
            )
    if shown:
        write_compared(job.out / item.compared, shown)
    return warning


def _write_pings(frames: Iterator[tuple[Frame, Picture]], path: Path) -> None:
    for frame, samples in frames:
        full = FULL_SCALE[str(samples.dtype)]
        fan = _view(frame, samples)
        fan = np.rint(fan * full).astype(samples.dtype) if full > 1 else fan
        write_image(path / f"{frame.number:06d}.png", fan)
        write_image(path / f"{frame.number:06d}_polar.png", samples)


def opened(item: Item, topics: Sequence[str] = ()) -> Recording:
    """The recording of an item.  Raises FrameError when it cannot be read or has no such topics."""
    try:
        if item.kind == "bag":
            from ..recordings.rosbag import RosBag  # loads an extra, for bags alone

            return RosBag(item.source, topics)
        return open_recording(item.source)
    except FactoryError as error:
        raise FrameError(str(error)) from error


def _frames(
    item: Item, recording: Recording, job: Job, *, alone: bool = False
) -> Iterator[tuple[Seen[Frame], Picture]]:
    """Each frame and what became of it.  FrameError names a frame that cannot be denoised."""

    def read() -> Iterator[Shot[Seen[Frame]]]:
        heading = None
        for frame in recording:
            shift, heading = _turned(frame, heading)
            place: Place = partial(job.geometry_of, item)
            if frame.beams is not None:
                place = _polar(frame.beams)
            try:
                yield job.denoising.seen(frame, frame.samples, place, shift)
            except ValueError as error:
                what = "message" if item.kind == "bag" else "frame"
                raise FrameError(f"{item.source}: {what} {frame.number}: {error}") from error

    return job.denoising.sequence(read(), alone=alone)


def _polar(beams: Beams) -> Place:
    return lambda samples: polar_geometry(beams, len(samples))


def _turned(
    frame: Frame, before_deg: float | None
) -> tuple[tuple[float, float] | None, float | None]:
    """How far a scene moved across the beams since a heading, and the heading now."""
    now_deg = frame.pose.heading_deg
    if now_deg is None or before_deg is None or frame.beams is None:
        return None, now_deg
    azimuths = frame.beams.azimuths_rad
    turned_deg = (now_deg - before_deg + 180) % 360 - 180
    if len(azimuths) < 2 or abs(turned_deg) > _FURTHEST_TURN_DEG:
        return None, now_deg
    spacing = (azimuths[-1] - azimuths[0]) / (len(azimuths) - 1)
    return (-math.radians(turned_deg) / spacing, 0.0), now_deg


def _shown(
    frames: Iterator[tuple[Seen[Frame], Picture]], job: Job, shown: list[tuple[Picture, Picture]]
) -> Iterator[tuple[Frame, Picture]]:
    """Counts frames, and keeps the first of them to compare."""
    for seen, samples in frames:
        frame = seen.key
        if job.compare and frame.number < COMPARED:
            shown.append((_view(frame, frame.samples), _view(frame, samples)))
        yield frame, samples
        job.tick()


def _view(frame: Frame, samples: Picture) -> npt.NDArray[Any]:
    if frame.beams is None:
        return samples
    return fan_of(grey_of(replace(frame, samples=samples)), frame.beams)[0]


def _write_picture(item: Item, denoised: Picture, out: Path) -> None:
    if item.source.suffix.lower() == ARRAY_SUFFIX:
        with ArrayFile(item.source) as array:
            write_frames(out / item.relative, [denoised], None, array)
    else:
        write_image(out / item.relative, denoised)
