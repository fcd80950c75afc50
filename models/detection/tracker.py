"""Links moving echoes to tracks, and joins tracks that were broken."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import linear_sum_assignment

from ...factory.common.array_types import Float64s
from .frames import FrameFacts
from .moving import Deviation, Echo, echoes_in

_GATE_PX = 12.0  # from where an echo is expected, of frames `_GATE_HEIGHT_PX` high
_GATE_HEIGHT_PX = 600
_GATE_GROWTH = 0.5  # of the gate for each frame without an echo
_LONGEST_GAP = 6  # frames without an echo within a track
_JOIN_GAP = 25  # frames between the ends of broken tracks
_JOIN_OVERLAP = 12  # frames that two parts of one track share, where a body broke in two
_JOIN_GATES = 3.5  # gates between where a track would be and where another one begins
_FEWEST_TO_JOIN = 3  # echoes of a part that is joined to another one
_KEEP = 0.85  # of the velocity before, at each echo
_FEWEST = 12  # echoes of a track that counts
_LEAST_MOVE = 1.0  # net way of a track that counts, in lengths of its echo
_LEAST_SCORE = 7.0  # median peak of a track that counts, in standard deviations of the grain


@dataclass(frozen=True, eq=False)
class TrackPoint:
    """An echo of a track, and its frame."""

    frame: FrameFacts
    echo: Echo


@dataclass(eq=False)
class Track:
    """A moving object: its echoes in the order of time.

    velocity_px: (2,) x and y per frame, smoothed.
    """

    points: list[TrackPoint] = field(default_factory=list)
    velocity_px: Float64s = field(default_factory=lambda: np.zeros(2))

    @property
    def first(self) -> int:
        """Number of the first frame."""
        return self.points[0].frame.number

    @property
    def last(self) -> int:
        """Number of the last frame."""
        return self.points[-1].frame.number

    @property
    def positions_px(self) -> Float64s:
        """(N, 2) x and y of the echoes."""
        return np.array([(point.echo.x, point.echo.y) for point in self.points])

    def expected_px(self, number: int) -> Float64s:
        """(2,) where it would be in a frame, going on as it did."""
        here: Float64s = self.positions_px[-1]
        return here + self.velocity_px * (number - self.last)

    def add(self, frame: FrameFacts, echo: Echo) -> None:
        """Its echo in the next frame in which it was seen."""
        if self.points:
            step = np.array([echo.x, echo.y]) - self.positions_px[-1]
            velocity = step / max(1, frame.number - self.last)
            keep = _KEEP if len(self.points) > 1 else 0.0
            self.velocity_px = keep * self.velocity_px + (1 - keep) * velocity
        self.points.append(TrackPoint(frame, echo))


def track_echoes(deviations: Iterable[Deviation]) -> list[Track]:
    """The tracks of all moving objects that count, by their first frames."""
    open_tracks: list[Track] = []
    closed: list[Track] = []
    gate_px = _GATE_PX
    for shown, values in deviations:
        frame = shown.facts
        gate_px = _GATE_PX * max(values.shape) / _GATE_HEIGHT_PX
        echoes = echoes_in(values)
        taken = _assign(open_tracks, echoes, frame, gate_px)
        for number, echo in enumerate(echoes):
            if number not in taken:
                track = Track()
                track.add(frame, echo)
                open_tracks.append(track)
        still_open = [t for t in open_tracks if frame.number - t.last <= _LONGEST_GAP]
        closed += [track for track in open_tracks if track not in still_open]
        open_tracks = still_open
    joined = _join(closed + open_tracks, gate_px)
    return [track for track in joined if _counts(track)]


def _assign(
    tracks: Sequence[Track], echoes: Sequence[Echo], frame: FrameFacts, gate_px: float
) -> set[int]:
    """Give echoes to the tracks that expect them; returns the numbers of those echoes."""
    if not tracks or not echoes:
        return set()
    places = np.array([(echo.x, echo.y) for echo in echoes])
    expected = np.array([track.expected_px(frame.number) for track in tracks])
    gaps = np.array([frame.number - track.last for track in tracks])
    gates = gate_px * (1 + _GATE_GROWTH * (gaps - 1))
    distance = np.hypot(*np.moveaxis(expected[:, None] - places[None], 2, 0)) / gates[:, None]
    rows, columns = linear_sum_assignment(np.minimum(distance, 10.0))
    taken = set()
    for row, column in zip(rows, columns, strict=True):
        if distance[row, column] <= 1:
            tracks[row].add(frame, echoes[column])
            taken.add(int(column))
    return taken


def _join(tracks: Sequence[Track], gate_px: float) -> list[Track]:
    """Tracks whose ends and beginnings fit each other made one, nearest first."""
    parts = [track for track in tracks if len(track.points) >= _FEWEST_TO_JOIN]
    most_px = _JOIN_GATES * gate_px
    fits = [
        (misfit_px, number, other)
        for number, earlier in enumerate(parts)
        for other, later in enumerate(parts)
        if (misfit_px := _misfit_px(earlier, later)) <= most_px
    ]
    joined = dict(enumerate(parts))
    while fits:
        _, number, other = min(fits)
        joined[number] = _merged(joined[number], joined.pop(other))
        fits = [fit for fit in fits if not {number, other} & set(fit[1:])]
        for name, track in joined.items():
            if name == number:
                continue
            pairs = ((number, name, joined[number], track), (name, number, track, joined[number]))
            for first, second, earlier, later in pairs:
                if (misfit_px := _misfit_px(earlier, later)) <= most_px:
                    fits.append((misfit_px, first, second))
    return sorted(joined.values(), key=lambda track: track.first)


def _merged(earlier: Track, later: Track) -> Track:
    """Both tracks as one; of a frame that both have, the stronger echo."""
    by_frame: dict[int, TrackPoint] = {}
    for point in (*earlier.points, *later.points):
        known = by_frame.get(point.frame.number)
        if known is None or point.echo.peak > known.echo.peak:
            by_frame[point.frame.number] = point
    merged = Track()
    for number in sorted(by_frame):
        merged.add(by_frame[number].frame, by_frame[number].echo)
    return merged


def _misfit_px(earlier: Track, later: Track) -> float:
    """How far an end misses a beginning, extrapolated from both; infinite where they cannot fit."""
    gap = later.first - earlier.last
    starts_later = (earlier.first, earlier.last) < (later.first, later.last)
    if earlier is later or not starts_later or not -_JOIN_OVERLAP <= gap <= _JOIN_GAP:
        return float("inf")
    if gap <= 0:
        return _distance_px(earlier, later)
    end, beginning = earlier.positions_px[-1], later.positions_px[0]
    velocity = _mean_velocity(earlier.points[-8:]) + _mean_velocity(later.points[:8])
    return float(np.hypot(*(end + velocity / 2 * gap - beginning)))


def _distance_px(earlier: Track, later: Track) -> float:
    """Mean distance of two tracks in the frames that both span."""
    numbers = np.arange(later.first, min(earlier.last, later.last) + 1)
    places = []
    for track in (earlier, later):
        frames = [point.frame.number for point in track.points]
        places.append(np.stack([np.interp(numbers, frames, v) for v in track.positions_px.T], 1))
    return float(np.hypot(*(places[0] - places[1]).T).mean())


def _mean_velocity(points: Sequence[TrackPoint]) -> Float64s:
    first, last = points[0], points[-1]
    way = np.array([last.echo.x - first.echo.x, last.echo.y - first.echo.y])
    return np.asarray(way / max(1, last.frame.number - first.frame.number))


def _counts(track: Track) -> bool:
    """Whether a track is long enough, moves and stands out."""
    if len(track.points) < _FEWEST:
        return False
    places = track.positions_px
    length_px = float(np.median([point.echo.length_px for point in track.points]))
    net_px = float(np.hypot(*(places[-2:].mean(axis=0) - places[:2].mean(axis=0))))
    score = float(np.median([point.echo.peak for point in track.points]))
    return net_px >= _LEAST_MOVE * length_px and score >= _LEAST_SCORE
