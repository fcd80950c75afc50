"""Names of frames: in which order they follow each other, and which of them are one sequence.

Recorders number frames with or without leading zeros, stamp them with a clock or with seconds since
1970, and write settings before or behind the number.  Names that differ in their numbers alone are
looked at together: a time stamp orders them, or else the number that counts.  A recorder that makes
several frames per second may number all but the first behind the stamp: `170431`, `170431_1`.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path, PurePath
from typing import NamedTuple

from .name_forms import uniform_names
from .stamps import FRACTION_MARKS, Stamp, find_stamp

_NUMBER = re.compile(r"([0-9]+)")
_ONE_SUFFIX = {".jpeg": ".jpg", ".tiff": ".tif"}
_BEHIND_SECOND = re.compile(r"(?P<base>.*[0-9])[_-](?P<number>[0-9]+)")
_IN_BRACKETS = re.compile(r"(?P<base>.+?) ?\((?P<number>[0-9]+)\)")
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
    names = uniform_names(names)
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
    number: int


def _numbered_behind(names: Sequence[str]) -> dict[int, _NumberedBehind]:
    """Names that only differ from another one by a number behind it, by their place.

    These are further frames of one second, and copies that a file manager numbered in brackets.
    """
    places = {_stem_and_suffix(name): index for index, name in enumerate(names)}
    behind: dict[int, _NumberedBehind] = {}
    for index, name in enumerate(names):
        stem, suffix = _stem_and_suffix(name)
        in_brackets = _IN_BRACKETS.fullmatch(stem)
        match = in_brackets or _BEHIND_SECOND.fullmatch(stem)
        base = places.get((match["base"], suffix)) if match is not None else None
        if match is None or base is None:
            continue
        if in_brackets is not None or _is_stamped(names[base]):
            behind[index] = _NumberedBehind(base, int(match["number"]))
    # A name behind one that stands behind another is no frame of that second.
    return {index: numbered for index, numbered in behind.items() if numbered.base not in behind}


def _is_stamped(name: str) -> bool:
    """Whether a name ends in a time stamp, with its suffix taken away."""
    stem, suffix = _stem_and_suffix(name)
    pattern = tuple(_NUMBER.split(stem + suffix)[::2])
    digits = _digits(name)
    stamp = find_stamp(pattern, [digits], range(len(digits)))
    return stamp is not None and not stamp.is_date and stamp.last == len(_digits(stem)) - 1


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


def _digits(name: str) -> list[str]:
    return _NUMBER.findall(name)


def _split(pattern: tuple[str, ...], rows: list[_Row]) -> list[list[_Row]]:
    """The sequences of names that differ in their numbers alone."""
    fields = range(len(pattern) - 1)
    varying = [field for field in fields if len({row.digits[field] for row in rows}) > 1]
    if not varying:
        return [[row] for row in rows]
    stamp = find_stamp(pattern, [row.digits for row in rows], varying)
    if stamp is not None and not stamp.is_date:
        return _by_stamp(pattern, rows, varying, stamp)
    decimal = _decimal_of(pattern, rows, varying)
    if decimal is not None:
        return [_sorted(rows, lambda row: (row.number(decimal), row.fraction(decimal + 1)))]
    counter = _counter_of(rows, varying)
    before = [field for field in varying if field < counter]
    if _is_distinct(rows, [counter]):
        before = []
    groups = _grouped(rows, lambda row: tuple(row.number(field) for field in before))
    date_s = dict.fromkeys((row.index for row in rows), 0.0)
    if stamp is not None:
        date_s = _seconds_by_index(rows, stamp)
    return [
        _sorted(group, lambda row: (date_s[row.index], row.number(counter))) for group in groups
    ]


def _seconds_by_index(rows: list[_Row], stamp: Stamp) -> dict[int, float]:
    return {row.index: value for row, value in zip(rows, stamp.seconds, strict=True)}


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


def _by_stamp(
    pattern: tuple[str, ...], rows: list[_Row], varying: list[int], stamp: Stamp
) -> list[list[_Row]]:
    """Names in the order of their stamps; apart where a number before these differs."""
    last = stamp.last
    seconds = _seconds_by_index(rows, stamp)
    before = [field for field in varying if field < stamp.first]
    behind = [field for field in range(last + 1, len(pattern) - 1)]
    is_decimal = bool(behind) and _is_decimal(pattern[last + 1], rows, last + 1)

    def moment(row: _Row) -> tuple[float, ...]:
        numbers = [float(row.number(field)) for field in behind]
        if is_decimal:
            numbers[0] = float(row.digits[last + 1].ljust(_NANOSECOND_DIGITS, "0"))
        return seconds[row.index], *numbers

    sequences: list[list[_Row]] = []
    groups = _grouped(rows, lambda row: tuple(row.number(field) for field in before))
    if 2 * len(groups) > len(rows):  # a number that counts frames, before the stamp
        groups = [rows]
    for group in groups:
        parts = [group]
        if behind and pattern[last + 1] not in FRACTION_MARKS:
            parts = _apart_by_start(group, seconds, last + 1)
        sequences += [_sorted(part, moment) for part in parts]
    return sequences


def _is_decimal(mark: str, rows: list[_Row], field: int) -> bool:
    """Whether a number behind a point is a decimal fraction whose last zeros are left out."""
    lengths = {len(row.digits[field]) for row in rows}
    return mark in FRACTION_MARKS and len(lengths) > 1 and max(lengths) <= _LONGEST_DECIMAL


def _apart_by_start(rows: list[_Row], seconds: dict[int, float], counter: int) -> list[list[_Row]]:
    """Recordings whose names begin with when they began, and then count; else all together."""
    groups = _grouped(rows, lambda row: (seconds[row.index],))
    starts = sorted({seconds[row.index] for row in rows})
    is_recording = all(later - earlier > _NEXT_SECOND_S for earlier, later in pairwise(starts))
    for group in groups:
        numbers = sorted(row.number(counter) for row in group)
        counts = numbers == list(range(numbers[0], numbers[0] + len(numbers)))
        is_recording = is_recording and counts and numbers[0] <= 1
    return groups if is_recording and len(rows) > len(groups) else [rows]
