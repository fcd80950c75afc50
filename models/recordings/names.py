"""Names of frames: in which order they follow each other, and which of them are one sequence.

Recorders number frames with or without leading zeros, stamp them with a clock or with seconds since
1970, and write settings before or behind the number.  Names that differ in their numbers alone are
looked at together: a time stamp orders them, or else the number that counts.  A recorder that makes
several frames a second may number all but the first behind the stamp: `170431`, `170431_1`.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from itertools import pairwise
from pathlib import Path, PurePath
from typing import NamedTuple

_NUMBER = re.compile(r"([0-9]+)")
_EPOCH_UNITS = {10: 1.0, 13: 1e-3, 16: 1e-6, 19: 1e-9}
"""Digits of a number of seconds since 1970 -> its unit, seconds."""
_EARLIEST_S = 1e9  # in 2001
_LATEST_S = 4.1e9  # in 2099
_DATE_FORMATS: dict[tuple[int, ...], tuple[str, ...]] = {
    (14,): ("%Y%m%d%H%M%S",),
    (8, 6): ("%Y%m%d%H%M%S",),
    (4, 2, 2, 6): ("%Y%m%d%H%M%S",),
    (8, 2, 2, 2): ("%Y%m%d%H%M%S",),
    (4, 2, 2, 2, 2, 2): ("%Y%m%d%H%M%S",),
    (2, 2, 4, 6): ("%d%m%Y%H%M%S", "%m%d%Y%H%M%S"),
    (2, 2, 4, 2, 2, 2): ("%d%m%Y%H%M%S", "%m%d%Y%H%M%S"),
    (4, 3, 6): ("%Y%j%H%M%S",),
    (4, 3, 2, 2, 2): ("%Y%j%H%M%S",),
    (7, 6): ("%Y%j%H%M%S",),
    (7, 2, 2, 2): ("%Y%j%H%M%S",),
    (12,): ("%y%m%d%H%M%S",),
    (6, 6): ("%y%m%d%H%M%S", "%d%m%y%H%M%S"),
    (6, 2, 2, 2): ("%y%m%d%H%M%S", "%d%m%y%H%M%S"),
    (2, 2, 2, 6): ("%y%m%d%H%M%S", "%d%m%y%H%M%S"),
    (2, 2, 2, 2, 2, 2): ("%y%m%d%H%M%S", "%d%m%y%H%M%S"),
}
"""Digits of the numbers that make up a date and a time of day -> how they may be read, the
likeliest first.  `%j` is the day of the year."""
_ONE_SUFFIX = {".jpeg": ".jpg", ".tiff": ".tif"}
_BEHIND_SECOND = re.compile(r"(?P<base>.*[0-9])(?P<mark>[_.-]| ?\()(?P<number>[0-9]+)\)?")
_DAY_S = 86400.0
_NIGHT_S = 3600.0  # frames around midnight lie no further apart
_FRACTION_MARKS = (".", ",")
_CLOCK_MARKS = ("-", "_", ".", ":", "h", "m", " ")
_NANOSECOND_DIGITS = 9
_LONGEST_DECIMAL = 7
"""Digits up to which Python prints fractions of such a second; more are whole nanoseconds."""
_NEXT_SECOND_S = 1.5  # frames of one recording have stamps that are no further apart


def natural_key(name: str) -> tuple[object, ...]:
    """Sorts names as people do: 2 before 10."""
    parts = _NUMBER.split(name)
    return (*(int(part) if place % 2 else part for place, part in enumerate(parts)), name)


def in_order(paths: Sequence[Path]) -> list[Path]:
    """Files of one folder in the order of their sequences, and of their frames in these."""
    names = [path.name for path in paths]
    return [paths[index] for sequence in sequences_of(names) for index in sequence]


def sequences_of(names: Sequence[str]) -> list[list[int]]:
    """Places of names that follow each other in time; a name that belongs to none is alone.

    Sequences, and the names within each, are in natural order or in that of their time stamps.
    """
    behind = _numbered_behind(names)
    bases = [index for index in range(len(names)) if index not in behind]
    sequences: list[list[int]] = []
    for pattern, indices in _by_pattern(names, bases).items():
        rows = [_Row(index, names[index], tuple(_digits(names[index]))) for index in indices]
        sequences += [[row.index for row in sequence] for sequence in _split(pattern, rows)]

    followers: dict[int, list[int]] = defaultdict(list)
    for index, numbered in behind.items():
        followers[numbered.base].append(index)
    for sequence in sequences:
        sequence[:] = [
            index
            for base in sequence
            for index in (base, *sorted(followers[base], key=lambda index: behind[index].number))
        ]
    return sorted(sequences, key=lambda sequence: natural_key(names[sequence[0]]))


def _by_pattern(names: Sequence[str], indices: Sequence[int]) -> dict[tuple[str, ...], list[int]]:
    """Places of names by what stands between their numbers."""
    patterns: dict[tuple[str, ...], list[int]] = defaultdict(list)
    for index in indices:
        stem, suffix = _stem_and_suffix(names[index])
        patterns[tuple(_NUMBER.split(stem + suffix)[::2])].append(index)
    return patterns


def _stem_and_suffix(name: str) -> tuple[str, str]:
    """The name in two parts; suffixes of one format are one."""
    suffix = PurePath(name).suffix
    lower = suffix.lower()
    return name.removesuffix(suffix), _ONE_SUFFIX.get(lower, lower)


class _NumberedBehind(NamedTuple):
    """A name that is another name and a number.  base: place of the other name."""

    base: int
    number: float


def _numbered_behind(names: Sequence[str]) -> dict[int, _NumberedBehind]:
    """Names that only differ from another one by a number behind it, by their place.

    These are further frames of one second, copies that a file manager numbered in brackets, and
    fractions of a whole number that is there without one.
    """
    places = {_stem_and_suffix(name): index for index, name in enumerate(names)}
    behind: dict[int, _NumberedBehind] = {}
    for index, name in enumerate(names):
        stem, suffix = _stem_and_suffix(name)
        match = _BEHIND_SECOND.fullmatch(stem)
        base = places.get((match["base"], suffix)) if match is not None else None
        if match is None or base is None:
            continue
        if match["mark"] in ("_", "-") and not _is_stamped(names[base]):
            continue
        is_fraction = match["mark"] == "."
        number = float(f"0.{match['number']}") if is_fraction else float(match["number"])
        behind[index] = _NumberedBehind(base, number)
    # A name behind one that stands behind another is no frame of that second.
    return {index: numbered for index, numbered in behind.items() if numbered.base not in behind}


def _is_stamped(name: str) -> bool:
    """Whether a name ends in a time stamp, with its suffix taken away."""
    stem, suffix = _stem_and_suffix(name)
    pattern = tuple(_NUMBER.split(stem + suffix)[::2])
    row = _Row(0, name, tuple(_digits(name)))
    stamp = _stamp_of(pattern, [row], list(range(len(row.digits))))
    digit_count = len(_digits(stem))
    return stamp is not None and stamp.fields[1] == digit_count - 1


@dataclass(frozen=True)
class _Row:
    """One name.  digits: its numbers as they are written."""

    index: int
    name: str
    digits: tuple[str, ...]

    def number(self, field: int) -> int:
        return int(self.digits[field])

    def fraction(self, field: int) -> float:
        """The number as decimals behind a point."""
        return float(f"0.{self.digits[field]}")


@dataclass(frozen=True)
class _Stamp:
    """Where time stamps stand.

    fields: first and last number that belong to them.  seconds: of each name, by its place.
    """

    fields: tuple[int, int]
    seconds: dict[int, float]


def _digits(name: str) -> list[str]:
    return _NUMBER.findall(name)


def _split(pattern: tuple[str, ...], rows: list[_Row]) -> list[list[_Row]]:
    """The sequences of names that differ in their numbers alone."""
    fields = range(len(pattern) - 1)
    varying = [field for field in fields if len({row.digits[field] for row in rows}) > 1]
    if not varying:
        return [[row] for row in rows]
    stamp = _stamp_of(pattern, rows, varying)
    if stamp is not None:
        return _by_stamp(pattern, rows, varying, stamp)
    decimal = _decimal_of(pattern, rows, varying)
    if decimal is not None:
        return [_sorted(rows, lambda row: (row.number(decimal), row.fraction(decimal + 1)))]
    counter = _counter_of(rows, varying)
    before = [field for field in varying if field < counter]
    if _is_distinct(rows, [counter]):
        before = []
    groups = _grouped(rows, lambda row: tuple(row.number(field) for field in before))
    return [_sorted(group, lambda row: (row.number(counter),)) for group in groups]


def _sorted(rows: list[_Row], key: Callable[[_Row], tuple[float, ...]]) -> list[_Row]:
    return sorted(rows, key=lambda row: (key(row), natural_key(row.name)))


def _grouped(rows: list[_Row], key: Callable[[_Row], tuple[float, ...]]) -> list[list[_Row]]:
    groups: dict[tuple[float, ...], list[_Row]] = defaultdict(list)
    for row in rows:
        groups[key(row)].append(row)
    return list(groups.values())


def _is_distinct(rows: list[_Row], fields: list[int]) -> bool:
    """Whether no two names agree in these numbers."""
    return len({tuple(row.number(field) for field in fields) for row in rows}) == len(rows)


def _decimal_of(pattern: tuple[str, ...], rows: list[_Row], varying: list[int]) -> int | None:
    """The first of two numbers that are one with decimals, such as seconds; None where none is."""
    if len(varying) != 2:
        return None
    first, second = varying
    is_one = second == first + 1 and pattern[second] == "."
    fractions = {row.digits[second] for row in rows}
    is_even = len({len(fraction) for fraction in fractions}) == 1
    # Whoever leaves out zeros leaves out all: 1.9 and 1.10 are counted.
    is_stripped = not any(len(fraction) > 1 and fraction.endswith("0") for fraction in fractions)
    is_longer = any(len(fraction) > 1 for fraction in fractions)
    return first if is_one and (is_even or (is_stripped and is_longer)) else None


def _counter_of(rows: list[_Row], varying: list[int]) -> int:
    """The number that counts frames.

    One in which all names differ, best without a gap; else the last one that counts within groups
    of the numbers before it, so that settings behind it do not matter.
    """
    distinct = [field for field in varying if _is_distinct(rows, [field])]
    for field in distinct:
        numbers = [row.number(field) for row in rows]
        if max(numbers) - min(numbers) == len(rows) - 1:
            return field
    if distinct:
        return distinct[0]
    for place in reversed(range(len(varying))):
        before = varying[:place]
        field = varying[place]
        groups = {tuple(row.number(earlier) for earlier in before) for row in rows}
        if len(rows) >= 2 * len(groups) and _is_distinct(rows, [*before, field]):
            return field
    return varying[-1]


def _stamp_of(pattern: tuple[str, ...], rows: list[_Row], varying: list[int]) -> _Stamp | None:
    """The first time stamp in the names whose seconds or fractions vary; None where none does."""
    widths = [{len(row.digits[field]) for row in rows} for field in range(len(pattern) - 1)]
    for first in range(len(widths)):
        for count, seconds_of in _readings(pattern, widths, first):
            fields = range(first, first + count)
            # The fraction of a second may be all that varies.
            if not any(field in varying for field in (*fields, first + count)):
                continue
            seconds = {row.index: seconds_of(row.digits[first : first + count]) for row in rows}
            known = {index: value for index, value in seconds.items() if value is not None}
            if len(known) == len(rows):
                if seconds_of is _seconds_of_clock:
                    known = _over_midnight(known)
                return _Stamp((first, first + count - 1), known)
    return _stamp_over_midnight(rows, varying)


def _stamp_over_midnight(rows: list[_Row], varying: list[int]) -> _Stamp | None:
    """A number of six digits that is a time of day: only midnight tells it from one that counts."""
    for field in varying:
        if {len(row.digits[field]) for row in rows} != {6} or not _is_distinct(rows, [field]):
            continue
        seconds = {row.index: _seconds_of_clock([row.digits[field]]) for row in rows}
        known = {index: value for index, value in seconds.items() if value is not None}
        later = _over_midnight(known)
        if len(known) == len(rows) and later != known:
            return _Stamp((field, field), later)
    return None


def _over_midnight(seconds: dict[int, float]) -> dict[int, float]:
    """Times of day by the place of their name; those after midnight with a day added.

    A recording goes over midnight where more than half a day within it is empty, and the frames
    before and after midnight are not.
    """
    times = sorted(set(seconds.values()))
    if len(times) < 2 or times[0] + _DAY_S - times[-1] > _NIGHT_S:
        return seconds
    gap, morning_end = max((later - earlier, earlier) for earlier, later in pairwise(times))
    if gap <= _DAY_S / 2:
        return seconds
    return {
        index: value + _DAY_S if value <= morning_end else value for index, value in seconds.items()
    }


_Reading = Callable[[Sequence[str]], float | None]


def _readings(
    pattern: tuple[str, ...], widths: list[set[int]], first: int
) -> list[tuple[int, _Reading]]:
    """How many numbers from `first` on may be a time stamp, and what reads them as seconds."""
    readings: list[tuple[int, _Reading]] = []
    if len(widths[first]) == 1 and min(widths[first]) in _EPOCH_UNITS:
        readings.append((1, _seconds_of_epoch))
    for date, formats in _DATE_FORMATS.items():
        if widths[first : first + len(date)] == [{width} for width in date]:
            readings += [(len(date), partial(_seconds_of_date, text)) for text in formats]
    between = pattern[first + 1 : first + 3]
    is_clock = widths[first : first + 3] == [{2}, {2}, {2}]
    if is_clock and all(mark in _CLOCK_MARKS for mark in between):
        readings.append((3, _seconds_of_clock))
    has_fraction = first + 1 < len(widths) and pattern[first + 1] in _FRACTION_MARKS
    if widths[first] == {6} and has_fraction:
        readings.append((1, _seconds_of_clock))
    return readings


def _seconds_of_epoch(digits: Sequence[str]) -> float | None:
    seconds = int(digits[0]) * _EPOCH_UNITS[len(digits[0])]
    return seconds if _EARLIEST_S <= seconds <= _LATEST_S else None


def _seconds_of_date(date_format: str, digits: Sequence[str]) -> float | None:
    try:
        date = datetime.strptime("".join(digits), date_format).replace(tzinfo=UTC)
    except ValueError:
        return None
    return date.timestamp() if 1970 <= date.year < 2100 else None


def _seconds_of_clock(digits: Sequence[str]) -> float | None:
    text = "".join(digits)
    hours = int(text[:2])
    minutes = int(text[2:4])
    seconds = int(text[4:])
    if hours > 23 or minutes > 59 or seconds > 60:
        return None
    return 3600.0 * hours + 60 * minutes + seconds


def _by_stamp(
    pattern: tuple[str, ...], rows: list[_Row], varying: list[int], stamp: _Stamp
) -> list[list[_Row]]:
    """Names in the order of their stamps; apart where a number before these differs."""
    first, last = stamp.fields
    before = [field for field in varying if field < first]
    behind = [field for field in range(last + 1, len(pattern) - 1)]
    is_decimal = bool(behind) and _is_decimal(pattern[last + 1], rows, last + 1)

    def moment(row: _Row) -> tuple[float, ...]:
        numbers = [float(row.number(field)) for field in behind]
        if is_decimal:
            numbers[0] = float(row.digits[last + 1].ljust(_NANOSECOND_DIGITS, "0"))
        return stamp.seconds[row.index], *numbers

    sequences: list[list[_Row]] = []
    groups = _grouped(rows, lambda row: tuple(row.number(field) for field in before))
    if 2 * len(groups) > len(rows):  # a number that counts frames, before the stamp
        groups = [rows]
    for group in groups:
        parts = [group]
        if behind and pattern[last + 1] not in _FRACTION_MARKS:
            parts = _apart_by_start(group, stamp, last + 1)
        sequences += [_sorted(part, moment) for part in parts]
    return sequences


def _is_decimal(mark: str, rows: list[_Row], field: int) -> bool:
    """Whether a number behind a point is a decimal fraction whose last zeros are left out."""
    lengths = {len(row.digits[field]) for row in rows}
    return mark in _FRACTION_MARKS and len(lengths) > 1 and max(lengths) <= _LONGEST_DECIMAL


def _apart_by_start(rows: list[_Row], stamp: _Stamp, counter: int) -> list[list[_Row]]:
    """Recordings whose names begin with when they began, and then count; else all together."""
    groups = _grouped(rows, lambda row: (stamp.seconds[row.index],))
    starts = sorted({stamp.seconds[row.index] for row in rows})
    is_recording = all(later - earlier > _NEXT_SECOND_S for earlier, later in pairwise(starts))
    for group in groups:
        numbers = sorted(row.number(counter) for row in group)
        counts = numbers == list(range(numbers[0], numbers[0] + len(numbers)))
        is_recording = is_recording and counts and numbers[0] <= 1
    return groups if is_recording and len(rows) > len(groups) else [rows]
