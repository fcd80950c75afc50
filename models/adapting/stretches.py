"""Stretches of recordings with a static scene: their frames, and means of the other frames."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, groupby
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from ...factory.common.array_types import Bools, Float32s
from ...factory.common.errors import FactoryError
from ...factory.dataset.fan_geometry import FanGeometry
from ..denoise.temporal.likeness import LikeFrames
from ..recordings import Recording, SonarFrame, open_recording
from ..recordings.device_settings import RecordedSettings, settings_in_name, settings_of
from ..recordings.images import ImageFiles
from ..recordings.inputs import Geometries, InputFile, find_items, sequences
from ..recordings.palettes import grey_of_colours
from ..recordings.repeats import CopyFinder
from ..recordings.static import aligned, find_groups, laid_over, moving
from ..recordings.views import grey_of, polar_geometry, presentation_of

RUN = 16  # frames that follow each other are read together where not all can be
MOST_FRAMES = 256  # of all recordings together; of more, runs that are evenly spread are read
LEAST = 4  # fewer frames make no stretch: too little is known of the static scene
_ALIKE = 0.75  # of images in any order
_FOLLOWS = 0.3  # of frames that follow each other: raw pings of one scene have .3 to .5
_LEAST_ALIGNED = 3
_LEAST_KNOWN = 0.1  # of the sector that must be static


@dataclass(frozen=True, eq=False)
class StretchFrame:
    """One frame: (H, W) float32 in 0..1, and where range and bearing are, if that is known.

    settings: of the sonar, as far as they are stated.
    """

    grey: Float32s
    geometry: FanGeometry | None = None
    settings: RecordedSettings = field(default_factory=RecordedSettings)

    @property
    def sector(self) -> Bools:
        """(H, W) bool: what the sonar measured; all where that is not known."""
        shape = self.grey.shape
        if self.geometry is None:
            return np.ones(shape, bool)
        return self.geometry.maps(0, 0, *shape)["sector"] > 0


@dataclass(frozen=True, eq=False)
class Clip:
    """Frames in the order of time."""

    name: str
    shots: list[StretchFrame]
    shuffled: bool = False  # judged by their names, which may be anything


@dataclass
class ReadClips:
    """Frames read from recordings.

    frames: number of frames in the recordings.  skipped: a line for each frame that was not read.
    paths: of the files.  copies: number of frames left out because they are copies of others.
    notes: a line for each recording of several kinds of frames, which are clips of their own.
    """

    clips: list[Clip] = field(default_factory=list)
    paths: list[Path] = field(default_factory=list)
    frames: int = 0
    skipped: list[str] = field(default_factory=list)
    copies: int = 0
    notes: list[str] = field(default_factory=list)


def read_clips(
    paths: Sequence[Path], out: Path, geometries: Geometries, most: int = MOST_FRAMES
) -> ReadClips:
    """The frames of files, and of all files below folders but those below `out`.

    most: about this many frames are read, of more in runs that follow each other, evenly spread.
    Raises FactoryError when there are none.
    """
    items = find_items(paths, out)
    _refuse_shards(items)
    read = ReadClips(paths=[item.source for item in items])
    sources = sequences(items)
    counts = [_count_frames(source, read) for source in sources]
    read.frames = sum(counts)
    share = min(1.0, most / max(read.frames, 1))
    for source, count in zip(sources, counts, strict=True):
        shots = list(_shots(source, runs(count, share), geometries, read)) if count else []
        if shots:
            read.clips += _clips_of(source[0], shots, read)
    if not read.clips:
        more = f" ({read.skipped[0]})" if read.skipped else ""
        raise FactoryError(f"{paths[0]}: no frame can be read{more}")
    return read


def _clips_of(item: InputFile, shots: list[StretchFrame], read: ReadClips) -> Iterator[Clip]:
    """A clip of each kind of frames: the mean of frames that are unlike is no target."""
    name = item.source.name
    is_shuffled = item.kind == "images"
    like_frames = LikeFrames(compares_levels=not is_shuffled)
    for shot in shots:
        like_frames.add(shot.grey, shot.settings)
    if note := like_frames.note(name):
        read.notes.append(note)
    for places in like_frames.places:
        yield Clip(name, presented([shots[place] for place in places]), is_shuffled)


def _refuse_shards(items: Sequence[InputFile]) -> None:
    for item in items:
        if item.kind == "shard":
            raise FactoryError(
                f"{item.source}: belongs to a dataset; `simnfnd train` learns from these, and "
                "`simnfnd adapt` from recordings, videos and images"
            )


def _count_frames(source: list[InputFile], read: ReadClips) -> int:
    """Number of frames of a recording; 0, and a line in `read.skipped`, if it cannot be opened."""
    try:
        with _opened(source) as recording:
            return len(recording)
    except FactoryError as error:
        read.skipped.append(str(error))
        return 0


def presented(shots: list[StretchFrame]) -> list[StretchFrame]:
    """Return the frames of a clip as denoisers show them to the weights, all with one gain."""
    presentations = [presentation_of(shot.grey, shot.geometry) for shot in shots]
    gain = min(presentation.gain for presentation in presentations)
    shown = []
    for shot, presentation in zip(shots, presentations, strict=True):
        equalised = replace(presentation, gain=gain)
        grey = equalised.shown(shot.grey)
        shown.append(StretchFrame(grey, equalised.geometry, shot.settings))
    return shown


def runs(count: int, share: float) -> list[int]:
    """Return the numbers of about `share` of `count` frames: whole runs of `RUN`, evenly spread."""
    if share >= 1:
        return list(range(count))
    total = -(-count // RUN)
    chosen = max(1, int(share * total))
    numbers: list[int] = []
    for index in range(chosen):
        first = index * total // chosen * RUN
        numbers += range(first, min(first + RUN, count))
    return numbers


def _opened(source: list[InputFile]) -> Recording:
    path = source[0].source
    if source[0].kind == "images":
        return ImageFiles(path.parent, [item.source for item in source])
    return open_recording(path)


def _shots(
    source: list[InputFile], numbers: list[int], geometries: Geometries, read: ReadClips
) -> Iterator[StretchFrame]:
    """Frames by their numbers; notes those that are damaged, and leaves out copies of others.

    The target of a frame must not hold its copy, which has its noise.
    """
    copy_finder = CopyFinder()
    with _opened(source) as recording:
        for number in numbers:
            try:
                frame = recording[number]
            except FactoryError as error:
                read.skipped.append(str(error))
                continue
            shot = _shot_of(frame, source[number if recording.files else 0], geometries)
            if copy_finder.is_copy(shot.grey):
                read.copies += 1
            else:
                yield shot


def _shot_of(frame: SonarFrame, item: InputFile, geometries: Geometries) -> StretchFrame:
    settings = settings_in_name(item.source.name) if item.kind == "images" else settings_of(frame)
    if frame.beams is not None:
        geometry = polar_geometry(frame.beams, len(frame.samples))
        return StretchFrame(grey_of(frame), geometry, settings)
    is_grey = frame.samples.ndim == 2
    grey = grey_of(frame) if is_grey else grey_of_colours(frame.samples)
    return StretchFrame(grey, frame.geometry or geometries.of(item, grey, frame.sequence), settings)


@dataclass(frozen=True, eq=False)
class Still:
    """One stretch; its images are (H, W) float32 in 0..1."""

    frames: list[Float32s]
    targets: list[Float32s]
    """One for each frame, NaN outside the sector and on moving objects."""
    laid: list[Float32s]
    """The frames, shifted so that their scene lies where the first frame has it."""
    geometry: FanGeometry | None
    recording: int = 0

    def averaged(self, first: int, count: int) -> tuple[Float32s, Float32s]:
        """The mean of `count` frames from `first` on, and of all others, NaN where unknown."""
        own = np.mean(self.laid[first : first + count], axis=0)
        rest = np.mean(self.laid[:first] + self.laid[first + count :], axis=0)
        target = np.where(np.isfinite(self.targets[0]), rest, np.nan)
        return np.asarray(own, np.float32), np.asarray(target, np.float32)


@dataclass(frozen=True, eq=False)
class Lessons:
    """Stretches to learn from, and stretches held out to measure on."""

    learning: list[Still]
    held: list[Still]
    same: bool  # whether the frames held out belong to the only stretch there is


class _Stretch(NamedTuple):
    """The frames of a stretch that fit, and what is known of it."""

    shots: list[StretchFrame]
    still: Still


def find_lessons(clips: Sequence[Clip]) -> Lessons | None:
    """Find all stretches of the clips and hold out a fifth of them; None when there are none.

    Holds out the last fifth of the stretches of each clip that has several, or, if none has, of all
    stretches.  Of a single stretch it holds out the last fifth of the frames; figures measured on
    these flatter, because they show what was learned from.
    """
    stretches: list[_Stretch] = []
    for recording, clip in enumerate(clips):
        for shots in _stretches(clip):
            stretch = _stretch_of(shots)
            if stretch is not None:
                still = replace(stretch.still, recording=recording)
                stretches.append(stretch._replace(still=still))
    if not stretches:
        return None
    if len(stretches) == 1:
        return _split_single(stretches[0])

    stills = [stretch.still for stretch in stretches]
    parts = [list(part) for _, part in groupby(stills, key=lambda still: still.recording)]
    if all(len(part) == 1 for part in parts):
        parts = [stills]
    lessons = Lessons([], [], same=False)
    for part in parts:
        held_count = max(1, round(len(part) / 5)) if len(part) > 1 else 0
        learning_count = len(part) - held_count
        lessons.learning.extend(part[:learning_count])
        lessons.held.extend(part[learning_count:])
    return lessons


def _split_single(stretch: _Stretch) -> Lessons | None:
    """Hold out the last fifth of the frames; None when the others are no stretch by themselves."""
    held_count = max(1, len(stretch.shots) // 5)
    # The targets of frames that are learned from must not contain the frames held out.
    learning = _stretch_of(stretch.shots[:-held_count])
    if learning is None:
        return None
    still = stretch.still
    held = replace(
        still,
        frames=still.frames[-held_count:],
        targets=still.targets[-held_count:],
        laid=still.laid[-held_count:],
    )
    return Lessons([learning.still], [held], same=True)


def _stretches(clip: Clip) -> list[list[StretchFrame]]:
    """The shots of each stretch: first of frames in sequence, then of the remaining frames."""
    numbers = range(len(clip.shots))
    # Frames in sequence show one scene unless they clearly differ.
    alike = _ALIKE if clip.shuffled else _FOLLOWS
    groups: list[list[int]] = []
    for piece in np.array_split(numbers, max(1, math.ceil(len(numbers) / RUN))):
        groups += _groups(clip, piece.tolist(), alike)
    taken = set(chain(*groups))
    groups += _groups(clip, [number for number in numbers if number not in taken], _ALIKE)
    return [[clip.shots[number] for number in group] for group in sorted(groups)]


def _groups(clip: Clip, numbers: list[int], alike: float) -> list[list[int]]:
    """Numbers of frames that show one scene, in groups of about `RUN`.

    numbers: of the frames to search.  alike: see `static.find_groups`.
    """
    shots = [clip.shots[number] for number in numbers]
    greys = [shot.grey for shot in shots]
    sectors = [shot.sector for shot in shots]
    groups: list[list[int]] = []
    for group in find_groups(greys, sectors, least=LEAST, alike=alike):
        members = sorted(numbers[index] for index in group.numbers)
        parts = np.array_split(members, max(1, len(members) // RUN))
        groups += [part.tolist() for part in parts]
    return groups


def _stretch_of(shots: list[StretchFrame]) -> _Stretch | None:
    """The stretch of these shots, without those that do not fit; None when too little fits."""
    sector = shots[0].sector
    group = aligned([shot.grey for shot in shots], sector)
    if len(group.numbers) < _LEAST_ALIGNED:
        return None
    fitting = [shots[number] for number in group.numbers]
    frames = [shot.grey for shot in fitting]
    indices = range(len(frames))
    laid = laid_over(frames, group, 0, indices)

    # Where all frames show the sector and nothing moves.
    margin = 2 * math.ceil(float(np.abs(group.shifts_px).max())) + 3
    inner = cv2.erode(sector.astype(np.uint8), np.ones((margin, margin), np.uint8)).astype(bool)
    known = inner & ~moving(laid, sector)
    if known.sum() < _LEAST_KNOWN * sector.sum():
        return None

    targets = []
    for index in indices:
        others = [number for number in indices if number != index]
        mean = np.mean(laid_over(frames, group, index, others), axis=0, dtype=np.float64)
        targets.append(np.where(known, mean, np.nan).astype(np.float32))
    return _Stretch(fitting, Still(frames, targets, laid, shots[0].geometry))
