"""Multiply-accumulates of a network, by torch's counter."""

from __future__ import annotations

from collections.abc import Sequence
from math import prod
from typing import Any

import torch
from torch import Tensor
from torch.utils.flop_counter import FlopCounterMode

from .network import Network


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
