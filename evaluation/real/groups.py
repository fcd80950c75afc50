"""Static groups of a folder or recording, and what is judged of them: frames with references."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from ...factory.errors import FrameError
from ...factory.sonar.geometry import FanGeometry
from ...models.recordings.fan.finder import find_geometry
from ...models.recordings.static import StaticGroup, find_groups, laid_over, moving
from ..filters.base import Gray
from .shots import Mask, Shot, Stretch, sector_of

LEAST = 6
"""Frames of a group: with fewer the reference is hardly cleaner than the frames."""
MOST_OTHERS = 24
"""Frames that make a reference, those nearest in time: more would not be told from its mean."""
LEAST_LEFT = 3
"""Frames that must be left as a reference of several averaged frames."""

_MARGIN_PX = 2.0  # of the sector that does not count, beside what the scene moves
_LEAST_STILL = 0.25  # share of the sector that must stand still


@dataclass(frozen=True, eq=False)
class Group:
    """Frames of a scene that stands still.

    shifts_px: (N, 2) as `StaticGroup` has them.  geometry: of all its frames.
    where: (H, W) bool, the sector without its rim and without what moves; what is judged.
    still: share of the sector that is judged.
    """

    name: str
    shots: tuple[Shot, ...]
    shifts_px: np.ndarray
    geometry: FanGeometry | None
    where: Mask
    still: float

    @property
    def static(self) -> StaticGroup:
        """The group by places instead of shots."""
        return StaticGroup(tuple(range(len(self.shots))), self.shifts_px)

    @property
    def largest_px(self) -> float:
        """How far a frame lies from the first, at most."""
        return float(np.hypot(*self.shifts_px.T).max())


@dataclass(frozen=True, eq=False)
class Several:
    """What several frames give without any method, with a reference of none of them.

    mean, median: (H, W) of some frames; reference: (H, W), the mean of all other frames.
    """

    mean: Gray
    median: Gray
    reference: Gray


@dataclass(frozen=True, eq=False)
class Judged:
    """A frame with its nearly noise-free reference, (H, W) each; None without one.

    several: None where too few frames are left for a reference.
    """

    group: int | None
    shot: Shot
    noisy: Gray
    reference: Gray | None
    where: Mask
    geometry: FanGeometry | None
    several: Several | None = None


@dataclass(frozen=True, eq=False)
class Searched:
    """What was found in a stretch.  shots: those that can be read.  notes: for the report."""

    groups: list[Group]
    shots: list[Shot]
    notes: list[str]


def search(task: tuple[int, Stretch, int | None]) -> Searched:
    """The static groups of a stretch, of each at most so many frames, the first ones.

    task: a number that is not looked at, the stretch, and how many frames, None for all.
    Raises FactoryError for a picture that cannot be read, and a recording without readable frames.
    """
    _, stretch, limit = task
    recording = len(stretch.shots) > 1 and len({shot.path for shot in stretch.shots}) == 1
    notes = []
    shots: list[Shot] = []
    fans: list[FanGeometry | None] = []
    sectors: list[Mask] = []
    for shot in stretch.shots:
        try:
            picture, geometry = shot.read()
        except FrameError as error:
            # A recording may have damaged frames, and fewer than its header says.
            if not recording or shot.number == stretch.shots[0].number:
                raise
            notes.append(f"left out: {error}")
            continue
        if geometry is None:
            # The frames of one file have one fan.
            same = recording and bool(shots) and fans[-1] is not None
            geometry = fans[-1] if same else find_geometry(picture)
        shots.append(shot)
        fans.append(geometry)
        sectors.append(sector_of(picture, geometry))
    found = []
    pictures = _Pictures(shots)
    for static in find_groups(pictures, sectors, least=LEAST):
        group = _group(stretch.name, shots, fans, sectors, static, limit)
        if group.still < _LEAST_STILL:
            count = len(static.numbers)
            notes.append(f"{stretch.name}: {count} alike frames left out, too much of them moves")
        else:
            found.append(group)
    if len(found) > 1:
        found = [replace(one, name=f"{one.name} ({n})") for n, one in enumerate(found, start=1)]
    return Searched(found, shots, notes)


def judged(number: int, group: Group, places: Sequence[int], several: int) -> Iterator[Judged]:
    """The frames at these places of a group, each with its reference.

    several: so many frames are averaged for `Judged.several`, the frame and its neighbours; with
        0 none are.
    """
    frames = [shot.read()[0] for shot in group.shots]
    for place in places:
        near = nearest(len(frames), place, MOST_OTHERS + 1)
        laid = dict(zip(near, laid_over(frames, group.static, place, near), strict=True))
        others = [laid[one] for one in near if one != place]
        yield Judged(
            number,
            group.shots[place],
            frames[place],
            mean_of(others),
            group.where,
            group.geometry,
            _several(laid, place, several),
        )


def alone(shot: Shot) -> Judged:
    """A picture of no group: without a reference."""
    noisy, geometry = shot.read()
    geometry = geometry or find_geometry(noisy)
    return Judged(None, shot, noisy, None, sector_of(noisy, geometry), geometry)


def nearest(count: int, place: int, most: int) -> list[int]:
    """The `most` numbers below `count` around `place`, in order; at the ends more to one side."""
    first = min(max(place - most // 2, 0), max(count - most, 0))
    return list(range(first, min(first + most, count)))


def mean_of(frames: Sequence[Gray]) -> Gray:
    """(H, W) mean of (H, W) frames."""
    return np.asarray(np.mean(frames, axis=0, dtype=np.float64), np.float32)


def _several(laid: dict[int, Gray], place: int, count: int) -> Several | None:
    if count < 2:
        return None
    numbers = sorted(laid)
    chosen = {numbers[one] for one in nearest(len(numbers), numbers.index(place), count)}
    rest = [frame for number, frame in laid.items() if number not in chosen]
    if len(rest) < LEAST_LEFT:
        return None
    stack = [laid[number] for number in sorted(chosen)]
    middle = np.median(stack, axis=0)
    return Several(mean_of(stack), np.asarray(middle, np.float32), mean_of(rest))


def _group(
    name: str,
    shots: Sequence[Shot],
    fans: Sequence[FanGeometry | None],
    sectors: Sequence[Mask],
    static: StaticGroup,
    limit: int | None,
) -> Group:
    order = np.argsort(static.numbers)[:limit]
    chosen = [static.numbers[place] for place in order]
    shifts = static.shifts_px[order]
    frames = [shots[number].read()[0] for number in chosen]
    places = range(len(frames))
    laid = laid_over(frames, StaticGroup(tuple(places), shifts), 0, places)
    geometry = next((fans[number] for number in chosen if fans[number] is not None), None)
    sector = sectors[chosen[0]] if geometry is None else sector_of(frames[0], geometry)
    reach = _MARGIN_PX + np.hypot(*(shifts - shifts[0]).T).max()
    inner = _inside(sector, reach)
    where = inner & ~moving(laid, inner)
    still = float(where.sum() / max(inner.sum(), 1))
    return Group(name, tuple(shots[n] for n in chosen), shifts, geometry, where, still)


def _inside(sector: Mask, pixels: float) -> Mask:
    """What lies further than so many pixels from all that is not in the sector."""
    framed = np.pad(sector, 1).astype(np.uint8)
    distance = cv2.distanceTransform(framed, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return np.asarray(distance[1:-1, 1:-1] > pixels)


class _Pictures(Sequence[Gray]):
    """Pictures that are read when they are looked at."""

    def __init__(self, shots: Sequence[Shot]) -> None:
        self._shots = shots

    def __len__(self) -> int:
        return len(self._shots)

    def __getitem__(self, number: Any) -> Any:
        return self._shots[number].read()[0]
