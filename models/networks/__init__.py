"""Defines the networks, one file each, in one registry, and the contract that all keep.

A network is one file beside this one with a settings class and a torch module, and one line in
`NETWORKS`.  What training, denoising and the losses rely on:

- `build_network(config)` makes it from the `model` group, with fresh weights.
- `forward(x)` maps (N, 1, H, W) float in 0..1 to the same shape, for any H and W (it pads itself).
- `extras`, an attribute, names its optional inputs; each is a keyword of `forward` and of
  `with_heads` that may be left out where it is unknown: `range_fraction` (N, 1, H, W),
  slant range of a pixel over range_max; `azimuth_rad` (N, 1, H, W), positive to the right; `sector`
  (N, 1, H, W), 1 inside the insonified sector and 0 outside; `remove` (N, 6), 1 for each artefact
  to remove (`vector`); `bearings` (n, 2, RANGES, BEARINGS), whole bearings of the images that n
  equal parts of the N show, and `bearing_sector` (N, 4), see `bearing_view`.  Batches hold them
  under these names.
- A network with `has_heads = True` predicts more: where `forward` returns the image alone,
  `with_heads(x, ...)` returns (image, shadow_logits, weight): logits (N, 1, H, W) of shadow, and
  (N,) the part of its change, 0 to 1, that `forward` gives each image.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ...factory.common import extensions
from ...factory.common.array_types import Float32s
from ...factory.common.errors import FactoryError
from ...factory.simulation.imaging.artefacts import ARTEFACTS

if TYPE_CHECKING:
    from .network import Network

NETWORKS = {"nafnet": "NAFNet", "restormer": "Restormer", "sonarnet": "SonarNet"}
"""kind, which is a module here -> its network, beside which lie `<network>Settings`; torch is
imported only when one is built."""
RIVALS = {"sid_tgan": "SIDTGAN"}
"""The same of the modules in `rivals`."""

GEOMETRY = ("range_fraction", "azimuth_rad", "sector")
"""Inputs that say where a pixel lies."""
BEARING_INPUTS = ("bearings", "bearing_sector")
"""Inputs of whole bearings; see `bearing_view`."""
DEFAULT: tuple[str, ...] = ("speckle", "spokes", "ghosts", "blur")
"""The ones of `ARTEFACTS` that networks remove: ground and brightness of an image stay."""
_MOST_FRAMES = 16.0  # more are too few to tell from this many by the noise that is left
_INDEPENDENT = 0.36
"""Power of the number of frames that says how many of independent noise they are worth: the noise
of frames that follow each other is correlated.  Seven frames of two DIDSON recordings and of five
of the MDD groups came out best as two independent ones."""

_GONE: dict[str, object] = {"channels": 1, "mirror": False, "even_level": False}
"""Keys of weights of earlier versions, with the value that is left."""


def build_network(config: Mapping[str, Any]) -> Network:
    """The network that the `model` group of the configuration describes, with fresh weights.

    Raises FactoryError for an unknown kind or key.
    """
    from ...factory.common.settings import (
        build,  # loads pydantic, which graphs that ship do without
    )

    kind = config.get("kind")
    known = {**NETWORKS, **RIVALS}
    if isinstance(kind, str) and kind in extensions.names("network"):
        values = {key: value for key, value in config.items() if key != "kind"}
        own = own_network(kind)
        built: Network = own(build(own.settings, values, "model"))
        return built
    if not isinstance(kind, str) or kind not in known:
        raise FactoryError(f"model.kind: {kind!r} is none of {', '.join(known)}")
    config = {key: value for key, value in config.items() if (key, value) not in _GONE.items()}
    name = known[kind]
    folder = ".rivals" if kind in RIVALS else ""
    module = import_module(f"{folder}.{kind}", __name__)
    settings: Any = build(getattr(module, f"{name}Settings"), config, "model")
    network: Network = getattr(module, name)(settings)
    return network


def own_network(kind: str) -> Any:
    """The network of another package or of the user's code: a `Network` with its `settings`.

    Raises FactoryError where it cannot be loaded, or lacks them.
    """
    from .network import Network

    extension = extensions.find("network", kind)
    network = None if extension is None else extension.value
    is_network = isinstance(network, type) and issubclass(network, Network)
    if not is_network or not hasattr(network, "settings"):
        raise FactoryError(
            f"network {kind}: is no class of `Network` with its settings class as `settings`"
        )
    return network


def default_values(kind: str) -> dict[str, Any]:
    """Keys of `model` of an own network, with their defaults."""
    from pydantic import TypeAdapter

    settings = own_network(kind).settings
    return {"kind": kind, **TypeAdapter(settings).dump_python(settings(), mode="json")}


def vector(removed: Collection[str]) -> Float32s:
    """(6,) float32 by the order of `ARTEFACTS`: 1 to remove one, 0 to keep it."""
    return np.array([name in removed for name in ARTEFACTS], np.float32)


def averaged(frames: npt.ArrayLike) -> Float32s:
    """log2 of how many independent frames are worth so many that were averaged, 1 or more."""
    counted = np.clip(np.asarray(frames, np.float32), 1, _MOST_FRAMES)
    return np.asarray(_INDEPENDENT * np.log2(counted), np.float32)
