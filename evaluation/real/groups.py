"""Static groups of a folder or recording, and what is judged of them: frames with references."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np

from ...factory.common.array_types import Array, Bools
from ...factory.common.errors import FactoryError, FrameError
from ...factory.dataset.fan_geometry import FanGeometry
from ...models.denoise.temporal.likeness import LikeFrames
from ...models.recordings.fan_finder import find_geometry
from ...models.recordings.fan_tracking import FanTracker
from ...models.recordings.repeats import CopyFinder
from ...models.recordings.static import StaticGroup, find_groups, laid_over, moving
from ..judging.methods import Method
from ..judging.pairs import external_result
from ..judging.recorded import RecordedImage, Stretch, outline
from ..judging.runner import Denoised, ImageSubject
from ..metrics.fidelity import MetricError
from ..metrics.measure import Figures, Grey, MeasuredImage, likeness
from ..metrics.statistics import evenly

LEAST = 6
"""Frames of a group: with fewer the reference is hardly cleaner than the frames."""
MOST = 600
"""Frames of a folder or recording that are used, the first ones."""
MOST_OTHERS = 24
"""Frames that make a reference, those nearest in time: more would hardly change the mean."""

FOLDS = 2
FRAMES_OF_A_GROUP = 2
MOST_FRAMES = 16
"""Frames that a filter is tuned on, and of each group where there are several."""

_MARGIN_PX = 2.0  # of the sector that does not count, beside what the scene moves
_LEAST_STILL = 0.25  # share of the sector that must be static


@dataclass(frozen=True, eq=False)
class Group:
    """Frames of a static scene.

    shifts_px: (N, 2) as `StaticGroup` has them.  geometry: of all its frames.
    mask: (H, W) bool, the sector without its rim and moving objects; the pixels that are judged.
    still: share of the sector that is judged.
    """

    name: str
    shots: tuple[RecordedImage, ...]
    shifts_px: np.ndarray
    geometry: FanGeometry | None
    mask: Bools
    still: float

    @property
    def largest_px(self) -> float:
        """How far a frame lies from the first, at most."""
        return float(np.hypot(*self.shifts_px.T).max())


@dataclass(frozen=True, eq=False)
class JudgedFrame(ImageSubject):
    """An image with its nearly noise-free reference, (H, W) each; None without one.

    group: number of its static group.  fold: by filters that were tuned in the other.
    """

    group: int | None
    shot: RecordedImage
    noisy: Grey
    reference: Grey | None
    mask: Bools
    known: FanGeometry | None
    fold: int = 0

    def noisy_image(self) -> Grey:
        """See `ImageSubject`."""
        return self.noisy

    def geometry(self) -> FanGeometry | None:
        """See `ImageSubject`."""
        return self.known

    def denoise(self, method: Method, device: str) -> Denoised:
        """See `Subject`; another program's image is read."""
        if not method.images_source:
            return super().denoise(method, device)
        return external_result(Path(method.images_source), self.shot.names(), self.noisy.shape)

    def measure(self, image: Array) -> Figures:
        """Likeness to the reference, if there is one, and the figures without a truth."""
        figures = self.regions.figures(image)
        if self.reference is None:
            return figures
        alike = likeness(image, self.reference, self.mask)
        return {**alike, "gain_db": alike["psnr"] - self._noisy_psnr_db, **figures}

    @cached_property
    def regions(self) -> MeasuredImage:
        """What all methods are measured in.  Raises FactoryError for an unusable image."""
        try:
            return MeasuredImage(self.noisy, self.mask)
        except MetricError as error:
            raise FactoryError(f"{self.shot.path}: {error}; take it out") from error

    @cached_property
    def _noisy_psnr_db(self) -> float:
        assert self.reference is not None
        return likeness(self.noisy, self.reference, self.mask)["psnr"]


class Searched(NamedTuple):
    """Static groups of a stretch, its readable shots, and notes for the report."""

    groups: list[Group]
    shots: list[RecordedImage]
    notes: list[str]


def search(task: tuple[int, Stretch, int | None]) -> Searched:
    """The static groups of a stretch, of each at most this many frames, the first ones.

    task: a number that is not looked at, the stretch, and how many frames, None for all.
    Raises FactoryError for an image that cannot be read, and a recording without readable frames.
    """
    _, stretch, limit = task
    recording = len(stretch.shots) > 1 and len({shot.path for shot in stretch.shots}) == 1
    notes = []
    tracker = FanTracker()
    copy_finder = CopyFinder()
    copies = 0
    # A mean of unlike settings or levels is no reference.
    like_frames = LikeFrames(compares_levels=recording)
    shots: list[RecordedImage] = []
    fans: list[FanGeometry | None] = []
    sectors: list[Bools] = []
    for shot in stretch.shots:
        try:
            image, geometry = shot.read()
        except FrameError as error:
            # A recording may have damaged frames, and fewer than its header says.
            if not recording or shot.number == stretch.shots[0].number:
                raise
            notes.append(f"left out: {error}")
            continue
        if geometry is None:
            geometry = tracker.geometry(image) if recording else find_geometry(image)
        # The copy of a frame has its noise: as a reference it would flatter whatever keeps that.
        if copy_finder.is_copy(image):
            copies += 1
            continue
        like_frames.add(image, shot.settings())
        shots.append(shot)
        fans.append(geometry)
        sectors.append(sector_of(image, geometry))
    if copies:
        notes.append(f"{stretch.name}: {copies} frames left out that are copies of others")
    groups = []
    if note := like_frames.note(stretch.name):
        notes.append(note)
    for static in _static_groups(shots, sectors, like_frames):
        group = _group(stretch.name, shots, fans, sectors, static, limit)
        if group.still < _LEAST_STILL:
            count = len(static.numbers)
            notes.append(f"{stretch.name}: {count} alike frames left out, too much of them moves")
        else:
            groups.append(group)
    if len(groups) > 1:
        groups = [
            replace(group, name=f"{group.name} ({n})") for n, group in enumerate(groups, start=1)
        ]
    return Searched(groups, shots, notes)


