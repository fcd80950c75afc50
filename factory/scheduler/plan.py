"""Which shard holds which frames: decided before the work, by the frames and the settings alone."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from ..dataset.schema import SPLITS
from ..frame import FrameRef

FrameVariants = tuple[FrameRef, tuple[int, ...]]


@dataclass(frozen=True)
class ShardTask:
    """One shard to make; small enough to be sent to any worker.

    items: (frame, variants of it to make), in the order of the samples.
    """

    split: str
    index: int
    items: tuple[FrameVariants, ...]

    @property
    def path(self) -> str:
        """Where the shard goes, below the dataset's folder."""
        return f"{self.split}/shard-{self.index:05d}.h5"

    @cached_property
    def samples(self) -> int:
        """How many samples the shard has when no frame fails."""
        return sum(len(variants) for _, variants in self.items)

    @cached_property
    def digest(self) -> str:
        """Hash of the frames and variants that the shard holds, wherever their files are."""
        content = [(ref.location, ref.scene, ref.frame, variants) for ref, variants in self.items]
        return hashlib.sha256(json.dumps(content).encode()).hexdigest()[:16]


def plan_shards(
    refs_by_split: Mapping[str, Sequence[FrameRef]],
    variants: int,
    shard_size: int,
    limits: Mapping[str, int | None] | None = None,
) -> tuple[ShardTask, ...]:
    """Cut the frames of each split into shards of at most `shard_size` samples.

    refs_by_split: "train" and "test" -> frames, in the order in which they are to lie.
    variants: samples per frame.
    limits: split -> upper limit on samples.  When it bites, frames are taken evenly from the
        whole list, so that no scene is left out; the last one taken may give fewer variants.

    The variants of a frame lie in one shard, unless a frame has more of them than a shard holds:
    then the frame fills shards of its own.
    """
    tasks: list[ShardTask] = []
    for split in SPLITS:
        items = _limited(refs_by_split.get(split, ()), variants, (limits or {}).get(split))
        shards = _cut(items, variants, shard_size)
        tasks += [ShardTask(split, index, tuple(part)) for index, part in enumerate(shards)]
    return tuple(tasks)


def _limited(refs: Sequence[FrameRef], variants: int, limit: int | None) -> list[FrameVariants]:
    everything = tuple(range(variants))
    if limit is None or limit >= len(refs) * variants:
        return [(ref, everything) for ref in refs]
    frames = -(-limit // variants)
    items = [(refs[k * len(refs) // frames], everything) for k in range(frames)]
    if limit % variants:
        items[-1] = (items[-1][0], everything[: limit % variants])
    return items


def _cut(
    items: Sequence[FrameVariants], variants: int, shard_size: int
) -> Iterator[Sequence[FrameVariants]]:
    if variants > shard_size:
        for ref, numbers in items:
            for start in range(0, len(numbers), shard_size):
                yield [(ref, numbers[start : start + shard_size])]
        return
    frames = shard_size // variants
    for start in range(0, len(items), frames):
        yield items[start : start + frames]
