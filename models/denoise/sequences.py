"""The frames of a sequence, denoised in order: in this process, or block by block in workers.

A frame is a function of those around it, so any part of a sequence can be denoised alone: its
frames, with a margin before and after them, come out with the bytes that they have in the whole.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Generator, Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import islice
from typing import NamedTuple

from ...factory.common.array_types import Array
from ...factory.common.errors import FactoryError, FrameError
from ...factory.common.workers import tell
from ...factory.dataset.fan_geometry import FanGeometry
from ..recordings import Recording, SonarFrame, open_recording
from ..recordings.device_settings import RecordedSettings, settings_in_name, settings_of
from ..recordings.images import read_image
from ..recordings.inputs import Geometries, InputFile
from .blocks import BLOCK_FRAMES, Block, BlockFrame, BlockStore
from .denoiser import Denoiser
from .images import Denoised, Denoising, FrameShots, LevelRange, OutOfRange
from .records import FrameRecord
from .temporal.stream import MARGIN_AFTER, MARGIN_BEFORE

_SILENCE_S = 600.0  # a worker that finishes no frame for so long is ended
_MOST_BLOCKS = 4
"""Blocks of a task: each has its margins, which cost about 10 % of one block."""


@dataclass(frozen=True)
class RunOptions:
    """What decides how files are denoised; workers get it, too.

    weights, device: see `Denoiser`.  geometry, opening_deg: see `Geometries`.  topics: of bags,
    whose images; none: as `RosBag` says.  The others: see `Denoising`.
    """

    weights: str | None
    device: str
    frames: int
    causal: bool
    strength: float
    inverts: bool
    levels: LevelRange | None
    geometry: str
    opening_deg: float | None
    topics: tuple[str, ...]

    def denoising(self, denoiser: Denoiser) -> Denoising:
        """How images are denoised."""
        return Denoising(
            denoiser,
            frames=self.frames,
            causal=self.causal,
            strength=self.strength,
            inverts=self.inverts,
            level_range=self.levels,
        )


class Means(NamedTuple):
    """What a process denoises with.  at_once: see `InTime`; None: a core each."""

    denoising: Denoising
    geometries: Geometries
    at_once: int | None = None


@dataclass(frozen=True)
class RecordedFile:
    """The frames of a recording, video, stack, array or bag."""

    item: InputFile
    topics: tuple[str, ...]

    def open(self) -> Recording:
        """The recording.  Raises FrameError."""
        try:
            return open_recording(self.item.source, self.topics)
        except FactoryError as error:
            raise FrameError(str(error)) from error

    def frames(self, first: int) -> Iterator[SonarFrame]:
        """The frames from a number on.  Raises FrameError at one that cannot be used."""
        with self.open() as recording:
            yield from recording.frames_from(first)

    def settings(self, frame: SonarFrame) -> RecordedSettings:
        """What a frame says of how it was recorded."""
        return settings_of(frame)

    def geometry(
        self, geometries: Geometries, image: Array, sequence: str, number: int
    ) -> FanGeometry | None:
        """Where range and bearing are in a frame."""
        return geometries.of(self.item, image, sequence, number)

    def refuse(self, frame: SonarFrame, error: Exception) -> None:
        """Raise FrameError: a recording with a frame that cannot be denoised has no result."""
        named = f"{self.item.source}: frame {frame.number}: {error}"
        hint = "; or state black and white by --levels" * isinstance(error, OutOfRange)
        raise FrameError(named + hint) from error


class ImageSequence:
    """Image files that follow each other in time.

    failures: by number, why a file cannot be denoised; the others are.
    """

    def __init__(self, items: Sequence[InputFile]) -> None:
        self.items = items
        self.failures: dict[int, str] = {}

    def frames(self, first: int) -> Iterator[SonarFrame]:
        """The images from a number on, but for those that cannot be read."""
        for number, item in enumerate(islice(self.items, first, None), first):
            try:
                yield SonarFrame(number, read_image(item.source))
            except (FactoryError, ValueError) as error:
                self.failures[number] = named(item, error)

    def settings(self, frame: SonarFrame) -> RecordedSettings:
        """What the name of an image says of how it was recorded."""
        return settings_in_name(self.items[frame.number].source.name)

    def geometry(
        self, geometries: Geometries, image: Array, sequence: str, number: int
    ) -> FanGeometry | None:
        """Where range and bearing are in an image."""
        item = self.items[number]
        if len(self.items) == 1:
            return geometries.of(item, image)
        return geometries.of(item, image, self.items[0].source.name, number)

    def refuse(self, frame: SonarFrame, error: Exception) -> None:
        """Note that an image cannot be denoised."""
        self.failures[frame.number] = named(self.items[frame.number], error)


Source = RecordedFile | ImageSequence


def named(item: InputFile, error: Exception) -> str:
    """What is wrong with a file, beginning with its name."""
    text = str(error)
    return text if text.startswith(str(item.source)) else f"{item.source}: {text}"


class FinishedFrame(NamedTuple):
    """A frame as it is recorded, its pixels denoised, and what is known of it."""

    frame: SonarFrame
    image: Array
    record: FrameRecord


def denoised_part(
    source: Source, means: Means, first: int, last: int | None, unwanted: Collection[int] = ()
) -> Iterator[FinishedFrame]:
    """The frames of a sequence from `first` to `last` (None: its end), denoised.

    unwanted: numbers of frames that others need, but nobody else.
    Raises FrameError for a recording with a frame that cannot be used.
    """
    denoising = means.denoising
    is_single = isinstance(source, ImageSequence) and len(source.items) == 1
    start = max(0, first - MARGIN_BEFORE)
    sequence = denoising.open_sequence(alone=is_single, at_once=means.at_once)
    means.geometries.begin()
    shot_of = FrameShots(denoising, partial(source.geometry, means.geometries), source.settings)
    try:
        for frame in source.frames(start):
            if last is not None and frame.number > last + MARGIN_AFTER:
                break
            is_within = frame.number >= first and (last is None or frame.number <= last)
            wanted = is_within and frame.number not in unwanted
            try:
                shot = shot_of(frame, wanted=wanted)
            except (FactoryError, ValueError) as error:
                source.refuse(frame, error)
                continue
            for denoised in sequence.push(shot):
                yield _finished(denoised.key, denoised)
        for denoised in sequence.finish():
            yield _finished(denoised.key, denoised)
    finally:
        sequence.close()


def _finished(frame: SonarFrame, denoised: Denoised) -> FinishedFrame:
    return FinishedFrame(frame, denoised.image, FrameRecord.of(frame.samples, denoised))


class _Part(NamedTuple):
    """A task of a worker: some blocks of a sequence, by their first and last frame."""

    options: RunOptions
    source: Source
    store: BlockStore
    first: int
    last: int


@lru_cache(maxsize=2)
def _means(options: RunOptions) -> Means:
    """What a worker denoises with, the same for all of its tasks."""
    denoising = options.denoising(Denoiser(options.weights, options.device))
    return Means(denoising, Geometries(options.geometry, options.opening_deg), at_once=1)


def _denoise_part(part: _Part) -> None:
    """Denoise blocks and keep them, in a worker."""
    for _ in _kept(part.store, part.source, _means(part.options), part.first, part.last):
        tell()


def _kept(
    store: BlockStore, source: Source, means: Means, first: int, last: int | None
) -> Generator[int, None, None]:
    """Denoise frames and keep each block once it is whole; the number of every frame."""
    frames: list[BlockFrame] = []
    begin = first
    for finished in denoised_part(source, means, first, last):
        frames.append(BlockFrame(finished.image, finished.record))
        if len(frames) == BLOCK_FRAMES:
            store.write(begin, frames)
            begin += BLOCK_FRAMES
            frames = []
        yield finished.frame.number
    if frames:
        store.write(begin, frames)


class BlockwiseSequence:
    """A sequence whose blocks are denoised where they are missing, by this process or workers.

    progress: called for each frame.
    """

    def __init__(
        self,
        source: Source,
        store: BlockStore,
        means: Means,
        options: RunOptions,
        *,
        workers: int,
        progress: Callable[[], object],
    ) -> None:
        self._source = source
        self._store = store
        self._means = means
        self._options = options
        self._workers = workers
        self._progress = progress
        self._running: Generator[int, None, None] | None = None
        self._running_from = -1

    def frames(self, recorded: Iterable[SonarFrame], count: int) -> Iterator[FinishedFrame]:
        """All frames of the source, `recorded`, in order.  count: as far as the file knows."""
        with closing(self._denoised_by_workers(count)) as done:
            block = Block([], [])
            for frame in recorded:
                index = frame.number % BLOCK_FRAMES
                begin = frame.number - index
                if index == 0:
                    block = self._block(begin, done)
                try:
                    image, record = block.frame(index, frame.samples)
                except (ValueError, IndexError):
                    block = self._block_anew(begin)
                    image, record = block.frame(index, frame.samples)
                if self._running_from <= frame.number:
                    self._progress()
                yield FinishedFrame(frame, image, record)

    def _denoised_by_workers(self, count: int) -> Generator[object, None, None]:
        """Denoise all missing blocks in worker processes; something for each task that is done.

        With one worker it denoises nothing, and the caller does it block by block.
        """
        if self._workers == 1:
            return
        from ...factory.common.workers.tasks import TaskLost, TaskPool  # load psutil

        firsts = range(0, count, BLOCK_FRAMES)
        missing = [first for first in firsts if self._store.read(first) is None]
        blocks = min(max(len(missing) // (2 * self._workers), 1), _MOST_BLOCKS)
        tasks: deque[_Part] = deque()
        for first in missing:
            last = first + BLOCK_FRAMES - 1
            newest = tasks[-1] if tasks else None
            if newest and newest.last == first - 1 and first - newest.first < blocks * BLOCK_FRAMES:
                tasks[-1] = newest._replace(last=last)
            else:
                tasks.append(_Part(self._options, self._source, self._store, first, last))
        with TaskPool(self._workers) as pool:
            for part, result in pool.run(_denoise_part, tasks, lambda part: _SILENCE_S):
                if isinstance(result, TaskLost):
                    numbers = f"{part.first} to {part.last}"
                    raise FrameError(f"frames {numbers}: {result.reason}; run the command again")
                yield part

    def _block(self, first: int, done: Iterator[object]) -> Block:
        """A block, once it is on disk."""
        block = self._store.read(first)
        while block is None and next(done, None) is not None:
            block = self._store.read(first)
        return block or self._block_anew(first)

    def _block_anew(self, first: int) -> Block:
        """Denoise a block in this process; one that follows is denoised without a margin."""
        if self._running is None or self._running_from != first:
            if self._running is not None:
                self._running.close()
            self._running = _kept(self._store, self._source, self._means, first, None)
        self._running_from = first + BLOCK_FRAMES
        for number in self._running:
            self._progress()
            if number == first + BLOCK_FRAMES - 1:
                break
        block = self._store.read(first)
        if block is None:
            raise FrameError(f"{self._store.folder}: what is written there cannot be read again")
        return block
