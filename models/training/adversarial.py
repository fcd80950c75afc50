"""Training against a discriminator.

In turns, the discriminator learns to tell denoised from clean images, and the network to denoise so
that it cannot.  `AdversarialModule` makes the turns; what both learn by is that of SID-TGAN here,
and that of DGP-SRGAN in `simnfnd.models.training.gradient_penalty`.
"""

from __future__ import annotations

from typing import Any, ClassVar, cast

import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.optim import Optimizer

from ...factory.errors import FactoryError
from ..data.pairs import Batch
from ..losses.base import Loss
from ..networks.network import Network
from ..networks.sid_tgan import SIDTGAN, Discriminator
from ..settings import TrainSettings
from .module import DenoisingModule, learning_rate_factor


class AdversarialModule(DenoisingModule):
    """A generator and its discriminator; what is averaged, measured and saved is the generator.

    Lightning leaves the order of the updates to this module, so it also clips the gradients and
    moves the learning rates.

    betas: of both optimizers; by default a short memory, because the opponent moves (Radford et al.
    2016).  turn: number of the present step.
    """

    betas: ClassVar[tuple[float, float]] = (0.5, 0.99)

    def __init__(
        self, network: Network, loss: Loss, settings: TrainSettings, seed: int = 0
    ) -> None:
        super().__init__(network, loss, settings, seed)
        self.automatic_optimization = False
        self.turn = 0
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

    def on_fit_start(self) -> None:
        """Raises FactoryError where the two turns of a step cannot be kept apart."""
        if self.trainer.world_size > 1:
            raise FactoryError("devices: adversarial training runs on one device; use devices=1")
        if self.settings.precision == "16-mixed":
            raise FactoryError(
                "train.precision=16-mixed: adversarial training needs 32-true or bf16-mixed"
            )

    def configure_optimizers(self) -> Any:
        """One AdamW each, with the learning rates of `DenoisingModule`."""
        chosen = self.settings
        optimizers, rates = [], []
        for module in (self.network, self.discriminator):
            optimizer = torch.optim.AdamW(
                module.parameters(),
                lr=chosen.learning_rate,
                betas=self.betas,
                weight_decay=chosen.weight_decay,
            )
            optimizers.append(optimizer)
            rates.append(
                torch.optim.lr_scheduler.LambdaLR(
                    optimizer, lambda step: learning_rate_factor(step, chosen.warmup, chosen.steps)
                )
            )
        return optimizers, rates

    def training_step(self, batch: Batch, index: int) -> Tensor:
        """One turn of the discriminator, then one of the generator, whose loss is returned.

        Raises FactoryError when a loss is not a number.
        """
        generator, critic = cast(list[Any], self.optimizers())
        self.turn = self.step + index
        noisy, clean = (_planes(batch[name]) for name in ("noisy", "clean"))
        prediction = self.network(batch["noisy"])
        denoised = _planes(prediction)

        self.discriminator.requires_grad_(True)
        critic_loss = self.critic_loss(noisy, clean, denoised.detach())
        critic_loss = self.require_finite(critic_loss, index)
        # The bare optimizer: Lightning counts the steps of wrapped ones, and one count is enough.
        self._update(critic.optimizer, self.discriminator, critic_loss)

        self.discriminator.requires_grad_(False)
        content = self.loss(prediction, batch["clean"], batch)
        total = self.generator_loss(content, noisy, clean, denoised)
        total = self.require_finite(total, index)
        self._update(generator, self.network, total)
        for rate in cast(list[Any], self.lr_schedulers()):
            rate.step()
        return total.detach()

    def _update(self, optimizer: Optimizer, module: torch.nn.Module, loss: Tensor) -> None:
        optimizer.zero_grad()
        self.manual_backward(loss)
        torch.nn.utils.clip_grad_norm_(module.parameters(), self.settings.clip)
        optimizer.step()


class SIDTGANModule(AdversarialModule):
    """The terms that the abstract of SID-TGAN names (see `simnfnd.models.networks.sid_tgan`)."""

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


def _planes(images: Tensor) -> Tensor:
    """Each channel as an image of its own, (N, C, H, W) -> (N C, 1, H, W)."""
    return images.reshape(-1, 1, *images.shape[-2:])