def _static_groups(
    shots: Sequence[RecordedImage], sectors: Sequence[Bools], like_frames: LikeFrames
) -> Iterator[StaticGroup]:
    """The static groups of each kind of frames, by the places of all shots."""
    for places in like_frames.places:
        images = _Images([shots[place] for place in places])
        for static in find_groups(images, [sectors[place] for place in places], least=LEAST):
            numbers = tuple(places[number] for number in static.numbers)
            yield StaticGroup(numbers, static.shifts_px)


@dataclass(frozen=True)
class GroupPart:
    """What is done with a group.

    judged: places of its frames that are judged.  fold: by filters that were tuned in the other.
    tuning: fold -> places of the frames that filters are tuned on for this fold.
    """

    judged: tuple[int, ...]
    fold: int
    tuning: dict[int, tuple[int, ...]]


def parts_of(groups: Sequence[Group]) -> list[GroupPart]:
    """What is tuned on and what is judged: every other group; of a single one its two halves.

    So no filter is judged on frames that chose its parameters.
    """
    if len(groups) == 1:
        count = len(groups[0].shots)
        half = count // 2
        tuning = {0: tuple(evenly(range(half), MOST_FRAMES))}
        return [GroupPart(tuple(range(half, count)), 0, tuning)]
    # A part of many groups is enough to tune on.
    most = MOST_FRAMES // FRAMES_OF_A_GROUP
    used = {n for fold in range(FOLDS) for n in evenly(range(fold, len(groups), FOLDS), most)}
    parts = []
    for number, group in enumerate(groups):
        every = range(len(group.shots))
        next_fold = (number + 1) % FOLDS
        tuning = {next_fold: tuple(evenly(every, FRAMES_OF_A_GROUP))} if number in used else {}
        parts.append(GroupPart(tuple(every), number % FOLDS, tuning))
    return parts


def judged(
    number: int, group: Group, places: Sequence[int], fold: int = 0
) -> Iterator[JudgedFrame]:
    """The frames at these places of a group, each with the mean of the others as its reference."""
    frames = [shot.read()[0] for shot in group.shots]
    static = StaticGroup(tuple(range(len(frames))), group.shifts_px)
    for place in places:
        others = [index for index in nearest(len(frames), place, MOST_OTHERS + 1) if index != place]
        laid = laid_over(frames, static, place, others)
        reference = np.asarray(np.mean(laid, axis=0, dtype=np.float64), np.float32)
        shot = group.shots[place]
        yield JudgedFrame(number, shot, frames[place], reference, group.mask, group.geometry, fold)


def alone(shot: RecordedImage) -> JudgedFrame:
    """An image of no group: without a reference."""
    noisy, geometry = shot.read()
    geometry = geometry or find_geometry(noisy)
    return JudgedFrame(None, shot, noisy, None, sector_of(noisy, geometry), geometry)


def sector_of(image: Grey, geometry: FanGeometry | None) -> Bools:
    """(H, W) bool: the sector; where no geometry is known what lies within the lit outline."""
    return outline(image) if geometry is None else _sector(geometry, image.shape)


@lru_cache(maxsize=4)
def _sector(geometry: FanGeometry, shape: tuple[int, int]) -> Bools:
    """The frames of a recording have one sector."""
    return geometry.sector_mask(*shape)


def nearest(count: int, place: int, most: int) -> list[int]:
    """The `most` numbers below `count` around `place`, in order; at the ends more to one side."""
    first = min(max(place - most // 2, 0), max(count - most, 0))
    return list(range(first, min(first + most, count)))


def _group(
    name: str,
    shots: Sequence[RecordedImage],
    fans: Sequence[FanGeometry | None],
    sectors: Sequence[Bools],
    static: StaticGroup,
    limit: int | None,
) -> Group:
    """The frames of a static group with what is known of them.

    Its mask excludes what moves, and a rim as wide as the frames are shifted.
    """
    order = np.argsort(static.numbers)[:limit]
    chosen = [static.numbers[place] for place in order]
    shifts = static.shifts_px[order]
    frames = [shots[number].read()[0] for number in chosen]
    places = range(len(frames))
    laid = laid_over(frames, StaticGroup(tuple(places), shifts), 0, places)
    geometry = next((fans[number] for number in chosen if fans[number] is not None), None)
    sector = sectors[chosen[0]] if geometry is None else sector_of(frames[0], geometry)
    reach = _MARGIN_PX + np.hypot(*(shifts - shifts[0]).T).max()
    framed = np.pad(sector, 1).astype(np.uint8)
    distance = cv2.distanceTransform(framed, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    inner = np.asarray(distance[1:-1, 1:-1] > reach)
    static_mask = inner & ~moving(laid, inner)
    still = float(static_mask.sum() / max(inner.sum(), 1))
    return Group(name, tuple(shots[n] for n in chosen), shifts, geometry, static_mask, still)


class _Images(Sequence[Grey]):
    """Images that are read when they are looked at."""

    def __init__(self, shots: Sequence[RecordedImage]) -> None:
        self._shots = shots

    def __len__(self) -> int:
        return len(self._shots)

    def __getitem__(self, number: Any) -> Any:
        return self._shots[number].read()[0]
