"""What weights are fitted to: frames towards the mean of the others, and pairs of a dataset."""

from __future__ import annotations

import copy
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
import torch
from lightning.fabric import Fabric
from torch import Tensor

from ...factory.seeds import stream
from ..data.crops import concatenate, crop, whole_image_batch
from ..data.pairs import Batch, Image, PairSource, Sample, hold_out, read_table
from ..losses import L1
from ..networks.network import Network, known_extras
from ..removal import averaged
from ..settings import TrainSettings
from ..training.loop import Loop
from ..training.module import DenoisingModule, Row
from ..training.samples import denoise_batch
from .stretches import Lessons, Still

BATCH = 2
"""Crops of a step from recordings, and as many from pairs."""
PATCH = 192
"""Crops have as many pixels as a square of this side, where pictures are large enough."""
CHECKS = 5
"""Times that the weights are measured on the way; the best are kept."""

_KEEP = 0.5  # weight of pairs in the loss, where there are any
_MOST_PAIRS, _HELD_PAIRS = 64, 8
_MOST_MEASURED = 4
_TIMED = 3  # steps whose pace says how many fit into the minutes
_TRIES = 6
_LEAST_KNOWN = 0.25  # of a crop's pixels
_SEVERAL = 0.5  # of the steps show means of frames to weights that know how many
_MOST_FRAMES = 7
_LEAST_OTHERS = 3  # frames that a target is the mean of

T = TypeVar("T")


@dataclass
class Best:
    """Figures before and after, PSNR in dB; the weights of the best check, and its step."""

    before: float
    after: float
    state: dict[str, Tensor]
    step: int = 0


class AdaptModule(DenoisingModule):
    """Squared differences to the means of the other frames: what many noisy targets average to.

    After Lehtinen et al., Noise2Noise, ICML 2018.
    """

    def __init__(self, network: Network, settings: TrainSettings, seed: int) -> None:
        super().__init__(network, L1(kind="l1"), settings, seed)

    def forward(self, batch: Any) -> Tensor:
        """The loss of the crops of a step: `still`, one batch, and `kept`, of pairs, several."""
        loss = self._squares(batch["still"])
        if batch["kept"]:
            kept = torch.stack([self._squares(part) for part in batch["kept"]]).mean()
            loss = (1 - _KEEP) * loss + _KEEP * kept
        return loss

    def _squares(self, batch: Batch) -> Tensor:
        """Mean squared difference where the target is known."""
        known = torch.isfinite(batch["clean"])
        made = self.network(batch["noisy"], **known_extras(self.network, batch))
        difference = made - torch.nan_to_num(batch["clean"])
        loss: Tensor = (difference.square() * known).sum() / known.sum().clamp_min(1)
        return loss


