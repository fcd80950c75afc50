"""`dataset.on_existing=extend`: more samples for an existing dataset, whose shards stay untouched.

Existing shards keep their bytes and the configuration that they state.  The samples that are
lacking go into shards after them, which state the new configuration.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from ..dataset.format.manifest import Manifest, damage, load_manifest, save_manifest
from ..dataset.format.schema import SPLITS, Provenance, plain_values
from ..dataset.write.folder import (
    CHOOSING,
    differences,
    forget_slices,
    list_differences,
    with_slices,
)
from ..errors import FactoryError
from ..frame import FrameRef
from .earlier import Earlier, parts, read_earlier, save_earlier
from .plan import FrameVariants, ShardTask, refuse_doubles

Plan = Callable[[Sequence[Earlier]], tuple[ShardTask, ...]]


def begin_extension(directory: Path, provenance: Provenance, plan: Plan) -> tuple[str, ...]:
    """Make the dataset in `directory` one of `provenance` that extends what is there.

    plan: earlier shards -> all shards; called before anything is written, because it raises
        unless samples are only added.
    Returns a line about each shard that was damaged: its samples go into new shards.
    Nothing is done to a folder without a dataset, or whose dataset is of `provenance` already.

    Raises FactoryError when a key differs that the existing samples depend on.
    """
    there = load_manifest(directory)
    if there is None or there.config_hash == provenance.config_hash:
        return ()
    there = with_slices(directory, there)
    refuse_other_settings(directory, there, provenance)
    notes, earlier, infos = [], [], {}
    for path, info in sorted(there.shards.items()):
        if problem := damage(directory, info):
            notes.append(f"{directory / path}: {problem}; its samples are made again")
            continue
        shard = read_earlier(directory, info, info.config_hash or there.config_hash)
        earlier.append(shard)
        # Frames that failed are its own no longer: they are tried again with what is added.
        infos[path] = replace(
            info, plan=shard.task.digest, failed=(), config_hash=shard.config_hash
        )
    plan(earlier)
    # The manifest last: as long as it is the old one, nothing has changed.
    save_earlier(directory, earlier, provenance.config_hash)
    there = replace(there, shards=infos)
    config = plain_values(provenance.config)
    extended = replace(
        there,
        config_hash=provenance.config_hash,
        config={**config, "extends": parts(there, config)},
    )
    save_manifest(directory, extended)
    forget_slices(directory)
    return tuple(notes)


def refuse_other_settings(directory: Path, there: Manifest, provenance: Provenance) -> None:
    """Raise FactoryError when `provenance` differs from `there` in more than which frames."""
    if "merged" in there.config:
        raise FactoryError(
            f"dataset.dir: {directory} was merged of several datasets; extend those and merge again"
        )
    if there.generator != provenance.generator:
        raise FactoryError(
            f"dataset.dir: {directory} was made by {there.generator}, this is "
            f"{provenance.generator}; give another folder with dataset.dir="
        )
    changes = differences(there.config, provenance.config)
    other = {key: values for key, values in changes.items() if not CHOOSING.fullmatch(key)}
    if other:
        raise FactoryError(
            f"dataset.on_existing=extend: {directory} was made with other settings "
            f"({list_differences(other)}); only which frames and how many variants may change, "
            "so give another folder with dataset.dir="
        )


def plan_extension(
    refs_by_split: Mapping[str, Sequence[FrameRef]],
    variants: int,
    shard_size: int,
    limits: Mapping[str, int | None],
    earlier: Sequence[Earlier],
) -> tuple[ShardTask, ...]:
    """The earlier shards, and after them new ones with the samples that they lack.

    Arguments are those of `plan_shards`.  Where a limit bites, what is there counts, and the rest
    is taken evenly from the frames that lack samples.

    Raises FactoryError when a sample that is there would not be made, or in the other split.
    """
    refuse_doubles(refs_by_split)
    place = {ref.name: (split, ref) for split in SPLITS for ref in refs_by_split.get(split, ())}
    have: dict[str, set[int]] = {}
    tasks: list[ShardTask] = []
    for shard in earlier:
        task = shard.task
        items = []
        for ref, numbers in shard.items:
            _refuse_other(ref, numbers, task.split, place, variants)
            have.setdefault(ref.name, set()).update(numbers)
            items.append((place[ref.name][1], numbers))
        tasks.append(replace(task, items=tuple(items)))
    for split in SPLITS:
        refs = refs_by_split.get(split, ())
        there = sum(task.samples for task in tasks if task.split == split)
        limit = limits.get(split)
        if limit is not None and limit < there:
            raise FactoryError(
                f"dataset.max_{split}={limit}: there are {there} {split} samples already and an "
                "extension only adds; give a higher limit"
            )
        lacking = []
        for ref in refs:
            there_of_it = have.get(ref.name, ())
            if missing := tuple(v for v in range(variants) if v not in there_of_it):
                lacking.append((ref, missing))
        first = 1 + max((t.index for t in tasks if t.split == split), default=-1)
        wanted = lacking if limit is None else _spread(lacking, limit - there)
        tasks += [
            ShardTask(split, first + number, items)
            for number, items in enumerate(_packed(wanted, shard_size))
        ]
    return tuple(tasks)


def _refuse_other(
    ref: FrameRef,
    numbers: tuple[int, ...],
    split: str,
    place: Mapping[str, tuple[str, FrameRef]],
    variants: int,
) -> None:
    """Raise FactoryError unless these samples are among those that the configuration means."""
    if ref.name not in place:
        raise FactoryError(
            f"{ref.name}: is in the dataset, but this configuration would not make it; an "
            "extension only adds (frames.*, scenes.*, dataset.max_*)"
        )
    if place[ref.name][0] != split:
        raise FactoryError(
            f"{ref.location}/{ref.scene}: is in {split} of the dataset and would now be in "
            f"{place[ref.name][0]}; name the scenes that test with split.test=, so that more "
            "scenes move none"
        )
    if max(numbers) >= variants:
        raise FactoryError(
            f"frames.variants={variants}: there is variant {max(numbers)} of {ref.name} already "
            "and an extension only adds; give a higher number"
        )


def _spread(items: Sequence[FrameVariants], room: int) -> list[FrameVariants]:
    """As many samples as there is room for, of frames from all over the list, in its order."""
    # Numbers with their bits reversed: every part of that order is spread evenly.
    width = max(1, (len(items) - 1).bit_length())
    chosen: dict[int, FrameVariants] = {}
    for reversed_ in range(1 << width):
        index = int(f"{reversed_:0{width}b}"[::-1], 2)
        if room <= 0:
            break
        if index < len(items):
            ref, numbers = items[index]
            chosen[index] = (ref, numbers[:room])
            room -= len(numbers)
    return [chosen[index] for index in sorted(chosen)]


def _packed(items: Sequence[FrameVariants], shard_size: int) -> Iterator[tuple[FrameVariants, ...]]:
    """Items in shards of at most `shard_size` samples; a frame is parted only when it must be."""
    shard: list[FrameVariants] = []
    filled = 0
    for ref, numbers in items:
        if filled + len(numbers) > shard_size and shard:
            yield tuple(shard)
            shard, filled = [], 0
        for start in range(0, len(numbers), shard_size):
            piece = numbers[start : start + shard_size]
            if filled + len(piece) > shard_size:
                yield tuple(shard)
                shard, filled = [], 0
            shard.append((ref, piece))
            filled += len(piece)
    if shard:
        yield tuple(shard)
