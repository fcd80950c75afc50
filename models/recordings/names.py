"""Names of frames: in which order they follow each other, and which of them are one sequence.

Names that differ in their numbers alone are looked at together.  A time stamp orders them, or else
the number that counts, in natural order; a number before these that differs tells recordings apart.
A recorder that makes several frames per second may number all but the first behind the stamp:
`170431`, `170431_1`.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path, PurePath
from typing import NamedTuple

_NUMBER = re.compile(r"([0-9]+)")
_DECIMAL = re.compile(r"(.*?)\d+\.\d+")
_WHOLE = re.compile(r"(.*?)\d+")
_HALF_OF_DAY = re.compile(r"(?<=\d)\s?[ap]\.?m\b\.?", re.IGNORECASE)
_ONE_SUFFIX = {".jpeg": ".jpg", ".tiff": ".tif"}
_BEHIND_SECOND = re.compile(r"(?P<base>.*[0-9])[_-](?P<number>[0-9]+)")
_IN_BRACKETS = re.compile(r"(?P<base>.+?) ?\((?P<number>[0-9]+)\)")
_NEXT_SECOND_S = 1.5  # frames of one recording have stamps that are no further apart
_DAY_S = 86400.0

_CLOCK = (
    r"(?P<clock>\d\d?[-_.:h]\d\d?[-_.:m]\d\d?|\d{6})(?:[.,]?(?P<fraction>\d{1,9}))?"
    r"(?:\s?(?P<half>[ap])\.?m\b\.?)?"
)
_DATES = (
    *(r"\d{8}", r"\d{7}", r"\d{6}", r"\d{4}[-_.]\d\d?[-_.]\d\d?", r"\d\d?[-_.]\d\d?[-_.]\d{4}"),
    *(r"\d\d[-_.]\d\d[-_.]\d\d", r"\d{4}[-_.]\d{3}"),
)
_STAMPS = [
    [re.compile(pattern, re.IGNORECASE) for pattern in patterns]
    for patterns in (
        [r"(?<!\d)(?P<epoch>1\d{9})(?:[._](?P<fraction>\d{1,9}))?(?!\d)"],
        [rf"(?<!\d)(?P<date>{date})(?:[-_.T ]| at )?{_CLOCK}(?!\d)" for date in _DATES],
        [rf"(?<!\d)(?=\d\d?[-_.:h]\d){_CLOCK}(?!\d)"],
    )
]
"""Seconds since 1970, dates with a time of day, and a time of day alone."""
_FORMATS = {8: ("%Y%m%d", "%d%m%Y", "%m%d%Y"), 7: ("%Y%j",), 6: ("%y%m%d", "%d%m%y")}
"""Digits of a date -> how they may be read, the likeliest first.  `%j` is the day of the year."""


def natural_key(name: str) -> tuple[object, ...]:
    """Sorts names as people do: 2 before 10."""
    parts = _NUMBER.split(name)
    return (*(int(part) if index % 2 else part for index, part in enumerate(parts)), name)


def in_order(paths: Sequence[Path]) -> list[Path]:
    """Files of one folder in the order of their sequences, and of their frames in these."""
    names = [path.name for path in paths]
    return [paths[index] for sequence in sequences_of(names) for index in sequence]


def sequences_of(names: Sequence[str]) -> list[list[int]]:
    """Indices of names that follow each other in time; a name that belongs to none is alone.

    Sequences, and the names within each, are in natural order or in that of their time stamps.
    """
    parts = [_stem_and_suffix(name) for name in names]
    heads = {match[1] for stem, _ in parts if (match := _DECIMAL.fullmatch(stem)) is not None}
    rows = []
    for index, (stem, suffix) in enumerate(parts):
        # `t1` as `t1.0` where there is `t0.5`, too.
        whole = _WHOLE.fullmatch(stem)
        has_decimals = whole is not None and whole[1] in heads
        rows.append(_Row(index, f"{stem}.0" if has_decimals else stem, suffix))
    followers = _followers(rows)
    numbered = {row.index for others in followers.values() for row in others}
    patterns: dict[tuple[str, ...], list[_Row]] = defaultdict(list)
    for row in rows:
        if row.index not in numbered:
            texts = _NUMBER.split(_HALF_OF_DAY.sub("", row.stem))[::2]
            patterns[*texts, row.suffix].append(row)
    sequences = [
        [index for row in sequence for index in (row.index, *_indices(followers[row.index]))]
        for group in patterns.values()
        for sequence in _split(group)
    ]
    return sorted(sequences, key=lambda sequence: natural_key(names[sequence[0]]))


@dataclass(frozen=True)
class _Row:
    """A name in two parts; suffixes of one format are one."""

    index: int
    stem: str
    suffix: str

    @property
    def digits(self) -> list[str]:
        return _NUMBER.findall(self.stem)

    def number(self, field: int) -> int:
        return int(self.digits[field])


def _indices(rows: Sequence[_Row]) -> list[int]:
    return [row.index for row in sorted(rows, key=lambda row: natural_key(row.stem))]


def _stem_and_suffix(name: str) -> tuple[str, str]:
    suffix = PurePath(name).suffix
    lower = suffix.lower()
    return name.removesuffix(suffix), _ONE_SUFFIX.get(lower, lower)


def _followers(rows: Sequence[_Row]) -> dict[int, list[_Row]]:
    """Index of a name -> those that are it and a number: further frames of a second, and copies.

    A file manager numbers copies in brackets.
    """
    index_of = {(row.stem, row.suffix): row.index for row in rows}
    base_of: dict[int, int] = {}
    for row in rows:
        in_brackets = _IN_BRACKETS.fullmatch(row.stem)
        match = in_brackets or _BEHIND_SECOND.fullmatch(row.stem)
        base = None if match is None else index_of.get((match["base"], row.suffix))
        if base is not None and (in_brackets or _ends_in_stamp(rows[base].stem)):
            base_of[row.index] = base
    followers: dict[int, list[_Row]] = defaultdict(list)
    for index, base in base_of.items():
        if base not in base_of:  # else no frame of that second
            followers[base].append(rows[index])
    return followers


def _ends_in_stamp(stem: str) -> bool:
    patterns = [stamp.pattern for stamps in _STAMPS for stamp in stamps]
    return any(re.search(rf"{pattern}\Z", stem, re.IGNORECASE) for pattern in patterns)


def _split(rows: list[_Row]) -> list[list[_Row]]:
    """The sequences of names that differ in their numbers alone."""
    fields = range(len(rows[0].digits))
    varying = [field for field in fields if len({row.digits[field] for row in rows}) > 1]
    if not varying:
        return [[row] for row in rows]
    stamped = _stamped(rows)
    if stamped is not None:
        return _by_stamp(stamped)
    if _are_decimals(rows, varying):
        first, second = varying
        return [_sorted(rows, lambda row: (row.number(first), float(f"0.{row.digits[second]}")))]
    counter = _counter_of(rows, varying)
    before = [field for field in varying if field < counter]
    dates = [field for field in before if all(_is_date(row.digits[field]) for row in rows)]
    groups = [rows]
    if not _is_distinct(rows, [counter]):
        groups = _grouped(rows, lambda row: tuple(row.number(field) for field in before))
    return [
        _sorted(group, lambda row: tuple(row.number(field) for field in (*dates, counter)))
        for group in groups
    ]


def _sorted(rows: Sequence[_Row], key: Callable[[_Row], tuple[float, ...]]) -> list[_Row]:
    return sorted(rows, key=lambda row: (key(row), natural_key(row.stem)))


def _grouped(rows: Sequence[_Row], key: Callable[[_Row], tuple[float, ...]]) -> list[list[_Row]]:
    groups: dict[tuple[float, ...], list[_Row]] = defaultdict(list)
    for row in rows:
        groups[key(row)].append(row)
    return list(groups.values())


def _is_distinct(rows: Sequence[_Row], fields: Sequence[int]) -> bool:
    """Whether no two names agree in these numbers."""
    return len({tuple(row.number(field) for field in fields) for row in rows}) == len(rows)


def _is_date(digits: str) -> bool:
    return len(digits) == 8 and _seconds_of_date(digits, "%Y%m%d") is not None


def _are_decimals(rows: Sequence[_Row], varying: Sequence[int]) -> bool:
    """Whether the two numbers that vary are one with decimals, such as seconds."""
    if len(varying) != 2 or _NUMBER.split(rows[0].stem)[2 * varying[1]] != ".":
        return False
    fractions = {row.digits[varying[1]] for row in rows}
    if len({len(fraction) for fraction in fractions}) == 1:
        return True
    # Whoever leaves out zeros leaves out all: 1.9 and 1.10 are counted.
    return not any(len(fraction) > 1 and fraction.endswith("0") for fraction in fractions)


def _counter_of(rows: Sequence[_Row], varying: Sequence[int]) -> int:
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
        *before, field = varying[: place + 1]
        groups = {tuple(row.number(earlier) for earlier in before) for row in rows}
        if len(rows) >= 2 * len(groups) and _is_distinct(rows, [*before, field]):
            return field
    return varying[-1]


# --- time stamps


@dataclass(frozen=True)
class _Stamped:
    """A name with its time stamp.  before, behind: the text on both sides of the stamp."""

    row: _Row
    time_s: float
    before: str
    behind: str

    @property
    def moment(self) -> tuple[float, ...]:
        return self.time_s, *map(float, _NUMBER.findall(self.behind))


class _Reading(NamedTuple):
    """Times of names, by stamps read in one way."""

    times_s: list[float]
    matches: list[re.Match[str]]


def _stamped(rows: Sequence[_Row]) -> list[_Stamped] | None:
    """Names with stamps that differ, by the reading that spans the shortest time; else None."""
    readings: list[_Reading] = []
    for stamps in _STAMPS:
        readings = [reading for stamp in stamps for reading in _readings(rows, stamp)]
        if readings:
            break
    if not readings:
        return None
    best = min(readings, key=lambda reading: max(reading.times_s) - min(reading.times_s))
    return [
        _Stamped(row, time_s, row.stem[: match.start()], row.stem[match.end() :])
        for row, time_s, match in zip(rows, best.times_s, best.matches, strict=True)
    ]


def _readings(rows: Sequence[_Row], stamp: re.Pattern[str]) -> Iterator[_Reading]:
    """What a kind of stamp may say where all names have it, and not the same one."""
    matches = [match for row in rows if (match := stamp.search(row.stem)) is not None]
    if len(matches) < len(rows):
        return
    formats: Sequence[str] = ("",)
    if "date" in stamp.groupindex:
        formats = _FORMATS[len(_digits_of(matches[0]["date"]))]
    for date_format in formats:
        times_s = _times_of(matches, date_format)
        if len(times_s) == len(rows) and len(set(times_s)) > 1:
            yield _Reading(times_s, matches)


def _times_of(matches: Sequence[re.Match[str]], date_format: str) -> list[float]:
    """Seconds since 1970 or midnight of stamps; fewer where some are no such stamp."""
    texts = [match.groupdict() for match in matches]
    longest = max(len(text["fraction"] or "") for text in texts)
    times_s = []
    for text in texts:
        fraction = text["fraction"] or "0"
        # More digits than Python prints of such a second are whole nanoseconds.
        part_s = int(fraction) * 1e-9 if longest > 7 else float(f"0.{fraction}")
        if text.get("epoch"):
            times_s.append(int(text["epoch"]) + part_s)
            continue
        date_s = _seconds_of_date(_digits_of(text["date"]), date_format) if date_format else 0.0
        clock_s = _seconds_of_clock(text["clock"], text["half"])
        if date_s is None or clock_s is None:
            return []
        times_s.append(date_s + clock_s + part_s)
    return times_s if date_format or texts[0].get("epoch") else _over_midnight(times_s)


def _digits_of(text: str) -> str:
    """The digits of a date or clock, in fixed places where marks separate its numbers."""
    return "".join(number.zfill(2) for number in _NUMBER.findall(text))


def _seconds_of_date(digits: str, date_format: str) -> float | None:
    try:
        date = datetime.strptime(digits, date_format).replace(tzinfo=UTC)
    except ValueError:
        return None
    return date.timestamp() if 1970 <= date.year < 2100 else None


def _seconds_of_clock(text: str, half: str | None) -> float | None:
    digits = _digits_of(text)
    hours, minutes, seconds = (int(digits[place : place + 2]) for place in (0, 2, 4))
    if half is not None:
        hours = hours % 12 + 12 * (half.lower() == "p")
    if hours > 23 or minutes > 59 or seconds > 60:
        return None
    return 3600.0 * hours + 60 * minutes + seconds


def _over_midnight(times_s: Sequence[float]) -> list[float]:
    """Times of day; where more than half a day between them is empty, the earlier follow."""
    ordered = sorted(times_s)
    gaps = [(later - earlier, earlier) for earlier, later in pairwise(ordered)]
    gap_s, evening_s = max(gaps, default=(0.0, 0.0))
    if gap_s <= _DAY_S / 2:
        return list(times_s)
    return [time_s + _DAY_S * (time_s <= evening_s) for time_s in times_s]


def _by_stamp(stamped: Sequence[_Stamped]) -> list[list[_Row]]:
    """Names in the order of their stamps; apart where a number before these differs."""
    groups: dict[str, list[_Stamped]] = defaultdict(list)
    for name in stamped:
        groups[name.before].append(name)
    if 2 * len(groups) > len(stamped):  # a number that counts frames, before the stamp
        groups = {"": list(stamped)}
    sequences = []
    for group in groups.values():
        for part in _apart_by_start(group):
            ordered = sorted(part, key=lambda name: (name.moment, natural_key(name.row.stem)))
            sequences.append([name.row for name in ordered])
    return sequences


def _apart_by_start(group: Sequence[_Stamped]) -> list[list[_Stamped]]:
    """Recordings whose names begin with when they began, and then count; else all together."""
    starts: dict[float, list[_Stamped]] = defaultdict(list)
    for name in group:
        starts[name.time_s].append(name)
    is_recording = len(group) > len(starts) and all(
        later - earlier > _NEXT_SECOND_S for earlier, later in pairwise(sorted(starts))
    )
    for names in starts.values():
        numbers = sorted(name.moment[1] for name in names if len(name.moment) > 1)
        counts = numbers == [numbers[0] + step for step in range(len(names))] if numbers else False
        is_recording = is_recording and counts and numbers[0] <= 1
    return list(starts.values()) if is_recording else [list(group)]
