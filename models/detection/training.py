"""Training of a detector that goes on where it was killed, with the same result."""

from __future__ import annotations

import io
import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ...factory.common.errors import FactoryError
from ...factory.common.files import write_atomically
from ...factory.common.private_apis import move_averages
from ...factory.common.progress import Bar
from ...factory.common.seeds import stream
from .augmentation import vary
from .detector import DIVISOR
from .images import WorkingImage, canvas_shape
from .network import DetectorNetwork
from .objective import Targets, detection_loss, draw_targets
from .weights import DetectorFacts, TrainedDetector, load_detector, read_facts, save_detector

CHECKPOINT_NAME = "checkpoint.pt"
DETECTOR_NAME = "detector.safetensors"

_SAVE_EVERY_S = 60.0
_AVERAGE_STEPS = 400  # length of the running average of the weights
_WEIGHT_DECAY = 0.02
_GREATEST_NORM = 5.0
_RISE_STEPS = 100
_FALL_SHARE = 0.3  # of the steps, at the end, in which the learning rate falls to zero


@dataclass(frozen=True)
class Schedule:
    """How long and how fast a detector learns.

    steps: of `batch` images each.  learning_rate: the highest one, of AdamW.
    """

    steps: int
    batch: int
    learning_rate: float
    seed: int


@dataclass(frozen=True, eq=False)
class BatchShare:
    """Images to learn from, and which share of every batch they are.

    with_clutter: whether unlabelled echoes are drawn over them.
    """

    images: Sequence[WorkingImage]
    share: float
    with_clutter: bool


def train_detector(
    folder: Path,
    sources: Sequence[BatchShare],
    classes: Sequence[str],
    schedule: Schedule,
    facts: Mapping[str, Any],
    *,
    start: TrainedDetector | None = None,
    label: str = "training",
) -> TrainedDetector:
    """Train, or go on with the training that the folder holds; a finished one is read.

    facts: what the detector's file says of its data; another recipe in the folder is refused.
    start: weights to begin with.  Raises FactoryError.
    """
    recipe = json.loads(json.dumps({"schedule": asdict(schedule), **facts}))
    detector_path = folder / DETECTOR_NAME
    if detector_path.is_file():
        _refuse_other_recipe(folder, read_facts(detector_path).training, recipe)
        return load_detector(detector_path)
    if not all(source.images for source in sources):
        raise FactoryError("there are no images to learn from")
    training = _Training(sources, len(classes), schedule, start)
    training.run(folder, recipe, label)
    training._copy_counts()
    average = training.average.eval()
    save_detector(detector_path, average, DetectorFacts(tuple(classes), recipe))
    (folder / CHECKPOINT_NAME).unlink(missing_ok=True)
    # What is judged is what the file holds.
    return load_detector(detector_path)


def _refuse_other_recipe(
    folder: Path, stored: Mapping[str, Any], wanted: Mapping[str, Any]
) -> None:
    keys = [key for key in {**stored, **wanted} if stored.get(key) != wanted.get(key)]
    if keys:
        raise FactoryError(
            f"{folder}: holds a detector with another {', '.join(keys)}; choose another out=, or "
            "delete the folder"
        )


class _Pairs:
    """Tensors of an average and of the network that it follows, in the same order.

    Both share memory with their modules, whose states may be loaded but not replaced.
    """

    def __init__(self, average: DetectorNetwork, network: DetectorNetwork) -> None:
        current = network.state_dict()
        followed = [
            (tensor, current[name])
            for name, tensor in average.state_dict().items()
            if tensor.is_floating_point()
        ]
        self.averages = [average for average, _ in followed]
        self.values = [value for _, value in followed]


