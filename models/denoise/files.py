"""Denoising of files: what comes in comes out, denoised, under its own name."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from ...factory.common.errors import FactoryError, FrameError
from ...factory.common.files import remove_stale_temporaries, write_atomically
from ..recordings import SEQUENCES, Frame, Recording, open_recording
from ..recordings.arrays import ArrayFile
from ..recordings.base import ARRAY_SUFFIX, FULL_SCALE
from ..recordings.images import read_image
from ..recordings.inputs import Item
from ..recordings.portable_grey import white_of_file
from ..recordings.views import fan_of, grey_of
from .frame_shots import FrameShots
from .images import Denoised, Pixels
from .job import Job
from .shards import denoise_shards
from .temporal.stream import Shot
from .video_writer import TimedImage
from .writers import COMPARED, Compared, write_compared, write_frames, write_image

_LOSSY = (".jpg", ".jpeg")
_PING = re.compile(r"\d{6}(_polar)?\.png")


def denoise_files(items: Sequence[Item], job: Job) -> None:
    """Denoise image files or shards that follow each other in time, or one other file.

    Those of an earlier run are left out.
    """
    if all(item in job.journal for item in items):
        return
    if items[0].kind == "images":
        _denoise_images(items, job)
    elif items[0].kind == "shard":
        denoise_shards(items, job)
    else:
        try:
            _denoise_recording(items[0], job)
        except FrameError as error:
            job.failures.append(str(error))


def _denoise_images(items: Sequence[Item], job: Job) -> None:
    finished = {item for item in items if item in job.journal}

    def read() -> Iterator[Shot]:
        # Finished files, too: what a stream learns from them is part of the bytes of the others.
        for item in items:
            try:
                image = read_image(item.source)
                place = partial(job.geometries.of, item)
                wanted = item not in finished
                yield job.denoising.shot((item, image), image, place, wanted=wanted)
            except (FactoryError, ValueError) as error:
                text = str(error)
                named = text if text.startswith(str(item.source)) else f"{item.source}: {text}"
                job.failures.append(named)

    for denoised in job.denoising.sequence(read(), alone=len(items) < 2):
        item, image = denoised.key
        job.removed.add(str(item.relative), denoised.removed)
        job.unchanged.add(str(item.relative), image, denoised.image)
        job.inverted.add(str(item.relative), image, denoised.removed.noisy)
        try:
            _write_results(item, image, denoised, job)
            job.done(item, job.denoise.name)
        except FrameError as error:
            job.failures.append(str(error))
        job.bar.update()


def _write_results(item: Item, image: Pixels, denoised: Denoised, job: Job) -> None:
    """Write a denoised image in the form of its file, and what compares it with the noisy one."""
    path = job.out / item.relative
    if item.source.suffix.lower() == ARRAY_SUFFIX:
        with ArrayFile(item.source) as array:
            write_frames(path, [TimedImage(denoised.image)], array)
    elif item.source.suffix.lower() in _LOSSY and np.array_equal(image, denoised.image):
        write_atomically(path, item.source.read_bytes(), key="--out")
    else:
        write_image(path, denoised.image, largest=white_of_file(item.source))
    if job.video is not None:
        job.video.add(image, denoised.image)
    if job.compare:
        row = Compared(image, denoised.image, denoised.removed.shown())
        write_compared(job.out / item.compared, [row])


def _denoise_recording(item: Item, job: Job) -> None:
    """Denoise a video, a stack, arrays, a bag, or a sonar's own recording, ping by ping.

    Images become what `write_frames` says.  An ARIS recording and a bag become one, with the same
    headers, stamps and other topics; other recordings a folder of their name with a fan
    (NNNNNN.png) and the samples (NNNNNN_polar.png, near range first) of each ping.
    """
    path = job.out / item.relative
    if item.kind == "rosbag" and path.is_dir():
        raise FrameError(f"{path}: exists already; remove it, or give another --out")
    shown: list[Compared] = []
    with _opened(item, job.topics) as recording:
        finished_before = job.bar.n
        job.bar.total += recording.count
        frames = _frames(item, recording, job, shown)
        note = _write_recording(item, recording, frames, path)
        if note:
            job.warnings.append(note)
        # The number of frames that a file states is often wrong.
        job.bar.total += job.bar.n - finished_before - recording.count
        topics: tuple[str, ...] = getattr(recording, "topics", ())
        if recording.warning:
            job.warnings.append(recording.warning)
        elif len(topics) > 1 and job.denoising.frames > 1:
            job.warnings.append(
                f"{item.source}: frames of several topics were denoised one by one; choose of "
                f"{', '.join(topics)} with --topic to denoise them in time"
            )
    if shown:
        write_compared(job.out / item.compared, shown)
    job.done(item, job.denoise.name, of_points=False)


def _write_recording(
    item: Item, recording: Recording, frames: Iterator[tuple[Frame, Pixels]], path: Path
) -> str:
    """Write denoised frames in the form of their recording; returns a warning, or nothing."""
    if item.kind in SEQUENCES:
        images = (TimedImage(image, frame.time_s, frame.duration_s) for frame, image in frames)
        return write_frames(path, images, recording)
    rewrite = getattr(recording, "rewrite", None)  # of .aris and bags
    if rewrite is None:
        _write_pings(path, frames)
    else:
        path.parent.mkdir(parents=True, exist_ok=True)
        rewrite((samples for _, samples in frames), path)
    return ""


def _write_pings(folder: Path, frames: Iterable[tuple[Frame, Pixels]]) -> None:
    """A fan and the samples of each ping, or its image; those of a longer run before go."""
    remove_stale_temporaries(folder)
    written = set()
    for frame, samples in frames:
        images = {f"{frame.number:06d}": samples}
        if frame.beams is not None:
            full = FULL_SCALE[str(samples.dtype)]
            fan = _view(frame, samples)
            if full > 1:
                fan = np.rint(fan * full).astype(samples.dtype)
            images = {f"{frame.number:06d}": fan, f"{frame.number:06d}_polar": samples}
        for name, image in images.items():
            write_image(folder / f"{name}.png", image)
            written.add(f"{name}.png")
    for path in folder.glob("*.png"):
        if _PING.fullmatch(path.name) and path.name not in written:
            path.unlink()


def _opened(item: Item, topics: Sequence[str]) -> Recording:
    try:
        return open_recording(item.source, topics)
    except FactoryError as error:
        raise FrameError(str(error)) from error


def _frames(
    item: Item, recording: Recording, job: Job, shown: list[Compared]
) -> Iterator[tuple[Frame, Pixels]]:
    """Each frame and what became of it; the first are shown to compare."""
    shot_of = FrameShots(job.denoising, partial(job.geometries.of, item))

    def read() -> Iterator[Shot]:
        for frame in recording:
            try:
                yield shot_of(frame)
            except ValueError as error:
                raise FrameError(f"{item.source}: frame {frame.number}: {error}") from error

    alone = len(getattr(recording, "topics", ())) > 1
    denoised: Denoised
    for denoised in job.denoising.sequence(read(), alone=alone):
        frame = denoised.key
        job.removed.add(f"{item.relative}, frame {frame.number}", denoised.removed)
        job.unchanged.add(str(item.relative), frame.samples, denoised.image)
        job.inverted.add(str(item.relative), frame.samples, denoised.removed.noisy)
        if job.compare and frame.number < COMPARED:
            panels = frame.samples, denoised.image, denoised.removed.shown()
            shown.append(Compared(*(_view(frame, panel) for panel in panels)))
        if job.video is not None:
            before, after = (_view(frame, image) for image in (frame.samples, denoised.image))
            job.video.add(before, after, frame.time_s)
        yield frame, denoised.image
        job.bar.update()


def _view(frame: Frame, samples: Pixels) -> Pixels:
    if frame.beams is None:
        return samples
    return fan_of(grey_of(replace(frame, samples=samples)), frame.beams)[0]
