"""Names of frames in one form: months, clocks and counters in digits of fixed places.

People, screenshots and cameras write `9.05.58 PM`, `24Sep2025`, `2025-9-4`, `00ff` or `t1` beside
`t0.5`.  What is returned here serves to order names alone.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Sequence
from pathlib import PurePath

_MONTHS = (
    "jan(?:uary)?", "feb(?:ruary)?", "mar(?:ch)?", "apr(?:il)?", "may", "june?", "july?",
    "aug(?:ust)?", "sept?(?:ember)?", "oct(?:ober)?", "nov(?:ember)?", "dec(?:ember)?",
)  # fmt: skip
_ANY_MONTH = "|".join(_MONTHS)
_DAY_FIRST = re.compile(
    rf"(?<!\d)(?P<day>\d{{1,2}})[ _.-]?(?P<month>{_ANY_MONTH})[ _.-]?(?P<year>\d{{4}})(?!\d)",
    re.IGNORECASE,
)
_YEAR_FIRST = re.compile(
    rf"(?<!\d)(?P<year>\d{{4}})[ _.-]?(?P<month>{_ANY_MONTH})[ _.-]?(?P<day>\d{{1,2}})(?!\d)",
    re.IGNORECASE,
)
_DATE = re.compile(r"(?<!\d)((?:19|20)\d\d)([-_.])(\d{1,2})\2(\d{1,2})(?!\d)")
_CLOCK = re.compile(r"(?<![\d.])(\d{1,2})([.:])(\d{1,2})\2(\d{1,2})(?!\d)")
_TWELVE_HOURS = re.compile(
    r"(?<!\d)(\d{1,2})([.:_-])(\d{2})(?:\2(\d{2}))?\s?([ap])\.?m\b\.?", re.IGNORECASE
)
_HEXADECIMAL = re.compile(r"(?<![0-9a-z])(?:0x)?([0-9a-f]{2,15})(?![0-9a-z])", re.IGNORECASE)
_LEAST_COUNTED = 3
_MOST_MISSING = 4
"""Numbers that a counter spans for each name that is there: names of chance span more."""
_DECIMAL = re.compile(r"(.*?)\d+\.\d+")
_WHOLE = re.compile(r"(.*?)\d+")


def uniform_names(names: Sequence[str]) -> list[str]:
    """Each name in the form by which it is ordered, its suffix as it is."""
    stems = [PurePath(name).stem for name in names]
    suffixes = [name.removeprefix(stem) for name, stem in zip(names, stems, strict=True)]
    stems = [_in_digits(stem) for stem in stems]
    stems = _with_decimals(_with_counters(stems), suffixes)
    return [stem + suffix for stem, suffix in zip(stems, suffixes, strict=True)]


def _in_digits(stem: str) -> str:
    """Dates and times of day as digits of fixed places, the time of day in 24 hours."""
    stem = _DAY_FIRST.sub(lambda match: f"{_day(match)}-{_month(match)}-{match['year']}", stem)
    stem = _YEAR_FIRST.sub(lambda match: f"{match['year']}-{_month(match)}-{_day(match)}", stem)
    stem = _DATE.sub(_padded_date, stem)
    stem = _TWELVE_HOURS.sub(_in_24_hours, stem)
    return _CLOCK.sub(_padded_clock, stem)


def _day(match: re.Match[str]) -> str:
    return match["day"].zfill(2)


def _month(match: re.Match[str]) -> str:
    text = match["month"].lower()
    number = next(n for n, month in enumerate(_MONTHS, start=1) if re.fullmatch(month, text))
    return f"{number:02d}"


def _padded_date(match: re.Match[str]) -> str:
    year, mark, month, day = match.groups()
    is_date = 1 <= int(month) <= 12 and 1 <= int(day) <= 31
    return f"{year}{mark}{month:0>2}{mark}{day:0>2}" if is_date else match[0]


def _padded_clock(match: re.Match[str]) -> str:
    hours, mark, minutes, seconds = match.groups()
    is_clock = int(hours) <= 23 and int(minutes) <= 59 and int(seconds) <= 59
    return f"{hours:0>2}{mark}{minutes:0>2}{mark}{seconds:0>2}" if is_clock else match[0]


def _in_24_hours(match: re.Match[str]) -> str:
    hours, mark, minutes, seconds, half = match.groups()
    if not 1 <= int(hours) <= 12:
        return match[0]
    hour = int(hours) % 12 + 12 * (half.lower() == "p")
    return f"{hour:02d}{mark}{minutes}{mark}{seconds or '00'}"


def _with_counters(stems: Sequence[str]) -> list[str]:
    """Names with hexadecimal counters in decimals.

    They span few numbers: others are names by chance.
    """
    groups: dict[tuple[str, str, int], list[tuple[int, re.Match[str]]]] = defaultdict(list)
    for index, stem in enumerate(stems):
        for match in _HEXADECIMAL.finditer(stem):
            around = stem[: match.start()], stem[match.end() :]
            groups[(*around, len(match[1]))].append((index, match))
    result = list(stems)
    for (before, behind, width), members in groups.items():
        numbers = [int(match[1], 16) for _, match in members]
        span = max(numbers) - min(numbers)
        is_counted = len(members) >= _LEAST_COUNTED and span <= _MOST_MISSING * len(members)
        if not is_counted or not _has_mixed_place([match[1] for _, match in members]):
            continue
        places = len(str(16**width))
        for (index, _), number in zip(members, numbers, strict=True):
            result[index] = f"{before}{number:0{places}d}{behind}"
    return result


def _has_mixed_place(texts: Sequence[str]) -> bool:
    """Whether texts of one length have letters and digits at one place; `a0` to `a9` do not."""
    columns = ("".join(column) for column in zip(*texts, strict=True))
    return any(not column.isdecimal() and not column.isalpha() for column in columns)


def _with_decimals(stems: Sequence[str], suffixes: Sequence[str]) -> list[str]:
    """`t1` as `t1.0` where there is `t0.5`, too."""
    pairs = list(zip(stems, suffixes, strict=True))
    matches = [(_DECIMAL.fullmatch(stem), suffix) for stem, suffix in pairs]
    heads = {(match[1], suffix) for match, suffix in matches if match is not None}
    result = []
    for stem, suffix in pairs:
        whole = _WHOLE.fullmatch(stem)
        has_decimals = whole is not None and (whole[1], suffix) in heads
        result.append(f"{stem}.0" if has_decimals else stem)
    return result
