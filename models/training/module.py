"""A network in training: the running average of its weights, a step, and a validation."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import ClassVar

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.optim import Optimizer
from torch.optim.swa_utils import AveragedModel

from ...factory.errors import FactoryError
from ..data.pairs import Batch
from ..losses import Loss
from ..networks.network import Network, known_extras
from ..networks.weights import channels_last, load_weights
from ..settings import TrainSettings

Row = dict[str, float | int]
_SIGMA, _RADIUS = 1.5, 5  # of the window of SSIM, pixels


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


def psnr_db(image: Tensor, clean: Tensor) -> Tensor:
    """(N,) peak signal-to-noise ratio in dB of (N, 1, H, W) images in 0..1, at most 100 dB."""
    error = (image - clean).square().mean(dim=(1, 2, 3))
    return -10 * torch.log10(error.clamp_min(1e-10))


def ssim(image: Tensor, clean: Tensor) -> Tensor:
    """(N,) mean structural similarity of (N, 1, H, W) images in 0..1, at least 11x11.

    Gaussian window of sigma 1.5, population covariance, border of 5 pixels left out (Wang et al.
    2004); float64, because the variances are small differences of large numbers.
    """
    a, b = image.double(), clean.double()
    offset = torch.arange(-_RADIUS, _RADIUS + 1, dtype=a.dtype, device=a.device)
    window = torch.exp(-offset.square() / (2 * _SIGMA**2))
    window = window / window.sum()

    def mean(x: Tensor) -> Tensor:
        rows = functional.conv2d(x, window.view(1, 1, -1, 1))
        return functional.conv2d(rows, window.view(1, 1, 1, -1))

    mu_a, mu_b = mean(a), mean(b)
    var_a = mean(a * a) - mu_a.square()
    var_b = mean(b * b) - mu_b.square()
    covariance = mean(a * b) - mu_a * mu_b
    c1, c2 = 0.01**2, 0.03**2
    similarity = (2 * mu_a * mu_b + c1) * (2 * covariance + c2)
    similarity = similarity / ((mu_a.square() + mu_b.square() + c1) * (var_a + var_b + c2))
    return similarity.mean(dim=(1, 2, 3))


def shadow_iou(image: Tensor, batch: dict[str, Tensor], threshold: float = 0.02) -> Tensor:
    """(N,) overlap of the true shadow with what is at or below `threshold`, inside the sector.

    1 where there is no shadow at all.  batch: `noisy`, `clean` and `shadow`, (N, 1, H, W).
    """
    truth = batch["shadow"] > 0.5
    sector = truth | (batch["clean"] > 0) | (batch["noisy"] > 0)
    dark = (image <= threshold) & sector
    both = (truth & dark).sum(dim=(1, 2, 3)).float()
    either = (truth | dark).sum(dim=(1, 2, 3)).float()
    return torch.where(either > 0, both / either.clamp_min(1), torch.ones_like(both))


def denoised(network: nn.Module, batch: Batch) -> npt.NDArray[np.float32]:
    """(H, W) float32 in 0..1: the image of a batch of one, denoised and clipped."""
    assert isinstance(network, Network)
    device = next(network.parameters()).device
    known = {name: one.to(device) for name, one in known_extras(network, batch).items()}
    with torch.inference_mode():
        image = network(batch["noisy"].to(device), **known)
    return np.asarray(image[0, 0].float().clamp(0, 1).cpu().numpy(), np.float32)
