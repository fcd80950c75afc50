"""What weights are fitted to: frames towards the mean of the others."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from itertools import count

import numpy as np
import torch
from torch import Tensor

from ...factory.common.array_types import Float32s
from ...factory.common.seeds import stream
from ..data.crops import concatenate, crop, whole_image
from ..data.pairs import Batch, TrainingImage, spread
from ..networks import averaged
from ..networks.network import Network, known_extras
from ..settings import TrainSettings
from ..training.loop import Row, TrainingLoop, denoised
from .stretches import Lessons, Still

_BATCH = 2  # crops of a step
_PATCH = 192  # crops have as many pixels as a square of this side, where images are large enough
_CHECKS = 5  # times that the weights are measured on the way, at most; the best are kept
_MOST_MEASURED = 4
_TRIES = 6
_LEAST_KNOWN = 0.25  # of a crop's pixels
_SEVERAL = 0.5  # of the steps show means of frames to weights that know how many
_MOST_FRAMES = 7
_LEAST_OTHERS = 3  # frames that a target is the mean of


class Lesson:
    """Crops of the steps, which depend on the seed and the step alone; and the frames held out.

    choosing: frames that choose the step whose weights are kept.  judging: other frames, which
    nothing is chosen by; where a single frame is held out, the same.
    """

    def __init__(self, lessons: Lessons, seed: int, extras: Sequence[str]) -> None:
        """extras: optional inputs of the network."""
        self.stills = lessons.learning
        self.seed = seed
        self.extras = extras
        # All recordings alike, however long, and in each all frames alike.
        frames = np.array([len(still.frames) for still in self.stills], float)
        recordings = np.array([still.recording for still in self.stills])
        for number in np.unique(recordings):
            frames[recordings == number] /= frames[recordings == number].sum()
        self._odds = frames / frames.sum()

        held = tuple(_single(still, i) for still in lessons.held for i in range(len(still.frames)))
        samples = spread(held, 2 * _MOST_MEASURED)
        if "frames" in extras:
            several = (still for still in lessons.held if _most(still) > 1)
            means = tuple(_mean(still, 0, _most(still)) for still in several)
            samples += spread(means, 2 * _MOST_MEASURED)
        self.choosing = samples[::2]
        self.judging = samples[1::2] or samples

    @property
    def is_judged_apart(self) -> bool:
        """Whether the judging frames had no part in choosing the weights."""
        return self.judging[0] is not self.choosing[0]

    def crops(self, step: int) -> Batch:
        """What is learned from in a step."""
        rng = stream(self.seed, "adapt", "still", step)
        still = self.stills[rng.choice(len(self.stills), p=self._odds)]
        if "frames" in self.extras and _most(still) > 1 and rng.random() < _SEVERAL:
            counts = rng.integers(2, _most(still) + 1, size=_BATCH)
            firsts = [int(rng.integers(len(still.laid) - count + 1)) for count in counts]
            samples = [_mean(still, *both) for both in zip(firsts, counts, strict=True)]
        else:
            samples = [_single(still, i) for i in rng.integers(len(still.frames), size=_BATCH)]
        return concatenate([_crop(sample, self.extras, rng) for sample in samples])

    def figure(self, samples: Sequence[TrainingImage], network: Network | None = None) -> float:
        """Mean PSNR in dB after levels against the mean of the others; None: of the frames."""
        figures = []
        for sample in samples:
            image = sample.noisy
            if network is not None:
                image = denoised(network, whole_image(sample, self.extras))
            figures.append(psnr_after_levels(image, sample.clean))
        return float(np.mean(figures))


def tune(
    network: Network, lesson: Lesson, steps: int, learning_rate: float, device: torch.device
) -> Row:
    """Fit the network; it ends with the best weights of all checks, in evaluation mode.

    Returns their step, 0 where none on the way were better than the first; and `before` and
    `after`, PSNR in dB of the frames that judge.  The same seed and number of steps give the same
    weights.
    Raises FactoryError when the loss becomes no number, and `Stopped` after Ctrl-C.
    """
    every = steps // next(times for times in range(_CHECKS, 0, -1) if steps % times == 0)
    settings = TrainSettings(
        steps=steps,
        check_every=every,
        learning_rate=learning_rate,
        weight_decay=1e-4,
        warmup=10,
        clip=1.0,
        ema=0.98,
        precision="32-true",
    )
    loop = TrainingLoop(
        network, squared_differences, settings, lesson.seed, device, label="adapting"
    )
    before = lesson.figure(lesson.judging, network)
    first = lesson.figure(lesson.choosing, network)
    best: Row = {"step": 0, "figure": first}
    best_weights = copy.deepcopy(network.state_dict())

    def check(step: int, loss: float) -> Row:
        figure = lesson.figure(lesson.choosing, loop.average)
        loop.bar.set_postfix(f"{first:.2f} -> {figure:.2f} dB")
        if figure > best["figure"]:
            best.update(step=step, figure=figure)
            best_weights.update(copy.deepcopy(loop.average.state_dict()))
        return {"step": step, "loss": loss, "figure": figure}

    loop.run(lambda step: map(lesson.crops, count(step)), check)
    network.load_state_dict(best_weights)
    network.eval()
    after = lesson.figure(lesson.judging, network)
    return {"step": best["step"], "before": before, "after": after}


def squared_differences(network: Network, batch: Batch) -> Tensor:
    """Mean squared difference from the mean of the other frames, where that is known.

    What many noisy targets average to is learned (Lehtinen et al., Noise2Noise, ICML 2018).
    """
    known = torch.isfinite(batch["clean"])
    output = network(batch["noisy"], **known_extras(network, batch))
    difference = output - torch.nan_to_num(batch["clean"])
    loss: Tensor = (difference.square() * known).sum() / known.sum().clamp_min(1)
    return loss


def psnr_after_levels(image: Float32s, reference: Float32s) -> float:
    """PSNR in dB where the reference is known, after one gain and offset; at most 100 dB.

    image, reference: (H, W) float32 in 0..1; the reference is NaN where it is unknown.  The gain
    and offset are those of least squares, so brightness and contrast do not count.
    """
    is_known = np.isfinite(reference)
    x = image[is_known].astype(np.float64)
    y = reference[is_known].astype(np.float64)
    power = float(x.var())
    gain = float(((x - x.mean()) * (y - y.mean())).mean()) / power if power > 1e-12 else 0.0
    fitted = np.clip(gain * (x - x.mean()) + y.mean(), 0, 1)
    return float(-10 * np.log10(max(float(np.square(fitted - y).mean()), 1e-10)))


def _single(still: Still, number: int) -> TrainingImage:
    return TrainingImage(still.frames[number], still.targets[number], None, still.geometry)


def _mean(still: Still, first: int, count: int) -> TrainingImage:
    """The mean of frames that follow each other, towards that of the others of the stretch."""
    noisy, target = still.averaged(first, count)
    frames = np.full(noisy.shape, averaged(count), np.float32)
    return TrainingImage(noisy, target, None, still.geometry, frames=frames)


def _most(still: Still) -> int:
    """The most frames to average: enough others are left for a target."""
    return min(_MOST_FRAMES, len(still.laid) - _LEAST_OTHERS)


def _crop(sample: TrainingImage, extras: Sequence[str], rng: np.random.Generator) -> Batch:
    """A batch of one, mirrored or not; drawn again while most of its target is unknown."""
    height, width = sample.noisy.shape
    rows, columns = min(height, _PATCH), min(width, _PATCH)
    # Patches of narrow images are longer, for as many pixels.
    if columns < _PATCH:
        rows = min(height, _PATCH * _PATCH // columns)
    if rows < _PATCH:
        columns = min(width, _PATCH * _PATCH // rows)
    for _ in range(_TRIES):
        top = int(rng.integers(height - rows + 1))
        left = int(rng.integers(width - columns + 1))
        if np.isfinite(sample.clean[top : top + rows, left : left + columns]).mean() > _LEAST_KNOWN:
            break
    return crop(sample, (top, left), (rows, columns), bool(rng.random() < 0.5), extras)
