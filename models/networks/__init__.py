"""Networks: one file each, one registry, and the contract that all keep.

A network is one file beside this one with a settings class and a torch module, and one line in
`NETWORKS`.  What training, denoising and the losses rely on:

- `build_network(config)` makes it from the `model` group, with fresh weights.
- `forward(x)` maps (N, 1, H, W) float in 0..1 to the same shape, for any H and W (it pads itself).
- `extras`, an attribute, names its optional inputs; each is a keyword of `forward` and of
  `with_heads` that may be left out where it is unknown: `range_fraction` (N, 1, H, W),
  slant range of a pixel over range_max; `azimuth_rad` (N, 1, H, W), positive to the right; `sector`
  (N, 1, H, W), 1 inside the insonified sector and 0 outside; `remove` (N, 6), 1 for each artefact
  to remove (`models.removal`).  Batches hold them under these names.
- A network with `has_heads = True` predicts more: where `forward` returns the image alone,
  `with_heads(x, ...)` returns (image, shadow_logits, weight): logits (N, 1, H, W) of shadow, and
  (N,) the part of its change, 0 to 1, that `forward` gives each picture.
- A loss is `loss(prediction, clean, batch)`; the batch holds `noisy`, `clean`, `shadow`
  (N, 1, H, W) float, 1 in shadow, where it is known, and `shadow_logits` and `weight` from a
  network with heads.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import TYPE_CHECKING, Any

from ...factory.errors import FactoryError

if TYPE_CHECKING:
    from .network import Network

NETWORKS = {
    "nafnet": ("nafnet", "NAFNet"),
    "restormer": ("restormer", "Restormer"),
    "sonarnet": ("sonarnet", "SonarNet"),
}
"""kind -> module here and its network, beside which lie `<network>Settings`; torch is imported only
when one is built."""


_GONE: dict[str, object] = {"channels": 1, "mirror": False}
"""Keys of weights of earlier versions, with the value that is left."""


def build_network(config: Mapping[str, Any]) -> Network:
    """The network that the `model` group of the configuration describes, with fresh weights.

    Raises FactoryError for an unknown kind or key.
    """
    from ...factory.settings import build  # loads pydantic, which graphs that ship do without

    kind = config.get("kind")
    if not isinstance(kind, str) or kind not in NETWORKS:
        raise FactoryError(f"model.kind: {kind!r} is none of {', '.join(sorted(NETWORKS))}")
    config = {key: one for key, one in config.items() if (key, one) not in _GONE.items()}
    module_name, name = NETWORKS[kind]
    module = import_module(f".{module_name}", __name__)
    settings: Any = build(getattr(module, f"{name}Settings"), config, "model")
    network: Network = getattr(module, name)(settings)
    return network