class _Training:
    """Network, running average of its weights and optimizer, and the steps done."""

    def __init__(
        self,
        sources: Sequence[BatchShare],
        class_count: int,
        schedule: Schedule,
        start: TrainedDetector | None,
    ) -> None:
        torch.manual_seed(int(stream(schedule.seed, "detector").integers(2**62)))
        self.sources = sources
        self.schedule = schedule
        self.step = 0
        self.losses: list[float] = []
        self.network = DetectorNetwork(class_count)
        if start is not None:
            self.network.load_state_dict(start.network.state_dict())
        self.network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.average = DetectorNetwork(class_count).requires_grad_(False)
        self.average.load_state_dict(self.network.state_dict())
        self.optimizer = torch.optim.AdamW(
            self.network.parameters(),
            lr=schedule.learning_rate,
            weight_decay=_WEIGHT_DECAY,
            fused=True,  # one pass over all weights
        )
        self._smooth = _Pairs(self.average, self.network)
        every_image = [working for source in sources for working in source.images]
        self.shape = canvas_shape(every_image, DIVISOR)

    def run(self, folder: Path, recipe: Mapping[str, Any], label: str) -> None:
        """Take all steps that are left, and keep a checkpoint in the folder."""
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / CHECKPOINT_NAME
        if path.is_file():
            self._restore(path, recipe)
        saved_s = time.monotonic()
        steps = self.schedule.steps
        self.network.train()
        with Bar(total=steps, initial=self.step, unit="step", desc=label) as bar:
            while self.step < steps:
                self._take_step()
                bar.update()
                if time.monotonic() - saved_s > _SAVE_EVERY_S:
                    self._save(path, recipe)
                    saved_s = time.monotonic()

    def _take_step(self) -> None:
        for group in self.optimizer.param_groups:
            group["lr"] = self._learning_rate()
        inputs, targets = self._draw_batch()
        loss = detection_loss(self.network(inputs), targets)
        if not torch.isfinite(loss):
            raise FactoryError(
                f"the loss became {loss.item()} at step {self.step}; lower learning_rate"
            )
        self.optimizer.zero_grad()
        torch.autograd.backward(loss)
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), _GREATEST_NORM)
        self.optimizer.step()
        self._update_average()
        self.losses.append(float(loss.detach()))
        self.step += 1

    def _learning_rate(self) -> float:
        """The learning rate of the next step: it rises, stays, and falls to zero, linearly."""
        steps = self.schedule.steps
        risen = (self.step + 1) / min(_RISE_STEPS, max(1, steps // 4))
        left = (steps - self.step) / max(1.0, _FALL_SHARE * steps)
        return self.schedule.learning_rate * min(risen, 1.0, left)

    def _draw_batch(self) -> tuple[Tensor, Targets]:
        """Draw the images of this step, as the seed and the number of the step decide alone."""
        rng = stream(self.schedule.seed, "detector", self.step)
        shares = np.array([source.share for source in self.sources])
        inputs = []
        drawn = []
        for _ in range(self.schedule.batch):
            source = self.sources[int(rng.choice(len(shares), p=shares / shares.sum()))]
            working = source.images[int(rng.integers(len(source.images)))]
            values, boxes, labels = vary(working, self.shape, rng, with_clutter=source.with_clutter)
            inputs.append(values)
            drawn.append(draw_targets(boxes, labels, *self.shape))
        columns = [torch.from_numpy(np.stack(column)) for column in zip(*drawn, strict=True)]
        batch = torch.from_numpy(np.stack(inputs)).contiguous(memory_format=torch.channels_last)
        return batch, Targets(*columns)

    @torch.no_grad()
    def _update_average(self) -> None:
        """Move the average towards the weights, faster at first, when weights change fast."""
        keep = min(1 - 1 / _AVERAGE_STEPS, (1 + self.step) / (10 + self.step))
        move_averages(self._smooth.averages, self._smooth.values, 1 - keep)

    def _copy_counts(self) -> None:
        """Whole numbers, such as the batches that a norm has seen, have no average."""
        current = self.network.state_dict()
        for name, tensor in self.average.state_dict().items():
            if not tensor.is_floating_point():
                tensor.copy_(current[name])

    def _save(self, path: Path, recipe: Mapping[str, Any]) -> None:
        self._copy_counts()
        content = io.BytesIO()
        state = {
            "recipe": json.dumps(recipe, sort_keys=True),
            "step": self.step,
            "network": self.network.state_dict(),
            "average": self.average.state_dict(),
            "optimizer": self.optimizer.state_dict(),
        }
        torch.save(state, content)
        write_atomically(path, content.getvalue(), key="out")

    def _restore(self, path: Path, recipe: Mapping[str, Any]) -> None:
        try:
            state = torch.load(path, map_location="cpu", weights_only=True)
            stored = json.loads(state["recipe"])
        except Exception as error:
            # torch reports a damaged file with a dozen exception types.
            raise FactoryError(f"{path}: damaged; delete it to start anew") from error
        _refuse_other_recipe(path.parent, stored, recipe)
        self.step = state["step"]
        self.network.load_state_dict(state["network"])
        self.average.load_state_dict(state["average"])
        self.optimizer.load_state_dict(state["optimizer"])
