"""Training against a discriminator, for the networks after SID-TGAN and DGP-SRGAN.

In turns, the discriminator learns to tell denoised from clean images, and the network to denoise so
that it cannot.  The terms are those that two abstracts name; not reproduced
(`simnfnd.models.networks.literature`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np
import torch
from lightning.fabric import Fabric
from torch import Tensor, nn
from torch.nn import functional
from torch.optim import Optimizer

from ...factory.seeds import stream
from ..data.pairs import Batch
from ..losses import Loss
from ..networks.literature.dgp_srgan import DGPSRGAN, Critic
from ..networks.literature.sid_tgan import SIDTGAN, Discriminator
from ..networks.network import Network
from ..settings import TrainSettings
from .module import DenoisingModule


class AdversarialModule(DenoisingModule):
    """A generator and its discriminator; what is averaged, measured and saved is the generator.

    BETAS: of both optimizers; by default a short memory, because the opponent moves (Radford et al.
    2016).
    """

    BETAS: ClassVar[tuple[float, float]] = (0.5, 0.99)

    def __init__(
        self, network: Network, loss: Loss, settings: TrainSettings, seed: int = 0
    ) -> None:
        super().__init__(network, loss, settings, seed)
        self.discriminator = self.opponent(network)

    def opponent(self, network: Network) -> nn.Module:
        """The discriminator of this network, with fresh weights."""
        raise NotImplementedError

    def critic_loss(self, noisy: Tensor, clean: Tensor, denoised: Tensor) -> Tensor:
        """What the discriminator learns by, of images (N, 1, H, W), the last without gradients."""
        raise NotImplementedError

    def generator_loss(
        self, content: Tensor, noisy: Tensor, clean: Tensor, denoised: Tensor
    ) -> Tensor:
        """What the network learns by: the content term and what the discriminator has to say."""
        raise NotImplementedError

    def make_optimizers(self) -> list[Optimizer]:
        """One AdamW each, of the network and of the discriminator."""
        return [
            torch.optim.AdamW(
                module.parameters(),
                lr=self.settings.learning_rate,
                betas=self.BETAS,
                weight_decay=self.settings.weight_decay,
            )
            for module in (self.network, self.discriminator)
        ]

    def update(
        self, fabric: Fabric, wrapped: nn.Module, optimizers: Sequence[Optimizer], batch: Batch
    ) -> Tensor:
        """One turn of the discriminator, then one of the generator, whose loss is returned."""
        generator, critic = optimizers
        self.set_learning_rate(optimizers)
        noisy, clean = (_planes(batch[name]) for name in ("noisy", "clean"))
        with fabric.autocast():
            prediction = self.network(batch["noisy"])
            denoised = _planes(prediction)

            self.discriminator.requires_grad_(True)
            critic_loss = self.critic_loss(noisy, clean, denoised.detach())
            self._turn(critic, self.discriminator, critic_loss)

            self.discriminator.requires_grad_(False)
            content = self.loss(prediction, batch["clean"], batch)
            total = self.generator_loss(content, noisy, clean, denoised)
            self._turn(generator, self.network, total)
        self.average.update_parameters(self.network)
        return total

    def _turn(self, optimizer: Optimizer, module: nn.Module, loss: Tensor) -> None:
        optimizer.zero_grad()
        torch.autograd.backward(self.require_finite(loss))
        torch.nn.utils.clip_grad_norm_(module.parameters(), self.settings.clip)
        optimizer.step()


class SIDTGANModule(AdversarialModule):
    """The terms that the abstract of SID-TGAN names."""

    def opponent(self, network: Network) -> nn.Module:
        """See `AdversarialModule`."""
        assert isinstance(network, SIDTGAN)
        self.term_weights = network.settings
        return Discriminator(network.settings)

    def critic_loss(self, noisy: Tensor, clean: Tensor, denoised: Tensor) -> Tensor:
        """See `AdversarialModule`."""
        true, _, _ = self.discriminator(noisy, clean)
        false, _, _ = self.discriminator(noisy, denoised)
        return hinge(true, false)

    def generator_loss(
        self, content: Tensor, noisy: Tensor, clean: Tensor, denoised: Tensor
    ) -> Tensor:
        """See `AdversarialModule`."""
        judged, local, overall = self.discriminator(noisy, denoised)
        with torch.no_grad():
            _, true_local, true_overall = self.discriminator(noisy, clean)
        weights = self.term_weights
        total: Tensor = (
            content
            + weights.style * style(local, true_local)
            + weights.similarity * dissimilarity(overall, true_overall)
            - weights.adversarial * judged.mean()
        )
        return total


class GradientPenaltyModule(AdversarialModule):
    """A critic whose slope is held at 1 (Gulrajani et al. 2017).

    It learns to value clean pictures above denoised ones by as much as it can, the penalty keeps it
    from doing so by large numbers alone, and the network learns to be valued.
    """

    # No momentum, as the authors of the penalty advise.
    BETAS: ClassVar[tuple[float, float]] = (0.0, 0.9)

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
            drawn = stream(self.seed, "penalty", self.step).random(
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


def hinge(true: Tensor, false: Tensor) -> Tensor:
    """Scalar hinge loss of the judgements (Lim, Ye 2017); 0 beyond +1 for true and -1 for false."""
    return functional.relu(1 - true).mean() + functional.relu(1 + false).mean()


def style(features: list[Tensor], wanted: list[Tensor]) -> Tensor:
    """Scalar: distance of the textures of two images, wherever things lie.

    A texture is the correlation of the (N, C, H, W) features of a layer over the image, their Gram
    matrix (Gatys et al. 2016); mean absolute difference, mean over the layers.
    """
    parts = [(gram(a) - gram(b)).abs().mean() for a, b in zip(features, wanted, strict=True)]
    return torch.stack(parts).mean()


def gram(features: Tensor) -> Tensor:
    """(N, C, C): means over the pixels of the products of features (N, C, H, W)."""
    flat = features.flatten(2)
    return flat @ flat.transpose(1, 2) / flat.shape[-1]


def dissimilarity(features: Tensor, wanted: Tensor) -> Tensor:
    """Scalar: 1 - cosine of the global features (N, C) of two images, mean over the images."""
    return 1 - functional.cosine_similarity(features, wanted, dim=1).mean()


def penalty(critic: nn.Module, images: Tensor) -> Tensor:
    """Scalar: mean of (length of the slope - 1)^2 at these images, (N, 1, H, W)."""
    images = images.detach().requires_grad_(True)
    (slope,) = torch.autograd.grad(critic(images).sum(), images, create_graph=True)
    # Off zero, where a length has no slope.
    length = (slope.square().sum(dim=(1, 2, 3)) + 1e-12).sqrt()
    return (length - 1).square().mean()


def _planes(images: Tensor) -> Tensor:
    """Each channel as an image of its own, (N, C, H, W) -> (N C, 1, H, W)."""
    return images.reshape(-1, 1, *images.shape[-2:])
