"""Training data: its contract, the factory's shards, and what is held out."""

from __future__ import annotations

import math
from collections.abc import Sequence, Sized
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import torch

from ...factory.common.array_types import Float32s
from ...factory.common.errors import FactoryError
from ...factory.common.seeds import stream
from ...factory.dataset import PairDataset
from ...factory.dataset.fan_geometry import FanGeometry, SonarDevice, recorded_sonar
from ...factory.dataset.pair_dataset import in_unit_range
from ...factory.dataset.reader import OpenShards, Split
from ...factory.dataset.storage import url_of

Anything = TypeVar("Anything")

Batch = dict[str, torch.Tensor]
"""`noisy`, `clean` and `shadow`, (N, 1, H, W) float32 in 0..1, NaN where these are unknown; the
extras that `models.networks` describes."""


@dataclass(frozen=True, eq=False)
class TrainingImage:
    """One training image.

    noisy, clean: (H, W) float32 in 0..1; clean is NaN where it is unknown.
    shadow: (H, W) float32, 1 in shadow, or None where it is unknown.
    geometry: where range and bearing are, or None.
    frames: (H, W) float32, how many frames were averaged in `noisy` (`networks.averaged`), or None
        for one.
    undisturbed: (H, W) float32, the noisy image without interference along bearings; None: there
        is none.
    """

    noisy: Float32s
    clean: Float32s
    shadow: Float32s | None = None
    geometry: FanGeometry | None = None
    frames: Float32s | None = None
    undisturbed: Float32s | None = None


class ImageSource:
    """Training images by their index, in any process.

    images: what each is made of.  places: the shard of each, where these are fetched from a URL;
    from a disk any image can be read at any time, so that all of them are mixed.
    """

    images: Sized
    places: Sequence[Path] | None = None

    def __len__(self) -> int:
        return len(self.images)

    def sample(self, index: int, visit: int | None) -> TrainingImage:
        """Image `index` as it is at its visit number `visit`; None: for validation.

        Its noise may differ from visit to visit, and depends on nothing else.
        Raises FactoryError when it cannot be read.
        """
        raise NotImplementedError


@dataclass(frozen=True)
class Data:
    """What a training learns from.

    learning, validation: images.  facts: what decides the weights beside the settings.

    recordings: files of real sonars that are learned from.
    """

    learning: ImageSource
    validation: ImageSource
    facts: dict[str, Any]
    recordings: tuple[Path, ...] = ()


@dataclass(frozen=True)
class SampleRef:
    """One pair of a dataset: where it is and which scene and frame it shows.

    window: (range_min_m, range_max_m, azimuth_min_rad, azimuth_max_rad), where it is known.
    """

    path: Path
    row: int
    scene: str
    frame: str
    window: tuple[float, float, float, float] | None = None


@dataclass(frozen=True)
class PairTable:
    """All pairs of a split, the size of their images, and the dataset's configuration by its hash.

    sonar: the device of the images; None for a dataset of another program.
    """

    samples: tuple[SampleRef, ...]
    height: int
    width: int
    config_hash: str
    sonar: SonarDevice | None


def read_table(dataset: str | Path, split: Split) -> PairTable:
    """List the pairs of a split.  FactoryError: no dataset, another schema, mixed image sizes."""
    with PairDataset(dataset, split) as pairs:
        # The first shard is open for these, and need not be fetched again for its table.
        shape = pairs.shape
        sonar = recorded_sonar(pairs.form.config)
        samples = tuple(
            SampleRef(
                *pairs.place(index),
                f"{meta['location'].decode()}/{meta['scene'].decode()}",
                meta["frame"].decode(),
                _window(meta),
            )
            for index, meta in enumerate(pairs.meta())
        )
        return PairTable(samples, *shape, pairs.config_hash, sonar)


def _window(meta: np.void) -> tuple[float, float, float, float] | None:
    if "range_min_m" not in (meta.dtype.names or ()):
        return None
    low, high = (math.radians(float(meta[f"azimuth_{end}_deg"])) for end in ("min", "max"))
    return float(meta["range_min_m"]), float(meta["range_max_m"]), low, high


def hold_out(
    samples: tuple[SampleRef, ...], fraction: float, seed: int
) -> tuple[tuple[SampleRef, ...], tuple[SampleRef, ...]]:
    """Split into (training, validation) by scene, or by frame when there is one scene only.

    At least one scene or frame goes to each side; all variants of a frame stay together.
    """
    name_of = attrgetter("scene")
    if len({sample.scene for sample in samples}) == 1:
        name_of = attrgetter("frame")
    names = sorted({name_of(sample) for sample in samples})
    if len(names) < 2:
        raise FactoryError("dataset: its train split has one frame; validation needs another one")
    count = min(max(1, round(fraction * len(names))), len(names) - 1)
    order = stream(seed, "validation").permutation(len(names))
    held = {names[index] for index in order[:count]}
    learning = tuple(sample for sample in samples if name_of(sample) not in held)
    return learning, tuple(sample for sample in samples if name_of(sample) in held)


def spread(samples: tuple[Anything, ...], limit: int | None) -> tuple[Anything, ...]:
    """Choose at most `limit` samples, evenly spaced."""
    if limit is None or len(samples) <= limit:
        return samples
    return tuple(samples[index * len(samples) // limit] for index in range(limit))


class TrainingPairs(ImageSource):
    """`data=pairs`: the pairs of a dataset.

    weaker: part of the visits in which the noise is blended towards the clean image, by a factor
    that is even in 0..1 and 0 in one case of eight.
    """

    images: tuple[SampleRef, ...]

    def __init__(
        self,
        samples: Sequence[SampleRef],
        sonar: SonarDevice | None,
        *,
        weaker: float = 0.0,
        seed: int = 0,
    ) -> None:
        self.images = tuple(samples)
        self.sonar = sonar
        self.weaker = weaker
        self.seed = seed
        if url_of(samples[0].path.parent.parent) is not None:
            self.places = [sample.path for sample in samples]
        self._open = OpenShards()

    def sample(self, index: int, visit: int | None) -> TrainingImage:
        """See `ImageSource`."""
        ref = self.images[index]
        stored = self._open.read(ref.path, ("noisy", "clean", "shadow"), ref.row)
        noisy = in_unit_range(stored[0])
        clean = in_unit_range(stored[1])
        if visit is not None:
            strength = weakened(self.weaker, self.seed, index, visit)
            if strength < 1:
                noisy = clean + np.float32(strength) * (noisy - clean)
        geometry = None
        if self.sonar is not None and ref.window is not None:
            geometry = FanGeometry.from_sonar(self.sonar, *ref.window)
        return TrainingImage(noisy, clean, stored[2].astype(np.float32), geometry)


def weakened(share: float, seed: int, *names: int | str) -> float:
    """The factor on the noise at a visit: 1, or in `share` of the visits less, down to 0 itself."""
    rng = stream(seed, "weaker", *names)
    if rng.random() >= share:
        return 1.0
    return 0.0 if rng.random() < 1 / 8 else float(rng.random())
