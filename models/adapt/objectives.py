"""What weights are fitted to, and how it is measured whether they have become better by it.

- `StillLesson`: stretches in which the scene stands still: the mean of the other frames.
- `KeptLesson`: simulated pictures, so that nothing is forgotten.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, TypeVar

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from ...factory.seeds import stream
from ..data.crops import concatenate, whole_image_batch
from ..data.pairs import Batch, Image, Sample
from ..networks.network import Network, known_extras
from ..training.samples import denoise_batch
from .crops import crop, crop_size
from .score import psnr_after_levels
from .simulated import Simulated
from .still import Lessons, Still

_MOST_MEASURED = 4

T = TypeVar("T")


class Lesson(Protocol):
    """Something to learn from.

    unit: of its figure.
    """

    unit: str

    def loss(self, network: Network, step: int) -> Tensor:
        """Of the crops of a step, which depend on the seed and the step alone."""

    def figure(self, network: Network) -> float:
        """What the network, in evaluation mode, makes of pictures held out; more is better."""


class StillLesson:
    """Frames of stretches, towards the means of the others; a `Lesson`."""

    unit = "dB"

    def __init__(
        self, found: Lessons, batch: int, seed: int, device: str = "cpu", untold: float = 0.0
    ) -> None:
        """untold: part of the steps in which the network is not told the geometry, 0 to 1."""
        self.batch, self.seed, self.device, self.untold = batch, seed, device, untold
        self.stills = found.learning
        self._odds = _odds(found.learning)
        self._held = _spread(
            [
                (frame, target, still)
                for still in found.held
                for frame, target in zip(still.frames, still.targets, strict=True)
            ]
        )

    def loss(self, network: Network, step: int) -> Tensor:
        """See `Lesson`.  Squares: the mean of many noisy targets is then what is learned."""
        rng = stream(self.seed, "adapt", "still", step)
        still = self.stills[rng.choice(len(self.stills), p=self._odds)]
        size = crop_size(*still.frames[0].shape)
        numbers = rng.integers(len(still.frames), size=self.batch)
        told = still.geometry
        if self.untold and rng.random() < self.untold:
            told = None
        return _squares(
            network,
            [
                crop(still.frames[i], still.targets[i], told, size, network.extras, rng)
                for i in numbers
            ],
            self.device,
        )

    def figure(self, network: Network) -> float:
        """Mean PSNR in dB after levels against the mean of the other frames."""
        found = []
        for frame, target, still in self._held:
            batch = whole_image_batch(Sample(frame, geometry=still.geometry), network.extras)
            found.append(psnr_after_levels(denoise_batch(network, batch), target))
        return float(np.mean(found))

    @property
    def noisy(self) -> float:
        """The figure of the frames as they are."""
        return float(np.mean([psnr_after_levels(frame, target) for frame, target, _ in self._held]))


class KeptLesson:
    """Simulated pictures towards the clean ones, or what the weights made of them; a `Lesson`."""

    unit = "dB"

    def __init__(
        self,
        found: Simulated,
        start: Network,
        batch: int,
        seed: int,
        device: str = "cpu",
    ) -> None:
        """start: the weights that are fitted, in evaluation mode.

        Where it is not known what simulated pictures are in the eyes of the weights, they keep
        what they make of those that they improve; what they are bad at may change.
        """
        self.batch, self.seed, self.device = batch, seed, device
        self._held = found.held
        # Every other one without a word about its geometry, as pictures often come.
        self._samples = [
            Sample(one.noisy, one.clean, None, one.geometry if number % 2 == 0 else None)
            for number, one in enumerate(found.learning)
        ]
        if not found.known:
            self._samples = [
                Sample(one.noisy, made, None, one.geometry)
                for one in self._samples
                if _error(made := _denoised(start, one), one) < _error(one.noisy, one)
            ]

    def __len__(self) -> int:
        return len(self._samples)

    def loss(self, network: Network, step: int) -> Tensor:
        """See `Lesson`."""
        rng = stream(self.seed, "adapt", "kept", step)
        losses = []
        for number in rng.integers(len(self._samples), size=self.batch):
            one = self._samples[number]
            assert one.clean is not None
            size = crop_size(*one.noisy.shape)
            part = crop(one.noisy, one.clean, one.geometry, size, network.extras, rng)
            losses.append(_squares(network, [part], self.device))
        return torch.stack(losses).mean()

    def figure(self, network: Network) -> float:
        """Mean PSNR in dB of the pictures held out, against the clean ones."""
        found = []
        for one in self._held:
            found.append(-10 * np.log10(max(_error(_denoised(network, one), one), 1e-10)))
        return float(np.mean(found))


def _odds(stills: Sequence[Still]) -> npt.NDArray[np.float64]:
    """(stretches,): all recordings alike, however long, and in each all frames alike."""
    frames = np.array([len(still.frames) for still in stills], float)
    recordings = np.array([still.recording for still in stills])
    for number in np.unique(recordings):
        frames[recordings == number] /= frames[recordings == number].sum()
    return np.asarray(frames / frames.sum(), np.float64)


def _squares(network: Network, crops: Sequence[Batch], device: str) -> Tensor:
    """Mean squared difference where the target is known."""
    batch = _on(device, concatenate(crops))
    extras = known_extras(network, batch)
    known = torch.isfinite(batch["clean"])
    difference = network(batch["noisy"], **extras) - torch.nan_to_num(batch["clean"])
    loss: Tensor = (difference.square() * known).sum() / known.sum().clamp_min(1)
    return loss


def _denoised(network: Network, sample: Sample) -> Image:
    return denoise_batch(
        network, whole_image_batch(Sample(sample.noisy, geometry=sample.geometry), network.extras)
    )


def _error(picture: Image, sample: Sample) -> float:
    """Mean squared difference to the clean picture."""
    assert sample.clean is not None
    return float(np.square(picture - sample.clean).mean())


def _on(device: str, batch: Batch) -> Batch:
    return {name: plane.to(device) for name, plane in batch.items()}


def _spread(found: list[T]) -> list[T]:
    """At most as many as are measured each time, evenly spaced."""
    count = min(_MOST_MEASURED, len(found))
    return [found[number * len(found) // count] for number in range(count)]
