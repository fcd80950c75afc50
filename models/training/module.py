"""A network in training: the running average of its weights, a step, and a validation."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import ClassVar

import torch
from torch import Tensor, nn
from torch.optim import Optimizer
from torch.optim.swa_utils import AveragedModel

from ...factory.errors import FactoryError
from ..data.pairs import Batch
from ..losses import Loss
from ..networks.network import Network, known_extras
from ..networks.weights import channels_last, load_weights
from ..settings import TrainSettings
from .quality import psnr_db, shadow_iou, ssim

Row = dict[str, float | int]


class Teacher:
    """Trained weights whose pictures a network learns to make (Hinton et al. 2015, for pictures).

    What a small network cannot do shows as noise in the gradients when it learns from clean
    pictures alone; the pictures of a larger one that learned from the same are nearer to what it
    can do.
    """

    def __init__(self, weights: Path, share: float) -> None:
        """weights: a file that training wrote.  share: of its pictures in the targets, 0 to 1.

        Raises FactoryError for a file that holds no weights.
        """
        self.network = load_weights(weights).network.requires_grad_(False).eval()
        self.share = share

    @torch.no_grad()
    def seen(self, batch: Batch) -> Tensor:
        """(N, C, H, W) with the whole change."""
        noisy = batch["noisy"]
        self.network.to(noisy.device)
        known = known_extras(self.network, batch)
        if not self.network.has_heads:
            image: Tensor = self.network(noisy, **known)
            return image
        return self.network.with_heads(noisy, **known).image


class DenoisingModule(nn.Module):
    """A network, the running average of its weights, and how a step is made.

    The average is what is validated and saved.

    step: of the whole training; the loop sets it.  extras: what batches have to hold beside the
    pictures, the optional inputs of the network and of its teacher.
    """

    FIGURES: ClassVar[tuple[str, ...]] = (
        *("psnr_noisy", "psnr", "ssim_noisy", "ssim"),
        *("shadow_iou_noisy", "shadow_iou"),
    )
    """What a validation measures, in the order of metrics.csv."""

    def __init__(
        self,
        network: Network,
        loss: Loss,
        settings: TrainSettings,
        seed: int = 0,
        teacher: Teacher | None = None,
    ) -> None:
        super().__init__()
        self.network: Network = channels_last(network)
        self.average = AveragedModel(self.network, multi_avg_fn=running_average(settings.ema))
        self.average.requires_grad_(False)
        self.loss, self.settings, self.seed = loss, settings, seed
        self.step = 0
        # No module of torch's own: its weights are neither saved nor averaged.
        self.teacher = teacher
        taught = teacher.network.extras if teacher else ()
        self.extras: tuple[str, ...] = tuple(dict.fromkeys((*network.extras, *taught)))

    def make_optimizer(self) -> Optimizer:
        """AdamW of all weights that learn."""
        return torch.optim.AdamW(
            [weights for weights in self.network.parameters() if weights.requires_grad],
            lr=self.settings.learning_rate,
            betas=(0.9, 0.99),
            weight_decay=self.settings.weight_decay,
        )

    def learning_rate(self, step: int) -> float:
        """A linear warm-up and a cosine decay to zero, counted in steps."""
        chosen = self.settings
        return chosen.learning_rate * learning_rate_factor(step, chosen.warmup, chosen.steps)

    def autocast(self) -> torch.autocast:
        """The arithmetic of `train.precision`."""
        device = next(self.network.parameters()).device.type
        return torch.autocast(device, torch.bfloat16, enabled=self._is_mixed)

    @property
    def _is_mixed(self) -> bool:
        return self.settings.precision == "bf16-mixed"

    def update(self, optimizer: Optimizer, batch: Batch) -> Tensor:
        """One step; returns its loss.  Raises FactoryError when that is not a number."""
        for group in optimizer.param_groups:
            group["lr"] = self.learning_rate(self.step)
        if self._is_mixed:
            # In 16 bits from the start, as the weights that ship were trained.
            batch = {k: v.bfloat16() if v.is_floating_point() else v for k, v in batch.items()}
        with self.autocast():
            loss: Tensor = self(batch).float()
        if not torch.isfinite(loss):
            raise FactoryError(
                f"the loss became {loss.item()} at step {self.step}; lower train.learning_rate, "
                "or check the dataset for odd values"
            )
        optimizer.zero_grad()
        torch.autograd.backward(loss)
        weights = [one for group in optimizer.param_groups for one in group["params"]]
        torch.nn.utils.clip_grad_norm_(weights, self.settings.clip)
        optimizer.step()
        self.average.update_parameters(self.network)
        return loss

    def forward(self, batch: Batch) -> Tensor:
        """The loss of one batch of crops."""
        extras = known_extras(self.network, batch)
        if self.network.has_heads:
            output = self.network.with_heads(batch["noisy"], **extras)
            prediction = output.image
            batch |= {"shadow_logits": output.shadow_logits, "weight": output.weight}
        else:
            prediction = self.network(batch["noisy"], **extras)
        if "taught" in batch or self.teacher is not None:
            batch = completed(batch, prediction, self.teacher)
        return self.loss(prediction, batch["clean"], batch)

    def measure(self, batch: Batch) -> dict[str, float]:
        """Quality of a whole validation image before and after denoising."""
        noisy, clean = batch["noisy"], batch["clean"]
        denoised = self.average(noisy, **known_extras(self.network, batch)).float().clamp(0, 1)
        found = (
            *(psnr_db(noisy, clean), psnr_db(denoised, clean)),
            *(ssim(noisy, clean), ssim(denoised, clean)),
            *(shadow_iou(noisy, batch), shadow_iou(denoised, batch)),
        )
        return {name: float(one.mean()) for name, one in zip(self.FIGURES, found, strict=True)}


def completed(batch: Batch, prediction: Tensor, teacher: Teacher | None) -> Batch:
    """The batch with a target everywhere: `taught` of it (else its share) is the teacher's picture.

    Where nothing is known (NaN) the target is the prediction, which then costs nothing.
    """
    clean, batch = batch["clean"], dict(batch)
    if teacher is not None:
        image = teacher.seen(batch).to(clean.dtype)
        taught = batch.get("taught", torch.full_like(clean[:, :1, :1, :1], teacher.share))
        mixed = torch.where(clean.isnan(), image, torch.lerp(clean, image, taught))
        clean = torch.where(taught > 0, mixed, clean)
    batch["clean"] = torch.where(clean.isnan(), prediction.detach(), clean)
    if "shadow" in batch and "shadow_logits" in batch:
        shadow, seen = batch["shadow"], torch.sigmoid(batch["shadow_logits"].detach())
        batch["shadow"] = torch.where(shadow.isnan(), seen, shadow)
    return batch


def learning_rate_factor(step: int, warmup: int, steps: int) -> float:
    """Share of the full learning rate at a step: linear warm-up, then a cosine to zero."""
    if step < warmup:
        return (step + 1) / (warmup + 1)
    done = (step - warmup) / max(1, steps - warmup)
    return 0.5 * (1 + math.cos(math.pi * min(1.0, done)))


def running_average(decay: float) -> Callable[..., None]:
    """Exponential average of parameters; short at first, when weights change fast."""

    @torch.no_grad()
    def update(average: list[Tensor], current: list[Tensor], count: Tensor | int) -> None:
        keep = min(decay, (1 + int(count)) / (10 + int(count)))
        torch._foreach_lerp_(average, current, 1 - keep)

    return update
