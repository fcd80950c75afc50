"""Denoising of files: what comes in comes out, denoised, under its own name."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from ...factory.common.array_types import Array
from ...factory.common.errors import FactoryError, FrameError
from ...factory.common.files import write_atomically
from ..recordings import Recording, SonarFrame, open_recording
from ..recordings.arrays import ArrayFile
from ..recordings.base import ARRAY_SUFFIX
from ..recordings.device_settings import settings_in_name
from ..recordings.images import read_image
from ..recordings.inputs import InputFile
from ..recordings.portable_maps import white_of_file
from .images import Denoised, FrameShots, OutOfRange
from .job import DenoisingJob
from .reports import FileReport, fusion_columns
from .results import ResultFrame, view_of, write_result
from .shards import denoise_shards
from .temporal.stream import SequenceFrame
from .video_writer import TimedImage
from .writers import COMPARED, Compared, write_compared, write_frames, write_image

_LOSSY = (".jpg", ".jpeg")


def denoise_files(items: Sequence[InputFile], job: DenoisingJob) -> None:
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
            job.failures.append(_named(items[0], error))


def _named(item: InputFile, error: Exception) -> str:
    """What is wrong with a file, beginning with its name."""
    text = str(error)
    return text if text.startswith(str(item.source)) else f"{item.source}: {text}"


def _denoise_images(items: Sequence[InputFile], job: DenoisingJob) -> None:
    """Denoise image files, one after the other; see `_Images`."""
    images = _Images(items, job)
    for item in items:
        images.push(item)
    images.finish()


class _Images:
    """Image files that are being denoised, in the order of a sequence."""

    def __init__(self, items: Sequence[InputFile], job: DenoisingJob) -> None:
        self._items = items
        self._job = job
        # Finished files, too: what a stream learns from them is part of the bytes of the others.
        self._finished = {item for item in items if item in job.journal}
        self._sequence = job.denoising.open_sequence(alone=len(items) < 2)
        self._is_single = len(items) == 1
        self._total = FileReport(f"{items[0].relative} to {items[-1].relative.name}")

    def push(self, item: InputFile) -> None:
        """Read the next file; write those that are denoised by now."""
        try:
            image = read_image(item.source)
            place = partial(self._job.geometries.of, item)
            wanted = item not in self._finished
            settings = settings_in_name(item.source.name)
            shot = self._job.denoising.shot(
                (item, image), image, place, wanted=wanted, settings=settings
            )
        except (FactoryError, ValueError) as error:
            self._job.failures.append(_named(item, error))
            return
        self._write(self._sequence.push(shot))

    def finish(self) -> None:
        """Write the files that are left."""
        self._write(self._sequence.finish())
        for item in self._items:
            self._job.journal.amend(item, fusion_columns(self._sequence))
        if not self._is_single and self._total.frames:
            self._job.rows.append(self._total.row(self._job.denoise.name, self._sequence))

    def _write(self, results: Iterable[Denoised]) -> None:
        for denoised in results:
            item, image = denoised.key
            if item in self._finished:
                continue
            self._job.bar.update()
            report = FileReport(str(item.relative))
            report.add("", image, denoised)
            try:
                _write_results(item, image, denoised, self._job)
            except FrameError as error:
                self._job.failures.append(_named(item, error))
                continue
            self._job.done(item, report, self._job.denoise.name, is_listed=self._is_single)
            self._total.merge(report, item.relative.name)


def _write_results(item: InputFile, image: Array, denoised: Denoised, job: DenoisingJob) -> None:
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


def _denoise_recording(item: InputFile, job: DenoisingJob) -> None:
    """Denoise a video, a stack, arrays, a bag, or a sonar's own recording, ping by ping.

    Images become what `write_frames` says.  An ARIS recording and a bag become one, with the same
    headers, stamps and other topics; other recordings a folder of their name with a fan
    (NNNNNN.png) and the samples (NNNNNN_polar.png, near range first) of each ping.
    """
    path = job.out / item.relative
    if item.kind == "rosbag" and path.is_dir():
        raise FrameError(f"{path}: exists already; remove it, or give another --out")
    with _opened(item, job.topics) as recording:
        _RecordingRun(item, recording, job).write(path)


class _RecordingRun:
    """A recording that is being denoised: its frames are read, denoised and written in one pass."""

    def __init__(self, item: InputFile, recording: Recording, job: DenoisingJob) -> None:
        self._item = item
        self._recording = recording
        self._job = job
        self._sequence = job.denoising.open_sequence()
        self._shot_of = FrameShots(job.denoising, partial(job.geometries.of, item))
        self._report = FileReport(str(item.relative))
        self._shown: list[Compared] = []

    def write(self, path: Path) -> None:
        """Denoise all frames into the result at `path`, and report it."""
        bar = self._job.bar
        bar.uncounted -= 1
        bar.total += self._recording.count
        bar_end = bar.n + self._recording.count
        try:
            result = write_result(self._recording, self._item.kind, path, self._denoised_frames())
        finally:
            self._sequence.close()
        # The number of frames that a file states is often wrong.
        bar.total += bar.n - bar_end
        if self._shown:
            write_compared(self._job.out / self._item.compared, self._shown)
        for warning in filter(None, (result.note, self._recording.warning)):
            # Most begin with the path of the file.
            text = warning.removeprefix(f"{self._item.source}: ").removeprefix(f"{path}: ")
            self._job.warn(self._item, self._report, text)
        self._job.done(
            self._item,
            self._report,
            self._job.denoise.name,
            sequence=self._sequence,
            of_points=False,
            result=result.path,
        )

    def _denoised_frames(self) -> Iterator[ResultFrame]:
        """The frames of the recording with what became of their samples, in order."""
        for frame in self._recording:
            yield from self._kept(self._sequence.push(self._shot(frame)))
        yield from self._kept(self._sequence.finish())

    def _shot(self, frame: SonarFrame) -> SequenceFrame:
        try:
            return self._shot_of(frame)
        except OutOfRange as error:
            named = f"{self._item.source}: frame {frame.number}: {error}"
            raise FrameError(f"{named}; or state black and white by --levels") from error
        except ValueError as error:
            raise FrameError(f"{self._item.source}: frame {frame.number}: {error}") from error

    def _kept(self, results: Iterable[Denoised]) -> Iterator[ResultFrame]:
        for denoised in results:
            frame = denoised.key
            self._report.add(f"frame {frame.number}", frame.samples, denoised)
            if self._job.compare and frame.number < COMPARED:
                panels = frame.samples, denoised.image, denoised.removed.shown()
                self._shown.append(Compared(*(view_of(frame, panel) for panel in panels)))
            if self._job.video is not None:
                noisy = view_of(frame, frame.samples)
                self._job.video.add(noisy, view_of(frame, denoised.image), frame.time_s)
            self._job.bar.update()
            yield ResultFrame(frame, denoised.image)


def _opened(item: InputFile, topics: Sequence[str]) -> Recording:
    try:
        return open_recording(item.source, topics)
    except FactoryError as error:
        raise FrameError(str(error)) from error
