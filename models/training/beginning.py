"""The network as a training begins, and the module that trains it."""

from __future__ import annotations

from collections.abc import Mapping

from torch import Tensor

from ...factory.errors import FactoryError
from ..losses import build_loss
from ..networks import build_network
from ..networks.lines import LineContext
from ..networks.network import Network, ResidualBlock
from ..networks.weights import load_weights
from ..pretrained import find_weights
from ..settings import ModelsSettings
from .module import DenoisingModule, Teacher

_GROWN = (ResidualBlock, LineContext)
"""Parts that a network can be grown by: they begin as the identity."""


def build_module(settings: ModelsSettings) -> DenoisingModule:
    """The network as training begins, and the way to train it.

    Raises FactoryError where the network and `start`, `data` or `train.teacher` do not fit.
    """
    network: Network = build_network(settings.model)
    if settings.start is not None:
        _load_start(network, settings)
    loss = build_loss(settings.loss)
    teacher = _teacher(network, settings)
    if network.adversarial:
        from .adversarial import GradientPenaltyModule, SIDTGANModule

        penalised = settings.model["kind"] == "dgp_srgan"
        module = GradientPenaltyModule if penalised else SIDTGANModule
        if settings.train.precision == "16-mixed":
            raise FactoryError(
                "train.precision=16-mixed: adversarial training needs 32-true or bf16-mixed"
            )
        return module(network, loss, settings.train, settings.seed)
    return DenoisingModule(network, loss, settings.train, settings.seed, teacher)


def _teacher(network: Network, settings: ModelsSettings) -> Teacher | None:
    """The network to learn from, if any; FactoryError where there is nothing to compare with it."""
    if settings.train.teacher is None:
        return None
    if network.adversarial or network.has_stages:
        raise FactoryError(
            f"train.teacher={settings.train.teacher}: a network with a critic or with stages does "
            "not learn from a teacher; leave it out"
        )
    teacher = Teacher(find_weights(settings.train.teacher), settings.train.teacher_share)
    if teacher.network.channels != network.channels:
        raise FactoryError(
            f"train.teacher={settings.train.teacher}: is for images of "
            f"{teacher.network.channels} channels, model for {network.channels}"
        )
    return teacher


def _load_start(network: Network, settings: ModelsSettings) -> None:
    assert settings.start is not None
    trained = load_weights(find_weights(settings.start))
    if trained.model["kind"] == settings.model["kind"]:
        state = trained.network.state_dict()
        fresh = _fresh_parts(network, state)
        try:
            network.load_state_dict({**fresh, **state})
            return
        except RuntimeError:
            pass  # other sizes; torch's message lists hundreds of tensors
    raise FactoryError(
        f"start={settings.start}: holds {dict(trained.model)}, and model says "
        f"{dict(settings.model)}; give both the same sizes"
    )


def _fresh_parts(network: Network, state: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Weights of the residual blocks and of the lines that `state` lacks.

    They begin as the identity, because their last layer is all zeros.
    """
    parts = (name for name, one in network.named_modules() if isinstance(one, _GROWN))
    fresh = tuple(
        f"{name}." for name in parts if not any(key.startswith(f"{name}.") for key in state)
    )
    return {key: value for key, value in network.state_dict().items() if key.startswith(fresh)}
