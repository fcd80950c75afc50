"""Fitting weights: steps of two lessons at once, and the best of what was measured on the way."""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import cast

import torch
from torch import Tensor
from torch.optim.swa_utils import AveragedModel

from ...factory.errors import FactoryError
from ...factory.progress import progress_bar
from ...factory.seeds import stream
from ..networks.network import Network
from .objectives import Lesson

WARMUP = 10
"""Steps in which the learning rate climbs, and whose pace says how many fit into the time."""

_CHECKS = 5
_CLIP = 1.0


@dataclass(frozen=True)
class Pace:
    """steps: how many; None: as many as fit into `minutes`.

    keep: weight of the simulated pictures in the loss, 0..1.
    learning_rate: of AdamW at its highest.  average: steps that the weights are averaged over.
    part: of the change of the weights that is kept, 0..1.  Between the weights before and after lie
    some that serve other recordings better than either (Wortsman et al., CVPR 2022).
    """

    steps: int | None
    minutes: float
    keep: float
    learning_rate: float = 1e-3
    average: int = 50
    part: float = 1.0


@dataclass
class Tuned:
    """The best weights: `state` of the network at `step` of `steps`, and the figures it has.

    before, after: figures of the lesson.  rows: (step, figure) of all that was measured.
    """

    state: dict[str, Tensor]
    before: float
    after: float
    step: int = 0
    steps: int = 0
    rows: list[tuple[int, float]] = field(default_factory=list)

    @property
    def is_better(self) -> bool:
        """Whether anything came out better than what it began with."""
        return self.after > self.before


def tune(network: Network, lesson: Lesson, kept: Lesson | None, pace: Pace, seed: int) -> Tuned:
    """Fit the network to `lesson` and `kept`; it ends with the best weights, in evaluation mode.

    With `pace.steps` given, the same seed gives the same weights.  Raises FactoryError when the
    loss becomes no number.
    """
    started = time.monotonic()
    before = lesson.figure(network)
    check_s = time.monotonic() - started
    start = copy.deepcopy(network.state_dict())
    found = Tuned(start, before, before)
    average = AveragedModel(network, multi_avg_fn=_running_average(1 - 1 / pace.average))
    averaged = cast(Network, average.module)
    shown = copy.deepcopy(network).eval()
    optimizer = torch.optim.AdamW(
        network.parameters(), lr=pace.learning_rate, betas=(0.9, 0.99), weight_decay=1e-4
    )
    steps = pace.steps
    begun = time.monotonic()
    with progress_bar(total=steps, unit="step", desc="adapting") as bar:
        step = 0
        while steps is None or step < steps:
            _take_step(network, optimizer, lesson, kept, pace, seed, step, steps)
            average.update_parameters(network)
            step += 1
            bar.update()
            if steps is None and step == WARMUP:
                left_s = 60 * pace.minutes - (time.monotonic() - started) - _CHECKS * check_s
                steps = WARMUP + max(0, int(left_s / ((time.monotonic() - begun) / WARMUP)))
                bar.total = steps
                bar.refresh()
            if steps is not None and (step == steps or step % math.ceil(steps / _CHECKS) == 0):
                shown.load_state_dict(_between(start, averaged.state_dict(), pace.part))
                figure = lesson.figure(shown)
                found.rows.append((step, figure))
                bar.set_postfix_str(f"{before:.2f} -> {figure:.2f} {lesson.unit}")
                if figure > found.after:
                    found.after, found.step = figure, step
                    found.state = copy.deepcopy(shown.state_dict())
        found.steps = step
    network.load_state_dict(found.state)
    network.eval()
    return found


def _take_step(
    network: Network,
    optimizer: torch.optim.Optimizer,
    lesson: Lesson,
    kept: Lesson | None,
    pace: Pace,
    seed: int,
    step: int,
    steps: int | None,
) -> None:
    """One update of the weights; it depends on the seed, the step and the weights alone."""
    torch.manual_seed(int(stream(seed, "adapt", "torch", step).integers(2**62)))
    network.train()
    for group in optimizer.param_groups:
        group["lr"] = pace.learning_rate * _rate(step, steps)
    loss = lesson.loss(network, step)
    if kept is not None:
        loss = (1 - pace.keep) * loss + pace.keep * kept.loss(network, step)
    if not torch.isfinite(loss):
        raise FactoryError(f"the loss became {loss.item()} at step {step}; are the pictures odd?")
    optimizer.zero_grad()
    torch.autograd.backward(loss)
    torch.nn.utils.clip_grad_norm_(network.parameters(), _CLIP)
    optimizer.step()


def _between(before: dict[str, Tensor], after: dict[str, Tensor], part: float) -> dict[str, Tensor]:
    """The weights that lie `part` of the way from one state to the other; all of it is exact."""
    if part == 1:
        return after
    return {name: torch.lerp(value, after[name], part) for name, value in before.items()}


def _running_average(decay: float) -> Callable[..., None]:
    """Exponential average of parameters; short at first, when weights change fast."""

    @torch.no_grad()
    def update(average: list[Tensor], current: list[Tensor], count: Tensor | int) -> None:
        keep = min(decay, (1 + int(count)) / (10 + int(count)))
        torch._foreach_lerp_(average, current, 1 - keep)

    return update


def _rate(step: int, steps: int | None) -> float:
    """Share of the full learning rate: a linear warm-up, then a cosine to zero."""
    if steps is None or step < WARMUP:
        return (step + 1) / WARMUP
    return 0.5 * (1 + math.cos(math.pi * (step - WARMUP) / max(1, steps - WARMUP)))
