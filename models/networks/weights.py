"""Trained networks on disk: safetensors with the description of the network in its header."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import save
from torch import nn

from ...factory.errors import FactoryError
from ...factory.files import write_atomically
from . import build_network
from .network import Network
from .weights_file import FORMAT, KEY, read_weights


@dataclass(frozen=True, eq=False)
class Trained:
    """A network ready to denoise, the `model` configuration and the facts of its training."""

    network: Network
    model: Mapping[str, Any]
    training: Mapping[str, Any]


def channels_last(network: Network) -> Network:
    """The same network with the memory layout that halves its time on a CPU."""
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

    Nothing in the file is executed.  Raises FactoryError when it is absent, not a weights file, of
    another program, does not fit the network that it describes, or holds NaN or infinity.
    """
    header, arrays = read_weights(path)
    try:
        network = build_network(header["model"])
        network.load_state_dict({name: torch.from_numpy(one) for name, one in arrays.items()})
    except (FactoryError, RuntimeError, KeyError, AttributeError, TypeError) as error:
        reason = " ".join(str(error).split())[:160]
        raise FactoryError(f"weights={path}: do not fit their network: {reason}") from error
    return Trained(channels_last(network).eval(), header["model"], header.get("training", {}))
