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
