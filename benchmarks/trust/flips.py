"""Single bits flipped in a shard, one at a time, and what its readers give out then."""

from __future__ import annotations

import os
import shutil
import tempfile
from bisect import bisect_right
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import h5py
import numpy as np

from benchmarks.report import Cell, Table
from simnfnd.factory.dataset.read.isolated import IsolatedProcess
from simnfnd.factory.errors import FactoryError
from tests.factory.dataset.flips import LAYERS, flip, given_out, outcome
from tests.factory.dataset.hostile import keep_only, whole

SHARD = "train/shard-00000.h5"
COMPRESSIONS = ("gzip", "none")
ALONE = "h5py alone"
OURS = {"checksums": "`PairDataset`", "hash": '`PairDataset`, `verify="hash"`'}
# One that takes longer hangs; a sound file takes a fifth of a second of CPU time.
_LIMIT_S = 120.0


@dataclass(frozen=True)
class Flip:
    """One bit of a shard of one compression.  part: what lies there."""

    compression: str
    place: int
    bit: int
    part: str


@dataclass(frozen=True)
class Sound:
    """A dataset of one shard, and what its readers give."""

    root: Path
    content: bytes
    ours: dict[str, bytes]
    alone: dict[str, bytes]


def flipped(count: int) -> tuple[Table, list[str]]:
    """The table, and what survived: half of the bits in gzip shards, half in plain chunks."""
    counts: dict[str, Counter[str]] = {who: Counter() for who in (ALONE, *OURS.values())}
    parts: Counter[str] = Counter()
    wrong: list[str] = []
    # They wait for processes of their own most of the time.
    threads = min(4 * (os.cpu_count() or 1), count)
    with tempfile.TemporaryDirectory() as name, ThreadPoolExecutor(threads) as pool:
        sound = {kind: _sound(Path(name) / kind, kind) for kind in COMPRESSIONS}
        flips = [
            each
            for seed, (kind, one) in enumerate(sound.items())
            for each in _spread(kind, one, count // 2, np.random.default_rng(seed))
        ]
        stripes = [(Path(name) / f"{k}", sound, flips[k::threads]) for k in range(threads)]
        for found in pool.map(lambda stripe: list(_try(*stripe)), stripes):
            for each, answers in found:
                parts[each.part] += 1
                for who, said in answers.items():
                    kind = said if said in ("same", "refused") else "another"
                    counts[who][kind] += 1
                    if kind == "another" and who != ALONE:
                        wrong.append(
                            f"bit {each.bit} of byte {each.place} of {each.compression}, "
                            f"{who}: {said}"
                        )
    kinds = ("refused", "same", "another")
    rows: tuple[tuple[Cell, ...], ...] = tuple(
        (who, *(found[kind] for kind in kinds)) for who, found in counts.items()
    )
    told = ", ".join(f"{number} in {part}" for part, number in sorted(parts.items()))
    title = f"{sum(parts.values())} single bits flipped, one at a time: {told}"
    note = "Another: a picture, mask, table, axis or text that is not the sound one was given out."
    return Table(("reader", *kinds), rows, title, note), wrong


def _sound(root: Path, compression: str) -> Sound:
    keep_only(whole(root / "dataset", compression=compression), SHARD)
    path = root / "dataset" / SHARD
    return Sound(path.parents[1], path.read_bytes(), given_out(path.parents[1]), by_h5py(path))


def _spread(compression: str, sound: Sound, count: int, rng: np.random.Generator) -> Iterator[Flip]:
    """One bit in each of `count` pieces of the file of the same length."""
    starts, names = _parts(sound.root / SHARD)
    bounds = np.linspace(0, len(sound.content), count + 1)
    for low, high in pairwise(bounds):
        place = int(rng.uniform(low, high))
        yield Flip(compression, place, int(rng.integers(8)), names[bisect_right(starts, place) - 1])


def _parts(path: Path) -> tuple[list[int], list[str]]:
    """Where each part of a shard begins, ascending, and what it holds."""
    rest = "attributes and HDF5's own tables"
    found = {0: rest}
    with h5py.File(path) as file:
        stacks: list[h5py.Dataset] = []

        def keep(_: str, item: object) -> None:
            if isinstance(item, h5py.Dataset):
                stacks.append(item)

        file.visititems(keep)
        for stack in stacks:
            if stack.chunks:
                infos = [stack.id.get_chunk_info(k) for k in range(stack.id.get_num_chunks())]
                pieces = [(info.byte_offset, info.size) for info in infos]
            else:
                pieces = [(stack.id.get_offset(), stack.id.get_storage_size())]
            for begin, size in pieces:
                found[begin] = "pictures and masks" if stack.chunks else "tables and axes"
                found.setdefault(begin + size, rest)
    return sorted(found), [found[begin] for begin in sorted(found)]


def _try(
    folder: Path, sound: dict[str, Sound], flips: Sequence[Flip]
) -> Iterator[tuple[Flip, dict[str, str]]]:
    """What every reader says of every flip: `same`, `refused`, or what is another."""
    with IsolatedProcess() as reader, IsolatedProcess() as alone:
        for each in flips:
            one = sound[each.compression]
            root = folder / each.compression
            if not root.exists():
                shutil.copytree(one.root, root)
            flip(root / SHARD, each.place, each.bit)
            answers = {ALONE: _alone(alone, root / SHARD, one.alone)}
            try:
                answers |= reader.call(_ours, root, one.ours, limit_s=_LIMIT_S)
            except FactoryError as error:  # also a crash or a hang
                answers |= dict.fromkeys(OURS.values(), str(error))
            (root / SHARD).write_bytes(one.content)
            yield each, answers


def _ours(root: Path, right: dict[str, bytes]) -> dict[str, str]:
    return {
        OURS["checksums"]: outcome(root, right),
        OURS["hash"]: outcome(root, right, "hash"),
    }


def _alone(process: IsolatedProcess, path: Path, right: dict[str, bytes]) -> str:
    try:
        return "same" if process.call(by_h5py, path, limit_s=10.0) == right else "another"
    except (FactoryError, RuntimeError):  # also a crash or a hang of the library
        return "refused"


def by_h5py(path: Path) -> dict[str, bytes]:
    """What h5py gives of a shard without any check of ours."""
    with h5py.File(path, "r") as file:
        found = {name: file[name][()].tobytes() for name in (*LAYERS, "meta")}
        found |= {f"axis {name}": file["axes"][name][()].tobytes() for name in file["axes"]}
        for name in ("/", *LAYERS, "meta"):
            told = {k: v for k, v in file[name].attrs.items() if k != "DIMENSION_LIST"}
            found[f"attributes {name}"] = repr(sorted(told.items(), key=lambda x: x[0])).encode()
    return found
