"""What networks that are trained against a critic have in common."""

from __future__ import annotations

from typing import ClassVar

from torch import Tensor, nn

from ..network import Network


class AdversarialNetwork(Network):
    """A network whose training needs a critic, which is thrown away afterwards.

    Images are (N, 1, H, W).
    """

    critic_betas: ClassVar[tuple[float, float]] = (0.5, 0.99)
    """Of the critic's AdamW: a short memory, because its opponent moves (Radford et al. 2016)."""

    def build_critic(self) -> nn.Module:
        """The critic of this network, with fresh weights."""
        raise NotImplementedError

    def critic_loss(
        self, critic: nn.Module, noisy: Tensor, clean: Tensor, denoised: Tensor
    ) -> Tensor:
        """What the critic learns by, a scalar; `denoised` has no gradient."""
        raise NotImplementedError

    def generator_loss(
        self, content: Tensor, critic: nn.Module, noisy: Tensor, clean: Tensor, denoised: Tensor
    ) -> Tensor:
        """What the network learns by, a scalar.  content: the `loss` group."""
        raise NotImplementedError
