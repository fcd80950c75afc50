"""`PairStream`: an endless stream of fresh pairs for a training loop of the user's own."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import IterableDataset

from ...factory.common.array_types import Array, Int64s
from ...factory.common.errors import FactoryError, FrameError
from ...factory.common.extras import require
from ...factory.common.seeds import stream
from ...factory.dataset.frame_ref import FrameRef
from ...factory.dataset.pair_dataset import in_unit_range, is_grey, loader_share
from ...factory.dataset.schema import CORE, EFFECT_FOLDER, Pair
from ...factory.dataset.schema import layers as known_layers
from ...factory.simulation.config.compose import compose_config
from ...factory.simulation.config.needs import needs_of
from ...factory.simulation.config.root import FactoryConfig
from ...factory.simulation.config.selection import choose_frames, split_frames
from ...factory.simulation.config.stored import stored_config
from ...factory.simulation.pairs.pair_maker import PairMaker, frames_worth_keeping, pair_maker
from ...factory.simulation.pairs.views import open_views
from ...factory.simulation.scenes import open_reader

# Variants of datasets count from 0: the noise of a stream is none of theirs.
_FIRST_VARIANT = 1_000_000
_ROUNDS_IN_MEMORY = 4
_BROUGHT_BY = {"instance": "segmentation"}


class PairStream(IterableDataset[dict[str, Tensor]]):
    """An endless stream of batches of pairs: rendered frames under noise that is new at each visit.

        stream = PairStream(dataset="outputs/demo", batch_size=16)
        for batch in DataLoader(stream, batch_size=None, num_workers=2):
            loss = criterion(network(batch["noisy"][:, None]), batch["clean"][:, None])

    A batch has the layers of `PairDataset(..., scaled=True)` in the same shapes and types: noisy
    and clean, (N, H, W) float32 in 0..1; shadow, (N, H, W) bool; segmentation, instance, range and
    all others as `docs/dataset.md` describes them.  A network that wants channels takes
    `batch["noisy"][:, None]`.  All frames come once, in random order, before any comes again.

    Batch number k is a pure function of words and seed: `stream.batch(k)`.  Workers of a DataLoader
    and ranks share the numbers without a duplicate, and a loader gives the same batches in the same
    order for any number of workers.  `start=k` resumes after the first k batches (of a rank).

    words: of `simnfnd make`, which choose renders, device and noise.  The renders must be at hand:
        in the cache, where `simnfnd make` with the same words leaves them, or in a pack
        ("scenes=pack", "scenes.root=views.pack").
    dataset: folder whose config.yaml is taken; words may then only set the cache.
    split: of the frames, as the configuration splits them by scene.
    layers: of a batch, as the dataset format names them; None: noisy, clean, shadow, and those of
        `dataset.layers` of words or dataset.
    rank, ranks: of this process among those that train together; None: as torch.distributed or
        torchrun say, else 0 of 1.
    Raises FactoryError for wrong words, and where no render is at hand.
    """

    def __init__(
        self,
        *words: str,
        dataset: str | Path | None = None,
        split: str = "train",
        layers: Sequence[str] | None = None,
        batch_size: int = 16,
        seed: int = 0,
        start: int = 0,
        rank: int | None = None,
        ranks: int | None = None,
    ) -> None:
        if batch_size < 1 or start < 0:
            raise ValueError(f"batch_size={batch_size}, start={start}: expected at least 1 and 0")
        config = compose_config(words)
        if dataset is not None:
            config = stored_config(Path(dataset).expanduser(), config)
        # The noise of a stream is that of its seed.
        requested = config.dataset.layers if layers is None else requested_layers(layers)
        settings = replace(config.dataset, layers=requested)
        self.config = replace(config, seed=seed, dataset=settings)
        self.layers = None if layers is None else tuple(layers)
        require(needs_of(self.config))
        self.frames = rendered_frames(config, split)
        self.batch_size = batch_size
        self.seed = seed
        self.start = start
        self.rank, self.ranks = _place_among_ranks(rank, ranks)
        self._maker: PairMaker | None = None

    def __iter__(self) -> Iterator[dict[str, Tensor]]:
        """The batches of this worker and rank, without an end."""
        share = loader_share()
        for step in count(self.start + share.number, share.processes):
            yield self.batch(step * self.ranks + self.rank)

    def batch(self, number: int) -> dict[str, Tensor]:
        """Batch `number` of all ranks together."""
        first = number * self.batch_size
        samples = [self._sample(position) for position in range(first, first + self.batch_size)]
        names = tuple(samples[0]) if self.layers is None else self.layers
        return {
            name: torch.from_numpy(np.stack([sample[name] for sample in samples])) for name in names
        }

    def _sample(self, position: int) -> dict[str, Array]:
        """The layers of a pair, grey values as float32 in 0..1."""
        pair = self.pair(position)
        images = {"noisy": pair.noisy, "clean": pair.clean, "shadow": pair.shadow, **pair.layers}
        return {
            name: in_unit_range(image) if is_grey(name) else image for name, image in images.items()
        }

    def pair(self, position: int) -> Pair:
        """The pair at a position of the stream, with its record.

        A frame that shows nothing to the sonar gives way to the next one.
        """
        maker = self._pair_maker()
        round_, place = divmod(position, len(self.frames))
        index = int(_order(self.seed, round_, len(self.frames))[place])
        for attempt in range(len(self.frames)):
            frame = self.frames[(index + attempt) % len(self.frames)]
            try:
                (pair,) = maker.pairs(frame, (_FIRST_VARIANT + position,))
            except FrameError as error:
                problem = error
            else:
                return pair
        raise FactoryError(f"no frame of the stream gives a pair: {problem}")

    def _pair_maker(self) -> PairMaker:
        if self._maker is None:
            kept_frames = frames_worth_keeping(len(self.frames))
            self._maker = pair_maker(self.config, kept_frames=kept_frames)
        return self._maker

    def __getstate__(self) -> dict[str, Any]:
        """A worker builds its own maker."""
        return {**self.__dict__, "_maker": None}


def requested_layers(names: Sequence[str]) -> tuple[str, ...]:
    """The entries of `dataset.layers` that bring the layers with these names.

    Raises FactoryError for names that the format does not know.
    """
    known_layers("uint8", names)
    requested = {
        "effects" if name.startswith(EFFECT_FOLDER) else _BROUGHT_BY.get(name, name)
        for name in names
        if name not in CORE
    }
    return tuple(sorted(requested))


def rendered_frames(config: FactoryConfig, split: str) -> tuple[FrameRef, ...]:
    """The frames of a split whose renders are at hand.

    Raises FactoryError where there are none.
    """
    frames = choose_frames(open_reader(config.scenes).discover().frames, config)
    of_split = split_frames(frames, config).get(split, ())
    if not of_split:
        raise FactoryError(f"split={split}: none of the {len(frames)} frames is in it")
    views = open_views(config)
    rendered = tuple(ref for ref in of_split if views.holds(ref))
    if not rendered:
        raise FactoryError(
            f"none of the {len(of_split)} {split} frames is rendered by this version in "
            f"{config.cache.folder}; run `simnfnd make` with the same words and a fresh "
            "dataset.dir first, which leaves its renders there, or take a pack with scenes=pack "
            "scenes.root=FILE"
        )
    return rendered


@lru_cache(maxsize=_ROUNDS_IN_MEMORY)
def _order(seed: int, round_: int, frames: int) -> Int64s:
    return stream(seed, "order", round_).permutation(frames)


def _place_among_ranks(rank: int | None, ranks: int | None) -> tuple[int, int]:
    distributed = torch.distributed
    if rank is None and distributed.is_available() and distributed.is_initialized():
        rank = distributed.get_rank()
        ranks = distributed.get_world_size()
    elif rank is None:
        rank = int(os.environ.get("RANK", "0"))
        ranks = int(os.environ.get("WORLD_SIZE", "1"))
    if ranks is None or not 0 <= rank < ranks:
        raise ValueError(f"rank={rank}, ranks={ranks}: expected a rank below the number of ranks")
    return rank, ranks
