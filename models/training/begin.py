"""What a training begins with: the network and its weights, and the way to train it."""

from __future__ import annotations

from collections.abc import Sequence

from simnfnd.factory.errors import FactoryError
from simnfnd.models.losses import build_loss
from simnfnd.models.networks import build_network
from simnfnd.models.networks.network import Network
from simnfnd.models.networks.weights import load_weights
from simnfnd.models.pretrained import find_weights
from simnfnd.models.settings import ModelsSettings, SelfSupervisedData
from simnfnd.models.training.module import DenoisingModule
from simnfnd.models.training.self_supervised import SelfSupervisedModule


def first_module(settings: ModelsSettings) -> DenoisingModule:
    """The network as training begins, and the way to train it.

    Raises FactoryError for weights that do not fit, and a network and data that do not go together.
    """
    network: Network = build_network(settings.model)
    if settings.start is not None:
        _load_start(network, settings)
    if settings.train.parts is not None:
        _freeze_all_but(network, settings.train.parts)
    loss = build_loss(settings.loss)
    if isinstance(settings.data, SelfSupervisedData):
        if network.adversarial:
            raise FactoryError(
                f"model.kind={settings.model['kind']}: is trained against clean images; "
                "data=self_supervised has none"
            )
        if settings.data.method == "blind_network" and not network.is_blind:
            raise FactoryError(
                f"data.method=blind_network: model.kind={settings.model['kind']} sees the pixels "
                "that it predicts; take model=ap_bsn or data.method=blind_spot"
            )
        return SelfSupervisedModule(network, loss, settings.train, settings.seed, settings.data)
    if network.adversarial:
        from simnfnd.models.training.adversarial import SIDTGANModule
        from simnfnd.models.training.gradient_penalty import GradientPenaltyModule

        penalised = settings.model["kind"] == "dgp_srgan"
        module = GradientPenaltyModule if penalised else SIDTGANModule
        return module(network, loss, settings.train, settings.seed)
    return DenoisingModule(network, loss, settings.train, settings.seed)


def _load_start(network: Network, settings: ModelsSettings) -> None:
    assert settings.start is not None
    trained = load_weights(find_weights(settings.start))
    if trained.model["kind"] == settings.model["kind"]:
        try:
            network.load_state_dict(trained.network.state_dict())
            return
        except RuntimeError:
            pass  # other sizes; torch's message lists hundreds of tensors
    raise FactoryError(
        f"start={settings.start}: holds {dict(trained.model)}, and model says "
        f"{dict(settings.model)}; give both the same sizes"
    )


def _freeze_all_but(network: Network, parts: Sequence[str]) -> None:
    known = [name for name, _ in network.named_modules() if name]
    for part in parts:
        if part not in known:
            raise FactoryError(
                f"train.parts: the network has no {part!r}; its parts are "
                f"{', '.join(name for name in known if '.' not in name)}"
            )
    for name, weights in network.named_parameters():
        weights.requires_grad_(any(name.startswith(f"{part}.") for part in parts))
