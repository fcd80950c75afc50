"""Training against a discriminator, for the networks after SID-TGAN and DGP-SRGAN.

In turns, the discriminator learns to tell denoised from clean images, and the network to denoise so
that it cannot; the terms stand beside the networks (`simnfnd.models.networks.literature`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor, nn
from torch.optim import Optimizer

from ...factory.seeds import stream
from ..data.pairs import Batch
from ..losses import Loss
from ..networks.network import Network
from ..settings import TrainSettings
from .module import DenoisingModule


class AdversarialModule(DenoisingModule):
    """A generator and its discriminator; what is averaged, measured and saved is the generator."""

    def __init__(
        self, network: Network, loss: Loss, settings: TrainSettings, seed: int = 0
    ) -> None:
        super().__init__(network, loss, settings, seed)
        terms: Any = network
        self.discriminator: nn.Module = terms.opponent()

    @property
    def terms(self) -> Any:
        """The network, which knows its opponent, its losses and `betas`."""
        return self.network

    def make_optimizers(self) -> list[Optimizer]:
        """One AdamW each, of the network and of the discriminator."""
        return [
            torch.optim.AdamW(
                module.parameters(),
                lr=self.settings.learning_rate,
                betas=self.terms.betas,
                weight_decay=self.settings.weight_decay,
            )
            for module in (self.network, self.discriminator)
        ]

    def update(self, optimizers: Sequence[Optimizer], batch: Batch) -> Tensor:
        """One turn of the discriminator, then one of the generator, whose loss is returned."""
        generator, critic = optimizers
        self.set_learning_rate(optimizers)
        noisy, clean = (_planes(batch[name]) for name in ("noisy", "clean"))
        # The random numbers belong to the step, so that a resumed training draws the same.
        rng = stream(self.seed, "penalty", self.step)
        with self.autocast():
            prediction = self.network(batch["noisy"])
            denoised = _planes(prediction)

            self.discriminator.requires_grad_(True)
            told = self.discriminator, noisy, clean
            self.turn(critic, self.terms.critic_loss(*told, denoised.detach(), rng))

            self.discriminator.requires_grad_(False)
            content = self.loss(prediction, batch["clean"], batch)
            total: Tensor = self.terms.generator_loss(content, *told, denoised)
            self.turn(generator, total)
        self.average.update_parameters(self.network)
        return total


def _planes(images: Tensor) -> Tensor:
    """Each channel as an image of its own, (N, C, H, W) -> (N C, 1, H, W)."""
    return images.reshape(-1, 1, *images.shape[-2:])
