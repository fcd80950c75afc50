"""The Lightning module: a network, the running average of its weights, and a training step."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar

import torch
from lightning.pytorch import LightningModule
from torch import Tensor
from torch.optim.swa_utils import AveragedModel

from ...factory.errors import FactoryError
from ...factory.seeds import stream
from ..data.pairs import Batch
from ..losses.base import Loss
from ..networks.network import Network, known_extras
from ..networks.weights import channels_last
from ..settings import TrainSettings
from .quality import psnr_db, shadow_iou, ssim
from .teacher import Teacher

Row = dict[str, float | int]


class DenoisingModule(LightningModule):
    """A network, the running average of its weights, and how a step is made.

    The average is what is validated and saved.

    figures: what a validation measures, in the order of metrics.csv.
    """

    figures: ClassVar[tuple[str, ...]] = (
        *("psnr_noisy", "psnr", "ssim_noisy", "ssim"),
        *("shadow_iou_noisy", "shadow_iou"),
    )

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
        self.average = AveragedModel(self.network, multi_avg_fn=_running_average(settings.ema))
        self.average.requires_grad_(False)
        self.loss, self.settings, self.seed = loss, settings, seed
        # No module of torch's own: its weights are neither saved nor averaged.
        self.teacher = teacher

    @staticmethod
    def score(row: Mapping[str, float | int]) -> float:
        """The figure of a row of metrics that decides which weights are kept; larger is better."""
        return row["psnr"]

    @property
    def step(self) -> int:
        """Steps of all intervals before the present one."""
        return self.current_epoch * self.settings.check_every

    def on_train_epoch_start(self) -> None:
        """Restart torch's random numbers, so that a resumed training draws the same."""
        draw = stream(self.seed, "torch", self.current_epoch).integers(2**62)
        torch.manual_seed(int(draw))

    def training_step(self, batch: Batch, index: int) -> Tensor:
        """The loss of one batch of crops; FactoryError when it is not a number."""
        return self.require_finite(self.compute_loss(batch, index), index)

    def compute_loss(self, batch: Batch, index: int) -> Tensor:
        """The loss of one batch.  index: of the step in its interval."""
        extras = known_extras(self.network, batch)
        batch = {**batch, "progress": torch.tensor((self.step + index) / self.settings.steps)}
        if self.network.has_stages:
            stages = self.network.with_stages(batch["noisy"], **extras)
            losses = [self.loss(image, batch["clean"], batch) for image in stages]
            return torch.stack(losses).mean()
        if self.network.has_heads:
            output = self.network.with_heads(batch["noisy"], **extras)
            prediction = output.image
            batch |= {"shadow_logits": output.shadow_logits, "weight": output.weight}
        else:
            prediction = self.network(batch["noisy"], **extras)
        if self.teacher is not None:
            return self.teacher.loss(self.loss, prediction, batch)
        return self.loss(prediction, batch["clean"], batch)

    def require_finite(self, loss: Tensor, index: int) -> Tensor:
        """The loss itself; FactoryError when it is not a number."""
        if not torch.isfinite(loss):
            raise FactoryError(
                f"the loss became {loss.item()} at step {self.step + index}; lower "
                "train.learning_rate, or check the dataset for odd values"
            )
        return loss

    def on_train_batch_end(self, outputs: Any, batch: Any, batch_idx: int) -> None:
        """Update the running average."""
        self.average.update_parameters(self.network)

    def validation_step(self, batch: Batch, index: int) -> None:
        """Quality of a whole validation image before and after denoising."""
        noisy, clean = batch["noisy"], batch["clean"]
        denoised = self.average(noisy, **known_extras(self.network, batch)).float().clamp(0, 1)
        self.log_means(
            {
                "psnr_noisy": psnr_db(noisy, clean),
                "psnr": psnr_db(denoised, clean),
                "ssim_noisy": ssim(noisy, clean),
                "ssim": ssim(denoised, clean),
                "shadow_iou_noisy": shadow_iou(noisy, batch),
                "shadow_iou": shadow_iou(denoised, batch),
            },
            len(noisy),
        )

    def log_means(self, values: Mapping[str, Tensor], count: int) -> None:
        """Add the figures of a validation batch of `count` images to the interval's means."""
        self.log_dict(
            {name: value.mean() for name, value in values.items()},
            on_epoch=True,
            batch_size=count,
            sync_dist=True,
        )

    def configure_optimizers(self) -> Any:
        """AdamW with a linear warm-up and a cosine decay to zero, counted in steps."""
        chosen = self.settings
        optimizer = torch.optim.AdamW(
            [weights for weights in self.network.parameters() if weights.requires_grad],
            lr=chosen.learning_rate,
            betas=(0.9, 0.99),
            weight_decay=chosen.weight_decay,
        )
        rate = torch.optim.lr_scheduler.LambdaLR(
            optimizer, lambda step: learning_rate_factor(step, chosen.warmup, chosen.steps)
        )
        return {"optimizer": optimizer, "lr_scheduler": {"scheduler": rate, "interval": "step"}}


def learning_rate_factor(step: int, warmup: int, steps: int) -> float:
    """Share of the full learning rate at a step: linear warm-up, then a cosine to zero."""
    if step < warmup:
        return (step + 1) / (warmup + 1)
    done = (step - warmup) / max(1, steps - warmup)
    return 0.5 * (1 + math.cos(math.pi * min(1.0, done)))


def _running_average(decay: float) -> Any:
    """Exponential average of parameters; short at first, when weights change fast."""

    @torch.no_grad()
    def update(average: list[Tensor], current: list[Tensor], count: Tensor | int) -> None:
        keep = min(decay, (1 + int(count)) / (10 + int(count)))
        torch._foreach_lerp_(average, current, 1 - keep)

    return update