class Lesson:
    """Crops of the steps, which depend on the seed and the step alone; and the frames held out."""

    def __init__(
        self, found: Lessons, seed: int, knows_frames: bool = False, dataset: Path | None = None
    ) -> None:
        """knows_frames: whether the weights know how many frames were averaged.

        dataset: whose pairs are learned beside, every other one without its geometry, as pictures
        often come.  Raises FactoryError when it holds none.
        """
        self.stills, self.seed, self.knows_frames = found.learning, seed, knows_frames
        self.kept, self.kept_held = _pairs(dataset, seed) if dataset else ([], [])
        self._odds = odds_of(found.learning)
        held = [
            (Sample(frame, target, None, still.geometry))
            for still in found.held
            for frame, target in zip(still.frames, still.targets, strict=True)
        ]
        self.held = _spread(held)
        if knows_frames:
            means = [mean_of(still, 0, _most(still)) for still in found.held if _most(still) > 1]
            self.held += _spread(means)

    def crops(self, step: int, extras: Sequence[str]) -> dict[str, Any]:
        """What `AdaptModule` learns from in a step."""
        rng = stream(self.seed, "adapt", "still", step)
        still = self.stills[rng.choice(len(self.stills), p=self._odds)]
        if self.knows_frames and _most(still) > 1 and rng.random() < _SEVERAL:
            counts = rng.integers(2, _most(still) + 1, size=BATCH)
            firsts = [int(rng.integers(len(still.laid) - count + 1)) for count in counts]
            samples = [mean_of(still, *both) for both in zip(firsts, counts, strict=True)]
        else:
            numbers = rng.integers(len(still.frames), size=BATCH)
            samples = [
                Sample(still.frames[i], still.targets[i], None, still.geometry) for i in numbers
            ]
        parts = [_crop(sample, extras, rng) for sample in samples]
        kept = []
        if self.kept:
            rng = stream(self.seed, "adapt", "kept", step)
            drawn = rng.integers(len(self.kept), size=BATCH)
            kept = [_crop(self.kept[number], extras, rng) for number in drawn]
        return {"still": concatenate(parts), "kept": kept}

    def figure(self, network: Network) -> float:
        """Mean PSNR in dB after levels against the mean of the other frames; more is better."""
        made = [(_denoised(network, one), one.clean) for one in self.held]
        return float(np.mean([psnr_after_levels(a, b) for a, b in made if b is not None]))

    def noisy_figure(self) -> float:
        """The figure of the frames as they are."""
        pairs = [(one.noisy, one.clean) for one in self.held]
        return float(np.mean([psnr_after_levels(a, b) for a, b in pairs if b is not None]))

    def kept_figure(self, network: Network) -> float:
        """Mean PSNR in dB of the pairs held out."""
        return float(np.mean([_psnr(_denoised(network, one), one) for one in self.kept_held]))


def _pairs(dataset: Path, seed: int) -> tuple[list[Sample], list[Sample]]:
    """Pairs of a dataset's train split to learn from, and others of other scenes."""
    table = read_table(dataset, "train")
    parts: list[list[Sample]] = []
    learning, held = hold_out(table.samples, 0.2, seed)
    for samples, limit in ((learning, _MOST_PAIRS), (held, _HELD_PAIRS)):
        order = stream(seed, "adapt", "pairs", len(parts)).permutation(len(samples))[:limit]
        source = PairSource([samples[i] for i in sorted(order.tolist())], table.sonar)
        parts.append([source.sample(index, None) for index in range(len(source))])
    told = [replace(one, geometry=None) if i % 2 else one for i, one in enumerate(parts[0])]
    return told, parts[1]


def steps_within(minutes: float, module: AdaptModule, lesson: Lesson, fabric: Fabric) -> int:
    """How many steps fit, in whole fifths, by the pace of a few that are thrown away."""
    tried = copy.deepcopy(module).to(fabric.device)
    extras = module.network.extras
    started = time.monotonic()
    for step in range(_TIMED):
        torch.autograd.backward(tried(fabric.to_device(lesson.crops(step, extras))))
    step_s = (time.monotonic() - started) / _TIMED
    started = time.monotonic()
    lesson.figure(module.network)
    check_s = time.monotonic() - started
    left_s = 60 * minutes - CHECKS * check_s
    return max(1, int(left_s / step_s / CHECKS)) * CHECKS


def tune(module: AdaptModule, lesson: Lesson, fabric: Fabric) -> Best:
    """Fit the network; it ends with the best weights of all checks, in evaluation mode.

    The same seed and number of steps give the same weights.
    Raises FactoryError when the loss becomes no number, and `Stopped` after Ctrl-C.
    """
    network, settings = module.network, module.settings
    before = lesson.figure(network)
    best = Best(before, before, copy.deepcopy(network.state_dict()))
    loop = Loop(
        fabric,
        module,
        steps=settings.steps,
        check_every=settings.check_every,
        seed=module.seed,
        label="adapting",
    )

    def batches(interval: int, done: int) -> Iterator[Any]:
        first = interval * settings.check_every
        for step in range(first + done, first + settings.check_every):
            yield lesson.crops(step, network.extras)

    def check(step: int, loss: float) -> Row:
        averaged: Any = module.average.module.eval()
        figure = lesson.figure(averaged)
        loop.show(f"{before:.2f} -> {figure:.2f} dB")
        if figure > best.after:
            best.after, best.step = figure, step
            best.state = copy.deepcopy(averaged.state_dict())
        return {"step": step, "loss": loss, "figure": figure}

    loop.run(batches, check, lambda rows: False)
    network.load_state_dict(best.state)
    network.eval()
    return best


