"""Training against a critic whose slope is held at 1 (Gulrajani et al. 2017).

The critic learns to value clean pictures above denoised ones by as much as it can, the penalty
keeps it from doing so by large numbers alone, and the network learns to be valued.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import torch
from torch import Tensor, nn

from ...factory.seeds import stream
from ..networks.dgp_srgan import DGPSRGAN, Critic
from ..networks.network import Network
from .adversarial import AdversarialModule


class GradientPenaltyModule(AdversarialModule):
    """A generator and its critic, in turns of one step each."""

    # No momentum, as the authors of the penalty advise.
    betas: ClassVar[tuple[float, float]] = (0.0, 0.9)

    def opponent(self, network: Network) -> nn.Module:
        """See `AdversarialModule`."""
        assert isinstance(network, DGPSRGAN)
        self.term_weights = network.settings
        return Critic(network.settings)

    def critic_loss(self, noisy: Tensor, clean: Tensor, denoised: Tensor) -> Tensor:
        """See `AdversarialModule`."""
        difference = self.discriminator(denoised).mean() - self.discriminator(clean).mean()
        # Slopes of slopes are too fine for half precision.
        with torch.autocast(clean.device.type, enabled=False):
            # The random numbers belong to the step, so that a resumed training draws the same.
            drawn = stream(self.seed, "penalty", self.turn).random(
                (len(clean), 1, 1, 1), np.float32
            )
            share = torch.from_numpy(drawn).to(clean.device)
            slope = penalty(self.discriminator, clean.float().lerp(denoised.float(), share))
        total: Tensor = difference + self.term_weights.penalty * slope
        return total

    def generator_loss(
        self, content: Tensor, noisy: Tensor, clean: Tensor, denoised: Tensor
    ) -> Tensor:
        """See `AdversarialModule`."""
        judged: Tensor = self.discriminator(denoised).mean()
        return content - self.term_weights.adversarial * judged


def penalty(critic: nn.Module, images: Tensor) -> Tensor:
    """Scalar: mean of (length of the slope - 1)^2 at these images, (N, 1, H, W)."""
    images = images.detach().requires_grad_(True)
    (slope,) = torch.autograd.grad(critic(images).sum(), images, create_graph=True)
    # Off zero, where a length has no slope.
    length = (slope.square().sum(dim=(1, 2, 3)) + 1e-12).sqrt()
    return (length - 1).square().mean()
