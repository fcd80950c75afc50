"""Denoisers: networks, losses, training on the factory's pairs, and denoising of any image.

A network is one file with a settings class and a torch module, and one line in `NETWORKS`.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import TYPE_CHECKING, Any

from factory.errors import FactoryError
from factory.settings import build

if TYPE_CHECKING:
    from torch import nn

NETWORKS = {
    "nafnet": ("models.nafnet", "NAFNetSettings", "NAFNet"),
}
"""kind -> module, settings class, network class; torch is imported only when one is built."""


def build_network(config: Mapping[str, Any]) -> nn.Module:
    """The network that the `model` group of the configuration describes, with fresh weights.

    It maps (N, 1, H, W) float32 in 0..1 to the same shape, for any H and W.  Raises FactoryError
    for an unknown kind or key.
    """
    kind = config.get("kind")
    if kind not in NETWORKS:
        raise FactoryError(f"model.kind: {kind!r} is none of {', '.join(sorted(NETWORKS))}")
    module_name, settings_name, network_name = NETWORKS[kind]
    module = import_module(module_name)
    settings: Any = build(getattr(module, settings_name), config, "model")
    network: nn.Module = getattr(module, network_name)(settings)
    return network
