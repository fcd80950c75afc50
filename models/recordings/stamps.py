"""Time stamps in the names of frames: which of their numbers are a date, a clock, or seconds."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from datetime import UTC, datetime
from functools import partial
from itertools import pairwise
from typing import NamedTuple

Reading = Callable[[Sequence[str]], float | None]
"""Digits of a stamp -> its seconds since 1970 or midnight; None where they are no such stamp."""

FRACTION_MARKS = (".", ",")
_EPOCH_UNITS = {10: 1.0, 13: 1e-3, 16: 1e-6, 19: 1e-9}
"""Digits of a number of seconds since 1970 -> its unit, seconds."""
_EARLIEST_S = 1e9  # in 2001
_LATEST_S = 4.1e9  # in 2099
_DATES: dict[tuple[int, ...], tuple[str, ...]] = {
    (8,): ("%Y%m%d", "%d%m%Y", "%m%d%Y"),
    (4, 2, 2): ("%Y%m%d",),
    (2, 2, 4): ("%d%m%Y", "%m%d%Y"),
    (4, 3): ("%Y%j",),
    (7,): ("%Y%j",),
    (6,): ("%y%m%d", "%d%m%y"),
    (2, 2, 2): ("%y%m%d", "%d%m%y"),
}
"""Digits of the numbers of a date -> how they may be read, the likeliest first.  `%j` is the day
of the year."""
_SURE_DATES = ((8,), (4, 2, 2), (2, 2, 4))
"""Those that are dates without a time of day behind them, too: counters look otherwise."""
_CLOCKS = ((2, 2, 2), (6,), *((width,) for width in range(7, 16)))
"""Digits of the numbers of a time of day, perhaps with a fraction of its second."""
_DATES_WITH_CLOCK = {
    14: (("%Y%m%d", 8), ("%d%m%Y", 8), ("%m%d%Y", 8)),
    12: (("%y%m%d", 6), ("%d%m%y", 6)),
}
"""Digits of one number -> formats of the date that it begins with, and their digits."""
_CLOCK_MARKS = ("-", "_", ".", ":", "h", "m", " ")
_CLOCK_DIGITS = 6
_CLOCKS_ALONE = (6, 9)  # digits of one number that may be a time of day
_DAY_S = 86400.0
_NIGHT_S = 3600.0  # frames around midnight lie no further apart


class Stamp(NamedTuple):
    """Where time stamps stand.

    first, last: the numbers of a name that belong to them.  seconds: of each name, in order.
    is_date: whether they tell the day alone.
    """

    first: int
    last: int
    seconds: list[float]
    is_date: bool = False


class _Place(NamedTuple):
    """Numbers that may be a stamp.

    number_count: how many.  readings: of them.  is_clock: whether they tell the time of day alone.
    is_date: whether they tell the day alone.
    """

    number_count: int
    readings: Sequence[Reading]
    is_clock: bool = False
    is_date: bool = False


def find_stamp(
    marks: Sequence[str], rows: Sequence[Sequence[str]], varying: Sequence[int]
) -> Stamp | None:
    """The first time stamp in names whose seconds or fractions vary; None where none does.

    marks: texts of the names around their numbers.  rows: digits of the numbers of each name.
    varying: the numbers in which names differ.
    """
    widths = [{len(digits) for digits in column} for column in zip(*rows, strict=True)]
    for first in range(len(widths)):
        for place in _places(marks, widths, first):
            fields = range(first, first + place.number_count)
            # The fraction of a second may be all that varies.
            fraction = [] if place.is_date else [first + place.number_count]
            if not any(field in varying for field in (*fields, *fraction)):
                continue
            seconds = _likeliest(place, [row[first : first + place.number_count] for row in rows])
            if seconds is not None:
                seconds = over_midnight(seconds) if place.is_clock else seconds
                return Stamp(first, first + place.number_count - 1, seconds, place.is_date)
    return _stamp_over_midnight(rows, widths, varying)


def _likeliest(place: _Place, stamps: Sequence[Sequence[str]]) -> list[float] | None:
    """Seconds by the reading in which they lie nearest to each other, the first of equal ones."""
    readings = []
    for reading in place.readings:
        seconds = [reading(digits) for digits in stamps]
        known = [value for value in seconds if value is not None]
        if len(known) == len(seconds):
            readings.append(known)
    return min(readings, key=lambda seconds: max(seconds) - min(seconds), default=None)


def _places(marks: Sequence[str], widths: Sequence[set[int]], first: int) -> Iterator[_Place]:
    """The stamps that may begin with a number."""
    (width, *others) = sorted(widths[first])
    if not others and width in _EPOCH_UNITS:
        yield _Place(1, [_seconds_of_epoch])
    if not others and width in _DATES_WITH_CLOCK:
        formats = _DATES_WITH_CLOCK[width]
        yield _Place(1, [partial(_seconds_of_date, *date_format) for date_format in formats])
    for date, date_formats in _DATES.items():
        for clock in _CLOCKS:
            if _has_widths(widths, first, (*date, *clock)):
                count = len(date) + len(clock)
                date_digits = sum(date)
                yield _Place(
                    count, [partial(_seconds_of_date, text, date_digits) for text in date_formats]
                )
    is_separated = all(mark in _CLOCK_MARKS for mark in marks[first + 1 : first + 3])
    if _has_widths(widths, first, (2, 2, 2)) and is_separated:
        yield _Place(3, [_seconds_of_clock], is_clock=True)
    has_fraction = first + 1 < len(widths) and marks[first + 1] in FRACTION_MARKS
    if _has_widths(widths, first, (6,)) and has_fraction:
        yield _Place(1, [_seconds_of_clock], is_clock=True)
    for date in _SURE_DATES:
        if _has_widths(widths, first, date):
            readings = [partial(_seconds_of_date, text, 8) for text in _DATES[date]]
            yield _Place(len(date), readings, is_date=True)


def _has_widths(widths: Sequence[set[int]], first: int, expected: tuple[int, ...]) -> bool:
    return list(widths[first : first + len(expected)]) == [{width} for width in expected]


def _stamp_over_midnight(
    rows: Sequence[Sequence[str]], widths: Sequence[set[int]], varying: Sequence[int]
) -> Stamp | None:
    """A number that is a time of day: only midnight tells it from one that counts."""
    for field in varying:
        texts = [row[field] for row in rows]
        is_clock = widths[field] in [{width} for width in _CLOCKS_ALONE]
        if not is_clock or len(set(texts)) < len(texts):
            continue
        seconds = [_seconds_of_clock([text]) for text in texts]
        known = [value for value in seconds if value is not None]
        later = over_midnight(known)
        if len(known) == len(rows) and later != known:
            return Stamp(field, field, later)
    return None


def over_midnight(seconds: Sequence[float]) -> list[float]:
    """Times of day; those after midnight with a day added.

    A recording goes over midnight where more than half a day within it is empty, and the frames
    before and after midnight are not.
    """
    times = sorted(set(seconds))
    if len(times) < 2 or times[0] + _DAY_S - times[-1] > _NIGHT_S:
        return list(seconds)
    gap, morning_end = max((later - earlier, earlier) for earlier, later in pairwise(times))
    if gap <= _DAY_S / 2:
        return list(seconds)
    return [value + _DAY_S if value <= morning_end else value for value in seconds]


def _seconds_of_epoch(digits: Sequence[str]) -> float | None:
    seconds = int(digits[0]) * _EPOCH_UNITS[len(digits[0])]
    return seconds if _EARLIEST_S <= seconds <= _LATEST_S else None


def _seconds_of_date(date_format: str, date_digits: int, digits: Sequence[str]) -> float | None:
    """Of a date of this many digits, and of the time of day behind it, if there is one."""
    text = "".join(digits)
    clock = text[date_digits:]
    clock_s = _seconds_of_clock([clock]) if clock else 0.0
    try:
        date = datetime.strptime(text[:date_digits], date_format).replace(tzinfo=UTC)
    except ValueError:
        return None
    is_date = 1970 <= date.year < 2100 and clock_s is not None
    return date.timestamp() + (clock_s or 0.0) if is_date else None


def _seconds_of_clock(digits: Sequence[str]) -> float | None:
    text = "".join(digits)
    hours = int(text[:2])
    minutes = int(text[2:4])
    seconds = int(text[4:_CLOCK_DIGITS])
    if hours > 23 or minutes > 59 or seconds > 60:
        return None
    return 3600.0 * hours + 60 * minutes + seconds + float(f"0.{text[_CLOCK_DIGITS:] or 0}")