def psnr_after_levels(picture: Image, reference: Image) -> float:
    """PSNR in dB where the reference is known, after one gain and offset; at most 100 dB.

    picture, reference: (H, W) float32 in 0..1; the reference is NaN where it is unknown.  The gain
    and offset are those of least squares, so brightness and contrast do not count.
    """
    where = np.isfinite(reference)
    x, y = picture[where].astype(np.float64), reference[where].astype(np.float64)
    spread = float(x.var())
    gain = float(((x - x.mean()) * (y - y.mean())).mean()) / spread if spread > 1e-12 else 0.0
    fitted = np.clip(gain * (x - x.mean()) + y.mean(), 0, 1)
    return float(-10 * np.log10(max(float(np.square(fitted - y).mean()), 1e-10)))


def mean_of(still: Still, first: int, count: int) -> Sample:
    """The mean of frames that follow each other, towards that of the others of the stretch."""
    noisy, target = still.averaged(first, count)
    frames = np.full(noisy.shape, averaged(count), np.float32)
    return Sample(noisy, target, None, still.geometry, frames=frames)


def _most(still: Still) -> int:
    """The most frames to average: enough others are left for a target."""
    return min(_MOST_FRAMES, len(still.laid) - _LEAST_OTHERS)


def odds_of(stills: Sequence[Still]) -> npt.NDArray[np.float64]:
    """(stretches,): all recordings alike, however long, and in each all frames alike."""
    frames = np.array([len(still.frames) for still in stills], float)
    recordings = np.array([still.recording for still in stills])
    for number in np.unique(recordings):
        frames[recordings == number] /= frames[recordings == number].sum()
    return np.asarray(frames / frames.sum(), np.float64)


def crop_size(height: int, width: int) -> tuple[int, int]:
    """Rows and columns of a crop: of narrow pictures longer than wide, for as many pixels."""
    rows, columns = min(height, PATCH), min(width, PATCH)
    if columns < PATCH:
        rows = min(height, PATCH * PATCH // columns)
    if rows < PATCH:
        columns = min(width, PATCH * PATCH // rows)
    return rows, columns


def _crop(sample: Sample, extras: Sequence[str], rng: np.random.Generator) -> Batch:
    """A batch of one, mirrored or not; drawn again while most of its target is unknown."""
    assert sample.clean is not None
    height, width = sample.noisy.shape
    rows, columns = crop_size(height, width)
    for _ in range(_TRIES):
        top = int(rng.integers(height - rows + 1))
        left = int(rng.integers(width - columns + 1))
        if np.isfinite(sample.clean[top : top + rows, left : left + columns]).mean() > _LEAST_KNOWN:
            break
    return crop(sample, (top, left), (rows, columns), bool(rng.random() < 0.5), extras)


def _denoised(network: Network, sample: Sample) -> Image:
    shown = Sample(sample.noisy, geometry=sample.geometry, frames=sample.frames)
    return denoise_batch(network, whole_image_batch(shown, network.extras))


def _psnr(picture: Image, sample: Sample) -> float:
    assert sample.clean is not None
    return float(-10 * np.log10(max(float(np.square(picture - sample.clean).mean()), 1e-10)))


def _spread(found: list[T]) -> list[T]:
    """At most as many as are measured each time, evenly spaced."""
    count = min(_MOST_MEASURED, len(found))
    return [found[number * len(found) // count] for number in range(count)]
