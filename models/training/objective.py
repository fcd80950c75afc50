"""The loss that a training lowers, for every kind of network.

Against a critic the network and the critic learn in turns; the terms stand beside the networks
(`simnfnd.models.networks.rivals`).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from ..data.pairs import Batch
from ..networks.network import Network, known_extras
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


def training_loss(
    network: Network,
    batch: Batch,
    loss: Loss,
    opponent: Opponent | None = None,
) -> Tensor:
    """The loss of a batch by whatever the network is trained with."""
    if opponent is None:
        return restoration_loss(network, batch, loss)
    assert isinstance(network, AdversarialNetwork)
    denoised = network(batch["noisy"])
    clean = completed(batch, denoised)["clean"]
    return opponent.adversarial_loss(network, batch, clean, denoised, loss)


def restoration_loss(network: Network, batch: Batch, loss: Loss) -> Tensor:
    """The loss of a batch; a network that knows interference along bearings takes it off first."""
    noisy, nodes = network.without_interference(batch["noisy"], known_extras(network, batch))
    batch = {**batch, "noisy": noisy}
    if nodes is not None:
        batch["interference_nodes"] = nodes
    prediction, heads = _predicted(network, batch)
    batch = completed(batch | heads, prediction)
    return loss(prediction, batch["clean"], batch)


def completed(batch: Batch, prediction: Tensor) -> Batch:
    """The batch with a target everywhere: where none is known (NaN) the prediction, at no cost."""
    clean = batch["clean"]
    batch = {**batch, "clean": torch.where(clean.isnan(), prediction.detach(), clean)}
    if "shadow_logits" in batch:
        shadow = batch["shadow"]
        predicted = torch.sigmoid(batch["shadow_logits"].detach())
        batch["shadow"] = torch.where(shadow.isnan(), predicted, shadow)
    return batch


def _predicted(network: Network, batch: Batch) -> tuple[Tensor, Batch]:
    """The image with its whole change, and the heads' output for the loss."""
    extras = known_extras(network, batch)
    if not network.has_heads:
        return network(batch["noisy"], **extras), {}
    image, logits, weight = network.with_heads(batch["noisy"], **extras)
    return image, {"shadow_logits": logits, "weight": weight}
