"""Denoising of files: what comes in comes out, denoised, under its own name."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial

import numpy as np

from ...factory.common.array_types import Array
from ...factory.common.errors import FactoryError, FrameError
from ...factory.common.files import write_atomically
from ...factory.dataset.fan_geometry import FanGeometry
from ..recordings import Recording, SonarFrame, open_recording
from ..recordings.arrays import ArrayFile
from ..recordings.base import ARRAY_SUFFIX
from ..recordings.device_settings import settings_in_name
from ..recordings.images import read_image
from ..recordings.inputs import InputFile
from ..recordings.portable_maps import white_of_file
from .images import Denoised, FrameShots, OutOfRange, Place
from .job import DenoisingJob
from .reports import FileReport, fusion_columns
from .results import State, open_result, view_of
from .shards import denoise_shards
from .unfinished import INTERVAL, Unfinished
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
            job.failures.append(str(error))


def _denoise_images(items: Sequence[InputFile], job: DenoisingJob) -> None:
    """Denoise image files, one after the other; see `_Images`."""
    unfinished = Unfinished(job.out, f"images {items[0].relative}", job.journal.key(items[0]))
    images = _Images(items, job, unfinished.load() if job.resumes else None)
    for number in range(images.count, len(items)):
        images.push(items[number])
        is_due = images.count % INTERVAL == 0 and images.count < len(items)
        if is_due and job.resumes and job.denoising.frames > 1:
            unfinished.save(images.state())
    images.finish()
    unfinished.remove()


class _Images:
    """Image files that are being denoised, in the order of a sequence.

    count: number of files read so far.
    """

    def __init__(self, items: Sequence[InputFile], job: DenoisingJob, state: State | None) -> None:
        """state: what `state` of an interrupted run gave; None: begin anew."""
        self._items = items
        self._job = job
        # Finished files, too: what a stream learns from them is part of the bytes of the others.
        self._finished = {item for item in items if item in job.journal}
        self._sequence = job.denoising.open_sequence(alone=len(items) < 2)
        self._is_single = len(items) == 1
        self._total = FileReport(f"{items[0].relative} to {items[-1].relative.name}")
        self.count = 0
        if state is not None:
            self._sequence.restore(state["sequence"], self._place_of)
            self._total = state["total"]
            self.count = state["count"]

    def push(self, item: InputFile) -> None:
        """Read the next file; write those that are denoised by now."""
        self.count += 1
        try:
            image = read_image(item.source)
            place = partial(self._job.geometries.of, item)
            wanted = item not in self._finished
            settings = settings_in_name(item.source.name)
            shot = self._job.denoising.shot(
                (item, image), image, place, wanted=wanted, settings=settings
            )
        except (FactoryError, ValueError) as error:
            text = str(error)
            named = text if text.startswith(str(item.source)) else f"{item.source}: {text}"
            self._job.failures.append(named)
            return
        self._write(self._sequence.push(shot))

    def state(self) -> State:
        """What another object needs to go on from here."""
        self._write(self._sequence.settle())
        return {
            "sequence": self._sequence.state(),
            "total": self._total,
            "count": self.count,
        }

    def finish(self) -> None:
        """Write the files that are left."""
        self._write(self._sequence.finish())
        for item in self._items:
            self._job.journal.amend(item, fusion_columns(self._sequence))
        if not self._is_single and self._total.frames:
            self._job.rows.append(self._total.row(self._job.denoise.name, self._sequence))

    def _place_of(self, key: tuple[InputFile, Array]) -> Place:
        return partial(self._job.geometries.of, key[0])

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
                self._job.failures.append(str(error))
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
    unfinished = Unfinished(job.out, str(item.relative), job.journal.key(item))
    try:
        with _opened(item, job.topics) as recording:
            run = _Run(item, recording, job, unfinished)
            for frame in recording.frames_from(run.frames_read):
                run.push(frame)
            run.finish()
    except FrameError:
        unfinished.remove()
        raise
    finally:
        unfinished.close()
    unfinished.remove()


class _Run:
    """A recording that is being denoised.

    frames_read: frames read so far, those of an interrupted run included.
    """

    def __init__(
        self, item: InputFile, recording: Recording, job: DenoisingJob, unfinished: Unfinished
    ) -> None:
        self._item = item
        self._recording = recording
        self._job = job
        self._unfinished = unfinished
        self._sequence = job.denoising.open_sequence()
        self._shot_of = FrameShots(job.denoising, self._place())
        self._report = FileReport(str(item.relative))
        self._shown: list[Compared] = []
        self.frames_read = 0

        state = unfinished.load() if job.resumes else None
        if state is not None:
            self._restore(state)
        path = job.out / item.relative
        result_state = None if state is None else state["result"]
        self._result = open_result(recording, item.kind, path, unfinished, result_state)
        job.bar.total += recording.count
        self._bar_end = job.bar.n + recording.count
        job.bar.update(self._report.frames)

    def push(self, frame: SonarFrame) -> None:
        """Take the next frame; keep those that are denoised by now."""
        try:
            shot = self._shot_of(frame)
        except OutOfRange as error:
            named = f"{self._item.source}: frame {frame.number}: {error}"
            raise FrameError(f"{named}; or state black and white by --levels") from error
        except ValueError as error:
            raise FrameError(f"{self._item.source}: frame {frame.number}: {error}") from error
        self._keep(self._sequence.push(shot))
        self.frames_read += 1
        if self._job.resumes and self.frames_read % INTERVAL == 0:
            self._save()

    def finish(self) -> None:
        """Write the result."""
        self._keep(self._sequence.finish())
        path = self._job.out / self._item.relative
        note = self._result.finish()
        # The number of frames that a file states is often wrong.
        self._job.bar.total += self._job.bar.n - self._bar_end
        if self._shown:
            write_compared(self._job.out / self._item.compared, self._shown)
        for warning in self._warnings(note):
            # Most begin with the path of the file.
            text = warning.removeprefix(f"{self._item.source}: ").removeprefix(f"{path}: ")
            self._job.warn(self._item, self._report, text)
        self._job.done(
            self._item,
            self._report,
            self._job.denoise.name,
            sequence=self._sequence,
            of_points=False,
            result=self._result.path,
        )

    def _warnings(self, note: str) -> Iterator[str]:
        if note:
            yield note
        if self._recording.warning:
            yield self._recording.warning

    def _keep(self, results: Iterable[Denoised]) -> None:
        for denoised in results:
            frame = denoised.key
            self._report.add(f"frame {frame.number}", frame.samples, denoised)
            if self._job.compare and frame.number < COMPARED:
                panels = frame.samples, denoised.image, denoised.removed.shown()
                self._shown.append(Compared(*(view_of(frame, panel) for panel in panels)))
            if self._job.video is not None:
                noisy = view_of(frame, frame.samples)
                self._job.video.add(noisy, view_of(frame, denoised.image), frame.time_s)
            self._result.add(frame, denoised.image)
            self._job.bar.update()

    def _save(self) -> None:
        self._keep(self._sequence.settle())
        self._unfinished.save(
            {
                "sequence": self._sequence.state(),
                "previous": self._shot_of.previous,
                "trackers": self._job.geometries.trackers_of(self._item),
                "report": self._report,
                "shown": self._shown,
                "frames_read": self.frames_read,
                "result": self._result.state(),
            }
        )

    def _restore(self, state: State) -> None:
        self._sequence.restore(
            state["sequence"], lambda frame: lambda image: self._place()(image, frame.sequence)
        )
        self._shot_of.previous = state["previous"]
        self._job.geometries.restore(state["trackers"])
        self._report = state["report"]
        self._shown = state["shown"]
        self.frames_read = state["frames_read"]
        print(f"{self._item.source}: goes on behind frame {self.frames_read}, where it was stopped")

    def _place(self) -> Callable[[Array, str], FanGeometry | None]:
        return partial(self._job.geometries.of, self._item)


def _opened(item: InputFile, topics: Sequence[str]) -> Recording:
    try:
        return open_recording(item.source, topics)
    except FactoryError as error:
        raise FrameError(str(error)) from error
