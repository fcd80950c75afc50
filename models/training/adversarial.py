"""Training against a critic: in turns, the critic learns to tell denoised images from clean ones.

The terms stand beside the networks (`simnfnd.models.networks.rivals`).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from ..data.pairs import Batch
from ..networks.rivals.adversary import AdversarialNetwork
from .losses import Loss


class Opponent:
    """The critic of a network, with its optimizer."""

    def __init__(
        self, network: AdversarialNetwork, learning_rate: float, device: torch.device
    ) -> None:
        self._critic = network.build_critic().to(device)
        self._optimizer = torch.optim.AdamW(
            self._critic.parameters(), lr=learning_rate, betas=network.critic_betas
        )

    def state_dict(self) -> dict[str, Any]:
        """All that resuming needs."""
        return {"critic": self._critic.state_dict(), "optimizer": self._optimizer.state_dict()}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on where `state` was taken."""
        self._critic.load_state_dict(state["critic"])
        self._optimizer.load_state_dict(state["optimizer"])

    def adversarial_loss(
        self, network: AdversarialNetwork, batch: Batch, clean: Tensor, denoised: Tensor, loss: Loss
    ) -> Tensor:
        """Train the critic by one step, then return the loss of the network, a scalar.

        clean, denoised: (N, 1, H, W); `denoised` with its gradient.
        """
        noisy = batch["noisy"]
        self._critic.requires_grad_(True)
        critic_loss = network.critic_loss(self._critic, noisy, clean, denoised.detach())
        self._optimizer.zero_grad()
        torch.autograd.backward(critic_loss.float())
        self._optimizer.step()

        self._critic.requires_grad_(False)
        content = loss(denoised, clean, batch)
        return network.generator_loss(content, self._critic, noisy, clean, denoised)
