"""Names of frames as recorders write them: which follow each other, and in which order."""

from __future__ import annotations

from random import Random

import pytest

from simnfnd.models.recordings.names import natural_key, sequences_of

ONE_SEQUENCE = {
    "leading zeros": [f"{n:04d}.png" for n in range(12)],
    "no leading zeros": [f"frame{n}.png" for n in range(12)],
    "a suffix": [f"frame_{n}_sonar.png" for n in range(8, 20)],
    "a setting behind": [f"img{n:03d}_1200kHz.jpg" for n in range(12)],
    "a setting that changes": [f"img{n:03d}_{1200 if n < 5 else 1800}kHz.jpg" for n in range(12)],
    "a setting before": [f"gain{n % 3}_frame{n}.png" for n in range(12)],
    "seconds and nanoseconds": [
        f"{1_700_000_000 + n // 3}.{n % 3 * 333_000_000 + 1234:09d}.png" for n in range(12)
    ],
    "nanoseconds without zeros": [
        f"{1_700_000_000 + n // 4}_{n % 4 * 250_000_000 + 9}.png" for n in range(12)
    ],
    "a float of Python": [f"{1_700_000_000 + n / 4}.png" for n in range(12)],
    "milliseconds": [f"{1_700_000_000_000 + 125 * n}.png" for n in range(12)],
    "a date": [f"2024-02-0{1 + n // 6} 23-59-{n % 6 * 9:02d}.png" for n in range(12)],
    "a date and milliseconds": [
        f"20240201T1200{n // 4:02d}_{n % 4 * 250:03d}.png" for n in range(12)
    ],
    "a clock and tenths": [f"dive 10h07m{n // 2:02d}.{n % 2 * 5}.bmp" for n in range(12)],
    "frames within a second": [f"20240201_1200{n // 4:02d}_{n % 4}.png" for n in range(12)],
    "a counter and a stamp": [
        f"{n:04d}-{1_700_000_000 + n // 2}.{n % 2 * 5}.png" for n in range(12)
    ],
    "seconds since the start": [f"t{n // 4}.{n % 4 * 25:02d}s.png" for n in range(12)],
    "two dives of two days": [
        f"2509{day}_1015{2 * n + day % 2:02d}.png" for day in (24, 25) for n in range(6)
    ],
    "a year of two digits": [f"25-09-{24 + n // 6}_10-15-{n % 6 * 9:02d}.png" for n in range(12)],
    "a day of the year": [f"2025_{364 + n // 6}_2359{n % 6 * 9:02d}.png" for n in range(7)],
    "a new year": ["251231_235950.png", "251231_235955.png", "260101_000000.png"],
    "a clock with tenths over midnight": ["23-59-59.0.png", "23-59-59.5.png", "00-00-00.0.png"],
    "a counter behind a second": [
        f"20231115_1704{30 + n // 3}{('', '_1', '_2')[n % 3]}.png" for n in range(12)
    ],
    "ten frames a second": [f"20231115_170431{'_' * (n > 0)}{n or ''}.png" for n in range(12)],
    "copies in brackets": ["s170430.png", "s170431.png", "s170431 (1).png", "s170431 (2).png"],
    "decimals without zeros": [f"t{value}.png" for value in ("0.125", "0.25", "0.5", "1.0")],
    "halves between whole numbers": [f"t{value}.png" for value in ("0", "0.125", "0.5", "1")],
    "counted behind a point": [f"rec1.{n}.png" for n in (1, 2, 9, 10, 11)],
    "two spellings of a suffix": ["1.jpg", "2.jpeg", "3.JPG", "10.jpeg"],
    "a day first": [
        *(f"30092025_2359{n:02d}.png" for n in (58, 59)),
        *(f"01102025_0000{n:02d}.png" for n in (0, 1)),
    ],
    "a day first, in one number": ["30092025235959.png", "01102025000000.png"],
    "a day first in a year of two digits": ["30.09.25_235959.png", "01.10.25_000000.png"],
    "milliseconds without a mark": [
        *(f"20250924_235959{n:03d}.png" for n in (5, 900)),
        *(f"20250925_000000{n:03d}.png" for n in (100, 600)),
    ],
    "hours and minutes": [
        f"{name}.png" for name in ("20250924_2358", "20250924_2359", "20250925_0001")
    ],
    "a clock of twelve hours": [
        f"Shot 2025-9-24 at {clock}.png"
        for clock in ("9.59.58 AM", "10.00.01 AM", "12.30.00 PM", "1.05.00 PM")
    ],
    "a clock without zeros": [f"a {c}.png" for c in ("9.5.58", "9.5.59", "9.6.1", "10.6.0")],
    "a half before the first second": [f"t{value}.png" for value in ("0.5", "1", "1.5", "2")],
    "copies of a word": ["img.png", "img (1).png", "img (2).png", "img (10).png"],
    "capitals": [f"A{n}.{'PNG' if n % 2 else 'png'}" for n in range(12)],
}


@pytest.mark.parametrize("kind", ONE_SEQUENCE)
def test_names_of_one_recording(kind: str) -> None:
    names = ONE_SEQUENCE[kind]
    shuffled = Random(0).sample(names, len(names))
    assert [[shuffled[index] for index in actual] for actual in sequences_of(shuffled)] == [names]


SEVERAL = {
    "dives": [[f"dive{dive}_{n:03d}.png" for n in range(9, 12)] for dive in (1, 2, 10)],
    "words": [[f"{word}{n}.png" for n in range(4)] for word in ("left", "right")],
    "dives and a setting": [
        [f"dive{dive}_{n}_{700 + 500 * (n % 2)}kHz.png" for n in range(5)] for dive in (1, 2)
    ],
    "sonars and stamps": [
        [f"sonar{sonar}_20240201_1200{n:02d}.png" for n in range(5)] for sonar in (1, 2)
    ],
    "recordings by their start": [
        [f"20240201_{start}_{n:04d}.png" for n in range(5)] for start in (120000, 130000)
    ],
    "a photo of each dive": [
        ["dive1.png", "dive2.png"],
        *[[f"dive{dive}_{n:03d}.png" for n in range(1, 4)] for dive in (1, 2)],
    ],
    "dives of two days": [
        [f"{day}_dive{dive}_{n:02d}.png" for n in range(3)]
        for day in (20250924, 20250925)
        for dive in (1, 2)
    ],
    "names by chance": [["0b77e2.png"], ["1c01d3.png"], ["9af31c.png"]],
    "no numbers": [["a.png"], ["b.png"]],
}


@pytest.mark.parametrize("kind", SEVERAL)
def test_names_of_several_recordings(kind: str) -> None:
    names = [name for sequence in SEVERAL[kind] for name in sequence]
    shuffled = Random(0).sample(names, len(names))
    actual = [[shuffled[index] for index in sequence] for sequence in sequences_of(shuffled)]
    assert actual == SEVERAL[kind]


def test_natural_order() -> None:
    names = ["a1b.png", "a2.png", "a10.png", "b.png"]
    assert sorted(reversed(names), key=natural_key) == names
