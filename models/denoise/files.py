"""Denoising of files: what comes in comes out, denoised, under its own name."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from ...factory.common.array_types import Array
from ...factory.common.errors import FrameError
from ...factory.common.files import write_atomically
from ..recordings import Recording, SonarFrame
from ..recordings.arrays import ArrayFile
from ..recordings.base import ARRAY_SUFFIX
from ..recordings.inputs import InputFile
from ..recordings.portable_maps import white_of_file
from .blocks import BlockStore
from .images import levels_of, without_alpha
from .job import DenoisingJob
from .records import FrameRecord
from .removed import Removed
from .reports import FileReport, Kinds, frame_row
from .results import ResultFrame, view_of, write_result
from .sequences import (
    BlockwiseSequence,
    FinishedFrame,
    ImageSequence,
    RecordedFile,
    denoised_part,
    named,
)
from .shards import denoise_shards
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
        _ImageRun(items, job).write()
    elif items[0].kind == "shard":
        denoise_shards(items, job)
    else:
        try:
            _denoise_recording(items[0], job)
        except FrameError as error:
            job.failures.append(named(items[0], error))


class _ImageRun:
    """Image files of one sequence: each is written as soon as it is denoised."""

    def __init__(self, items: Sequence[InputFile], job: DenoisingJob) -> None:
        self._items = items
        self._job = job
        self._source = ImageSequence(items)
        self._finished = {number for number, item in enumerate(items) if item in job.journal}
        self._is_single = len(items) == 1
        names = f"{items[0].relative} to {items[-1].relative.name}"
        self._total = FileReport(names)
        self._kinds = Kinds()

    def write(self) -> None:
        """Denoise the files that are not finished."""
        job = self._job
        store = BlockStore.of(job.out, f"images {self._items[0].relative}", self._key())
        is_shared = job.workers > 1 and job.window > 1 and len(self._items) > job.workers
        if is_shared:
            blocks = BlockwiseSequence(
                *(self._source, store, job.means, job.options),
                workers=job.workers,
                progress=lambda: None,
            )
            frames = blocks.frames(self._source.frames(0), len(self._items))
        else:
            frames = denoised_part(self._source, job.means, 0, None, self._finished)
        for finished in frames:
            if finished.frame.number not in self._finished:
                self._keep(finished)
        store.remove()
        job.failures += [self._source.failures[number] for number in sorted(self._source.failures)]
        job.notes += self._kinds.summary()
        if not self._is_single and self._total.frames:
            job.rows.append(self._total.row(job.denoise.name))

    def _key(self) -> str:
        return self._job.journal.key(self._items[0])

    def _keep(self, finished: FinishedFrame) -> None:
        job = self._job
        frame, image, record = finished
        item = self._items[frame.number]
        job.bar.update()
        report = FileReport(str(item.relative))
        report.add("", record)
        try:
            _write_image_results(item, frame.samples, image, job)
        except FrameError as error:
            job.failures.append(named(item, error))
            return
        job.fans.add(item.source.parent, item.source, bool(record.facts.has_fan))
        job.done(item, report, job.denoise.name, is_listed=self._is_single)
        self._total.merge(report, item.relative.name)
        if record.facts.fused:
            previous = int(record.facts.previous)
            self._kinds.add(frame.number, previous, self._source.settings(frame))
        job.frame_rows.append(frame_row(str(item.relative), 0, None, record.facts))


def _write_image_results(item: InputFile, image: Array, denoised: Array, job: DenoisingJob) -> None:
    """Write a denoised image in the form of its file, and what compares it with the noisy one."""
    path = job.out / item.relative
    if item.source.suffix.lower() == ARRAY_SUFFIX:
        with ArrayFile(item.source) as array:
            write_frames(path, [TimedImage(denoised)], array)
    elif item.source.suffix.lower() in _LOSSY and np.array_equal(image, denoised):
        write_atomically(path, item.source.read_bytes(), key="--out")
    else:
        write_image(path, denoised, largest=white_of_file(item.source))
    if job.video is not None:
        job.video.add(image, denoised)
    if job.compare:
        row = Compared(image, denoised, _removed(image, denoised, job).shown())
        write_compared(job.out / item.compared, [row])


def _removed(image: Array, denoised: Array, job: DenoisingJob) -> Removed:
    """What was removed from an image, as both are stored."""
    levels = job.options.levels
    noisy, clean = (
        levels_of(without_alpha(each if levels is None else levels.scaled(each)))
        for each in (image, denoised)
    )
    return Removed(noisy, clean)


def _denoise_recording(item: InputFile, job: DenoisingJob) -> None:
    """Denoise a video, a stack, arrays, a bag, or a sonar's own recording, ping by ping.

    Images become what `write_frames` says.  An ARIS recording and a bag become one, with the same
    headers, stamps and other topics; other recordings a folder of their name with a fan
    (NNNNNN.png) and the samples (NNNNNN_polar.png, near range first) of each ping.
    """
    path = job.out / item.relative
    if item.kind == "rosbag" and path.is_dir():
        raise FrameError(f"{path}: exists already; remove it, or give another --out")
    source = RecordedFile(item, tuple(job.options.topics))
    with source.open() as recording:
        _RecordingRun(source, recording, job).write(path)


class _RecordingRun:
    """A recording that is being denoised: its frames are denoised in blocks, then written."""

    def __init__(self, source: RecordedFile, recording: Recording, job: DenoisingJob) -> None:
        self._source = source
        self._item = source.item
        self._recording = recording
        self._job = job
        self._report = FileReport(str(self._item.relative))
        self._kinds = Kinds()
        self._shown: list[Compared] = []
        self._largest_deviation = 0.0

    def write(self, path: Path) -> None:
        """Denoise all frames into the result at `path`, and report it."""
        job = self._job
        job.bar.uncounted -= 1
        job.bar.total += self._recording.count
        bar_end = job.bar.n + self._recording.count
        store = BlockStore.of(job.out, str(self._item.relative), job.journal.key(self._item))
        blocks = BlockwiseSequence(
            *(self._source, store, job.means, job.options),
            workers=job.workers,
            progress=job.bar.update,
        )
        finished = blocks.frames(self._recording, self._recording.count)
        try:
            frames = self._reported(finished)
            result = write_result(self._recording, self._item.kind, path, frames)
        except FrameError:
            store.remove()
            raise
        store.remove()
        # The number of frames that a file states is often wrong.
        job.bar.total += job.bar.n - bar_end
        if self._shown:
            write_compared(job.out / self._item.compared, self._shown)
        job.notes += self._kinds.summary()
        for warning in filter(None, (result.note, self._recording.warning)):
            # Most begin with the path of the file.
            text = warning.removeprefix(f"{self._item.source}: ").removeprefix(f"{path}: ")
            job.warn(self._item, self._report, text)
        name = job.denoise.name
        job.done(self._item, self._report, name, of_points=False, result=result.path)

    def _show(self, frame: SonarFrame, image: Array, record: FrameRecord) -> None:
        """Keep the first frames for the sheet, and the one of the most suspicious spot."""
        deviation = abs(record.structure.deviation) if record.structure else 0.0
        is_first = len(self._shown) < COMPARED - 1
        if not is_first and deviation <= self._largest_deviation:
            return
        self._largest_deviation = max(self._largest_deviation, deviation)
        removed = _removed(frame.samples, image, self._job).shown()
        shown = Compared(
            view_of(frame, frame.samples),
            view_of(frame, image),
            view_of(frame, removed),
            label=f"frame {frame.number}",
        )
        self._shown = [*self._shown[: COMPARED - 1], shown]

    def _reported(self, finished: Iterator[FinishedFrame]) -> Iterator[ResultFrame]:
        """The frames on their way to the result."""
        job = self._job
        for frame, image, record in finished:
            self._report.add(f"frame {frame.number}", record)
            if record.facts.fused:
                previous = int(record.facts.previous)
                self._kinds.add(frame.number, previous, self._source.settings(frame))
            row = frame_row(self._report.name, frame.number, frame.time_s, record.facts)
            job.frame_rows.append(row)
            if job.compare:
                self._show(frame, image, record)
            if job.video is not None:
                noisy = view_of(frame, frame.samples)
                job.video.add(noisy, view_of(frame, image), frame.time_s)
            if frame.beams is None and frame.geometry is None:
                job.fans.add(self._item.source, self._item.source, bool(record.facts.has_fan))
            yield ResultFrame(frame, image)
