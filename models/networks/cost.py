"""What a network costs: parameters, multiply-accumulates and time of one core.

`python -m simnfnd.models.networks.cost` measures every network of conf/model.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from math import prod
from typing import Any

import torch
import yaml
from torch import Tensor
from torch.utils.flop_counter import FlopCounterMode

from ...factory.errors import FactoryError
from . import NETWORKS, build_network
from .network import Network
from .weights import channels_last

_REPEATS = 3


@dataclass(frozen=True)
class Cost:
    """What one gray image costs.

    parameters: numbers in the weights.  gmac: 1e9 multiply-accumulates for an image of `gmac_px` x
    `gmac_px`.  cpu_ms: CPU milliseconds of one core for an image of `time_px` x `time_px`.
    """

    parameters: int
    gmac: float
    cpu_ms: float
    gmac_px: int
    time_px: int


def measure(network: Network, *, gmac_px: int = 256, time_px: int = 512) -> Cost:
    """Cost of denoising one gray image, with all extras that the network uses.

    The time is the least of three, in 32-bit floats; it is this machine's and varies.
    """
    return Cost(
        parameters=sum(weights.numel() for weights in network.parameters()),
        gmac=count_macs(network, gmac_px) / 1e9,
        cpu_ms=cpu_seconds(network, time_px) * 1e3,
        gmac_px=gmac_px,
        time_px=time_px,
    )


def count_macs(network: Network, size_px: int) -> int:
    """Multiply-accumulates of convolutions, matrix products and attention, by torch's counter.

    Of the network in use, where that differs from training.  Nothing is computed where the network
    is on torch's `meta` device.
    """
    image, extras = example(network, size_px)
    # torch counts two floating-point operations a multiply-accumulate, and lacks its own kernel
    # for attention on a CPU.
    attention = torch.ops.aten._scaled_dot_product_flash_attention_for_cpu
    counter = FlopCounterMode(display=False, custom_mapping={attention: _attention_flops})
    was_training = network.training
    network.eval()
    try:
        with counter, torch.inference_mode():
            network(image, **extras)
    finally:
        network.train(was_training)
    return int(counter.get_total_flops()) // 2


def cpu_seconds(network: Network, size_px: int) -> float:
    """CPU seconds of one core, the least of three; memory laid out as denoising has it."""
    threads = torch.get_num_threads()
    image, extras = example(network, size_px)
    network = channels_last(network)
    was_training = network.training
    network.eval()
    torch.set_num_threads(1)
    try:
        best = float("inf")
        with torch.inference_mode():
            network(image, **extras)
            for _ in range(_REPEATS):
                started = time.process_time()
                network(image, **extras)
                best = min(best, time.process_time() - started)
    finally:
        torch.set_num_threads(threads)
        network.train(was_training)
    return best


def example(network: Network, size_px: int) -> tuple[Tensor, dict[str, Tensor]]:
    """A random square image, and the extras of a fan of 60 degrees that fills it."""
    image = torch.rand(1, 1, size_px, size_px, generator=torch.Generator().manual_seed(0))
    step = (torch.arange(size_px) + 0.5) / size_px
    ahead, right = 1 - 0.9 * step[:, None], (step - 0.5)[None]
    range_fraction, azimuth_rad = torch.hypot(ahead, right), torch.atan2(right, ahead)
    sector = (azimuth_rad.abs() <= torch.pi / 6) & (range_fraction <= 1)
    known = {
        "range_fraction": range_fraction[None, None],
        "azimuth_rad": azimuth_rad[None, None],
        "sector": sector.float()[None, None],
    }
    device = next(network.parameters()).device
    return image.to(device), {
        name: plane.to(device) for name, plane in known.items() if name in network.extras
    }


def _attention_flops(
    query: Sequence[int], key: Sequence[int], *_: Any, out_shape: Any = None, **__: Any
) -> int:
    # Two matrix products, (queries x width) by (width x keys) and back.
    *outer, queries, width = query
    return 4 * prod(outer) * queries * key[-2] * width


def _configs() -> Mapping[str, Mapping[str, Any]]:
    folder = files("simnfnd.conf") / "model"
    texts = {kind: folder / f"{kind}.yaml" for kind in sorted(NETWORKS)}
    return {kind: yaml.safe_load(text.read_text("utf-8")) for kind, text in texts.items()}


def main() -> int:
    """Print the table of docs/models.md."""
    print("| network | parameters, M | GMAC at 256x256 | CPU ms at 512x512, one core |")
    print("|---|---:|---:|---:|")
    for kind, config in _configs().items():
        cost = measure(build_network(config))
        print(f"| {kind} | {cost.parameters / 1e6:.2f} | {cost.gmac:.2f} | {cost.cpu_ms:.0f} |")
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except FactoryError as error:
        sys.exit(str(error))
