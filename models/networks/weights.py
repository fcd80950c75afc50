"""Trained networks on disk: safetensors with the description of the network in its header."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from safetensors import SafetensorError, safe_open

from ...factory.common.array_types import Array, Float32s
from ...factory.common.errors import FactoryError
from ...factory.common.files import write_atomically
from . import build_network

if TYPE_CHECKING:
    from torch import nn

    from .network import Network

FORMAT = "simnfnd-denoiser/1"
_MOST_TENSORS = 10_000
KEY = "simnfnd"
"""One header entry, because safetensors does not keep the order of several."""

Module = TypeVar("Module", bound="nn.Module")
Header = dict[str, Any]
Arrays = dict[str, Array]


@dataclass(frozen=True, eq=False)
class Trained:
    """A network ready to denoise, the `model` configuration and the facts of its training."""

    network: Network
    model: Mapping[str, Any]
    training: Mapping[str, Any]


def channels_last(network: Module) -> Module:
    """The network with the memory layout that halves its time on a CPU."""
    import torch

    for tensor in (*network.parameters(), *network.buffers()):
        if tensor.ndim == 4:
            tensor.data = tensor.data.to(memory_format=torch.channels_last)
    return network


def save_weights(
    path: Path,
    network: nn.Module,
    model: Mapping[str, Any],
    training: Mapping[str, Any],
    *,
    half: bool = False,
) -> None:
    """Write the weights as they are in memory, whole or not at all; same weights, same bytes.

    half: round them to 16 bits, for half of the size.
    """
    from safetensors.torch import save

    tensors = {
        name: (tensor.half() if half and tensor.is_floating_point() else tensor)
        .detach()
        .cpu()
        .contiguous()
        for name, tensor in sorted(network.state_dict().items())
    }
    header = {"format": FORMAT, "model": dict(model), "training": dict(training)}
    write_atomically(path, save(tensors, {KEY: json.dumps(header, sort_keys=True)}))


def load_weights(path: str | Path) -> Trained:
    """Rebuild the network of a weights file, on the CPU, in 32 bits, in evaluation mode.

    Raises FactoryError as `read_weights` does, and when they do not fit the network that the file
    describes.
    """
    import torch

    header, arrays = read_weights(path)
    try:
        network = build_network(header["model"])
        network.load_state_dict({name: torch.from_numpy(array) for name, array in arrays.items()})
    except (FactoryError, RuntimeError, KeyError, AttributeError, TypeError) as error:
        reason = " ".join(str(error).split())[:160]
        raise FactoryError(f"weights={path}: do not fit their network: {reason}") from error
    return Trained(channels_last(network).eval(), header["model"], header.get("training", {}))


def read_weights(path: str | Path) -> tuple[Header, Arrays]:
    """What a weights file says of itself (`model`, `training`), and the weights by their names.

    Floats are in 32 bits.  Nothing in the file is executed.  Raises FactoryError when it is absent,
    not a weights file, of another program, or holds anything but finite floats.
    """
    if not Path(path).is_file():
        raise FactoryError(f"weights={path}: no such file; train one with `simnfnd train`")
    try:
        with safe_open(path, framework="np") as file:
            header = json.loads((file.metadata() or {}).get(KEY, "{}"))
            _check_header(path, header)
            names = list(file.keys())
            if len(names) > _MOST_TENSORS:
                raise FactoryError(
                    f"weights={path}: do not fit their network: {len(names):,} tensors, more than "
                    f"the {_MOST_TENSORS:,} that any network has"
                )
            tensors = {name: file.get_tensor(name) for name in names}
    except (SafetensorError, OSError, RecursionError, ValueError, TypeError) as error:
        raise FactoryError(f"weights={path}: not a safetensors file, or a damaged one") from error
    return header, {name: _checked(path, name, tensor) for name, tensor in tensors.items()}


def _check_header(path: str | Path, header: Any) -> None:
    """FactoryError for a header that does not describe a network of this program."""
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        raise FactoryError(
            f"weights={path}: does not describe its network ({FORMAT}); not made by this program"
        )
    if not isinstance(header.get("model"), dict):
        raise FactoryError(f"weights={path}: do not fit their network: no `model` in the header")
    if not isinstance(header.get("training", {}), dict):
        raise FactoryError(f"weights={path}: `training` in the header is no table of facts")
    wide_grain = header["model"].get("wide_grain", 1.0)
    is_number = isinstance(wide_grain, int | float) and not isinstance(wide_grain, bool)
    if not (is_number and 0 <= wide_grain <= 1):
        raise FactoryError(
            f"weights={path}: do not fit their network: model.wide_grain is {wide_grain!r:.40}, "
            "expected 0 to 1"
        )


def _checked(path: str | Path, name: str, tensor: Array) -> Float32s:
    """A tensor in 32 bits.  FactoryError for one that is empty, or holds no finite floats."""
    if tensor.dtype.kind != "f":
        raise FactoryError(
            f"weights={path}: do not fit their network: {name} holds {tensor.dtype}, not floats"
        )
    if not tensor.size:
        raise FactoryError(f"weights={path}: do not fit their network: {name} is empty")
    values = tensor.astype(np.float32)
    # An image made with them would be all NaN, or black, and nothing would say why.
    if not np.isfinite(values).all():
        raise FactoryError(
            f"weights={path}: {name} holds NaN or infinity; train again, or take another file"
        )
    return values
