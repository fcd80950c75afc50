"""Shards changed on purpose and sealed again, through everything that opens one."""

from __future__ import annotations

import os
import shutil
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any
from unittest import mock

import h5py

from benchmarks.report import Cell
from benchmarks.trust.guarded import answers
from simnfnd.factory.dataset.read import reader
from simnfnd.factory.errors import FactoryError
from tests.factory.dataset.hostile import (
    OBJECTS,
    LastingProcess,
    admit,
    read_everything,
    reseal,
    whole,
)
from tests.factory.dataset.test_untrusted import ATTRIBUTES, READERS, SHARD

# Pictures and the table; what may be done to one may be done to any.
_OBJECTS_OF = ("noisy", "meta")
# Where a forged stack has more pictures, its checksums cannot be computed in a lifetime.
_MOST_PICTURES = 1000
# One verb may take this long; all of one file are asked in one process.
_MOST_S, _MOST_MB = 30.0, 1000.0


def kinds() -> dict[str, Callable[[h5py.File, Path], Any]]:
    """Every way to forge a shard, by its name."""
    found: dict[str, Callable[[h5py.File, Path], Any]] = {
        name: partial(_by_attribute, action) for name, (action, _) in ATTRIBUTES.items()
    }
    for name, action in OBJECTS.items():
        # Names exchanged make another sound shard.
        stacks = () if name == "swapped names" else _OBJECTS_OF
        for stack in stacks:
            found[f"/{stack}: {name}"] = partial(_by_object, action, stack)
    return found


def forged(most: int) -> tuple[tuple[Cell, ...], list[str]]:
    """A row (files, refused, read, worst seconds and megabytes), and what survived."""
    names = list(kinds())[:most]
    counts: Counter[str] = Counter()
    harm: list[str] = []
    slowest, largest = (0.0, ""), (0.0, "")
    with tempfile.TemporaryDirectory() as folder:
        base = Path(folder).resolve()
        sound = whole(base / "sound")
        places = {name: base / f"{number}" for number, name in enumerate(names)}
        made = {name: (name, sound, place) for name, place in places.items()}
        at_once = 2 * (os.cpu_count() or 1)
        for name, answer in answers(forge, made, 4 * _MOST_S, at_once):
            if answer.said != "done":
                harm.append(f"{name}: cannot be made, {answer.said[:90]}")
        asked = {name: (place,) for name, place in places.items()}
        for name, answer in answers(ask, asked, 4 * _MOST_S, at_once):
            said: dict[str, tuple[str, float]] = answer.result or {"any": (answer.said, 0.0)}
            for verb, (word, seconds) in said.items():
                counts[word] += 1
                slowest = max(slowest, (seconds, f"{name}, {verb}"))
                if word not in ("refused", "read") or seconds > _MOST_S:
                    harm.append(f"{name}, {verb}: {word}, {seconds:.1f} s")
            largest = max(largest, (answer.peak_mb, name))
            if answer.peak_mb > _MOST_MB:
                harm.append(f"{name}: {answer.peak_mb:.0f} MB")
            print(
                f"{name}: {sum(seconds for _, seconds in said.values()):.1f} s in all, "
                f"{answer.peak_mb:.0f} MB, "
                + ", ".join(f"{verb} {word}" for verb, (word, _) in said.items()),
                flush=True,
            )
    print(f"slowest: {slowest[0]:.1f} s, {slowest[1]}")
    print(f"largest: {largest[0]:.0f} MB, {largest[1]}", flush=True)
    return (
        len(names),
        counts["refused"],
        counts["read"],
        sum(counts.values()) - counts["refused"] - counts["read"],
        slowest[0],
        largest[0],
    ), harm


def forge(name: str, sound: Path, place: Path) -> None:
    """A copy of a sound dataset, of whose shards one is forged, in a folder of its own."""
    place.mkdir()
    root = Path(shutil.copytree(sound, place / "forged"))
    shutil.copy(sound.parent / "secret.h5", place / "secret.h5")
    with h5py.File(root / SHARD, "r+") as file:
        kinds()[name](file, place / "secret.h5")
    with h5py.File(root / SHARD, "r+") as file:
        _try_to_seal(file)
    admit(root)


def ask(place: Path) -> dict[str, tuple[str, float]]:
    """Verb -> (`refused`, `read`, or what went wrong; seconds)."""
    found = {}
    before = set(place.rglob("*"))
    verbs: dict[str, Callable[[Path], Any]] = {**READERS, "every layer": _every_layer}
    with mock.patch.multiple(reader, IsolatedProcess=LastingProcess):
        for verb, open_it in verbs.items():
            begun, said = time.perf_counter(), "read"
            try:
                open_it(place / "forged")
            except FactoryError as error:
                said = "more than a line" if "\n" in str(error) else "refused"
            except Exception as error:
                said = f"{type(error).__name__}: {str(error)[:80]}"
            found[verb] = said, time.perf_counter() - begun
    if process := LastingProcess._one:
        process.__exit__()  # its memory counts once it has ended
    shutil.rmtree(place / "out", ignore_errors=True)
    if new := set(place.rglob("*")) - before - {place / "sheet.png"}:
        found["files"] = f"wrote {sorted(new)[0].name}", 0.0
    return found


def _every_layer(root: Path) -> None:
    if (said := read_everything(root)) != "read":
        raise FactoryError(said)


def _by_attribute(action: Callable[[h5py.File], Any], file: h5py.File, _: Path) -> None:
    action(file)


def _by_object(
    action: Callable[[h5py.File, str, Path], Any], name: str, file: h5py.File, secret: Path
) -> None:
    action(file, name, secret)


def _try_to_seal(file: h5py.File) -> None:
    """As who knows the checksums would, where what is left of the file allows it."""
    try:
        stacks = [file[name] for name in file["checksums"].dtype.names]
        if max(len(stack) for stack in stacks) > _MOST_PICTURES:
            raise FactoryError("more pictures than can be read")
        reseal(file)
    except Exception:
        for name in ("checksum", "text_checksum"):
            file.attrs.pop(name, None)
        if "checksums" in file:
            del file["checksums"]
