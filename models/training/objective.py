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
    *,
    teacher: Network | None = None,
    opponent: Opponent | None = None,
) -> Tensor:
    """The loss of a batch by whatever the network is trained with."""
    if opponent is None:
        return taught_loss(network, batch, loss, teacher)
    assert isinstance(network, AdversarialNetwork)
    denoised = network(batch["noisy"])
    clean = completed(batch, denoised, None)["clean"]
    return opponent.adversarial_loss(network, batch, clean, denoised, loss)


def taught_loss(
    network: Network, batch: Batch, loss: Loss, teacher: Network | None = None
) -> Tensor:
    """The loss of a batch; parts of its targets are what a teacher makes of it.

    What trained weights denoise is the target (Hinton et al. 2015, here for images): what a small
    network cannot do shows as noise in the gradients when it learns from clean images alone; the
    images of a larger one are nearer to what it can do.
    """
    noisy, nodes = network.without_interference(batch["noisy"], known_extras(network, batch))
    batch = {**batch, "noisy": noisy}
    if nodes is not None:
        batch["interference_nodes"] = nodes
    prediction, heads = _predicted(network, batch)
    batch = completed(batch | heads, prediction, teacher)
    return loss(prediction, batch["clean"], batch)


def completed(batch: Batch, prediction: Tensor, teacher: Network | None) -> Batch:
    """The batch with a target everywhere: `taught` of it is the teacher's image.

    Where nothing is known (NaN) the target is the prediction, which then costs nothing.
    """
    clean = batch["clean"]
    batch = dict(batch)
    if teacher is not None:
        with torch.no_grad():
            image = _predicted(teacher.to(clean.device), batch)[0].to(clean.dtype)
        mixed = torch.where(clean.isnan(), image, torch.lerp(clean, image, batch["taught"]))
        clean = torch.where(batch["taught"] > 0, mixed, clean)
    batch["clean"] = torch.where(clean.isnan(), prediction.detach(), clean)
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
