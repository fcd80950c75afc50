"""The sets of real sonars: frames of scenes that stand still, against the mean of the others."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from ...factory.errors import FactoryError
from ...factory.sonar.geometry import FanGeometry
from ...models.recordings.fan.pings import close_last
from ..real.groups import LEAST, Group, judged, search
from ..real.shots import open_input
from . import pictures
from .folder import (
    CLEAN,
    GEOMETRY,
    MASKS,
    NOISY,
    PRACTICE,
    REFERENCES,
    Entry,
    SetEntry,
)
from .sets import write_fans

_SEARCHED = 600  # frames of a folder or recording
_FRAMES = 8  # of a group, evenly spread
_EVERY = 4  # one group of so many is for practice

Chosen = list[tuple[int, Group, tuple[int, ...]]]


def name_of(given: str) -> str:
    """The name of the set of a recording or folder."""
    stem = Path(given).expanduser().resolve().stem
    return "real-" + (re.sub(r"[^a-z0-9]+", "-", stem.lower()).strip("-")[:40] or "recording")


def make(given: str, root: Path) -> tuple[SetEntry, SetEntry]:
    """Write the pictures of a recording or folder: the set, and its practice pairs.

    Raises FactoryError when it cannot be read, or holds no scene that stands still.
    """
    name = name_of(given)
    stretches, _ = open_input(given, _SEARCHED)
    groups = [group for stretch in stretches for group in search((0, stretch, None)).groups]
    if not groups:
        raise FactoryError(
            f"--real {given}: no scene stands still for {LEAST} frames, so there is nothing to "
            "compare with; leave it out"
        )
    tested, practised = _parts(groups)
    about = f"{Path(given).name}: {len(tested)} scenes of a real sonar that stand still"
    test = _write(tested, root / NOISY / name, root / REFERENCES / name)
    practice = _write(practised, root / PRACTICE / name / NOISY, root / PRACTICE / name)
    close_last()
    return (
        SetEntry("real", about, name, test),
        SetEntry("real", f"practice: {Path(given).name}", "", practice),
    )


def _parts(groups: Sequence[Group]) -> tuple[Chosen, Chosen]:
    """What is tested and what is practised on: other scenes, or of a single one the halves."""
    if len(groups) == 1:
        count = len(groups[0].shots)
        half = range(count // 2, count), range(count // 2)
        tested, practised = ([(0, groups[0], _spread(part))] for part in half)
        return tested, practised
    chosen = [
        (number, group, _spread(range(len(group.shots)))) for number, group in enumerate(groups)
    ]
    return [one for one in chosen if one[0] % _EVERY], [
        one for one in chosen if not one[0] % _EVERY
    ]


def _spread(places: Sequence[int]) -> tuple[int, ...]:
    count = min(_FRAMES, len(places))
    return tuple(places[number * len(places) // count] for number in range(count))


def _write(chosen: Chosen, noisy: Path, references: Path) -> tuple[Entry, ...]:
    fans: dict[str, FanGeometry] = {}
    found = tuple(_pictures(chosen, noisy, references, fans))
    write_fans(noisy / GEOMETRY, fans)
    return found


def _pictures(
    chosen: Chosen, noisy: Path, references: Path, fans: dict[str, FanGeometry]
) -> Iterator[Entry]:
    for number, group, places in chosen:
        for place, one in zip(places, judged(number, group, places, 0), strict=True):
            assert one.reference is not None
            name = f"{number:03d}-{place:03d}"
            if one.geometry is not None:
                fans[f"{name}.png"] = one.geometry
            # The mean of 24 frames is finer than 8 bits.
            mean = np.rint(np.clip(one.reference, 0, 1) * 65535).astype(np.uint16)
            grey = pictures.in_8_bits(one.noisy, one.shot.name)
            yield Entry(
                name=name,
                group=f"{number:03d}",
                noisy=pictures.write(noisy / f"{name}.png", grey),
                clean=pictures.write(references / CLEAN / f"{name}.png", mean),
                mask=pictures.write(references / MASKS["real"] / f"{name}.png", one.where),
            )
