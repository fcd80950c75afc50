"""The loss that a training lowers, for every kind of network."""

from __future__ import annotations

import torch
from torch import Tensor

from ..data.pairs import Batch
from ..networks.network import Network, known_extras
from ..networks.rivals.adversary import AdversarialNetwork
from .adversarial import Opponent
from .losses import Loss


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
