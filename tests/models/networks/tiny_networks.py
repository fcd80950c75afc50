"""A tiny network of every kind."""

from __future__ import annotations

from typing import Any

import torch

from simnfnd.models.networks import build_network
from simnfnd.models.networks.network import Network

TINY: dict[str, dict[str, Any]] = {
    "sid_tgan": {
        **{"width": 4, "blocks": 1, "heads": 2, "critic_width": 4},
        **{"style": 1.0, "similarity": 0.1, "adversarial": 0.005},
    },
    "nafnet": {"width": 4, "encoder": [1, 1], "middle": 1, "decoder": [1, 1]},
    "restormer": {
        **{"width": 8, "blocks": [1, 1, 1], "refinement": 1},
        **{"heads": [1, 2, 4], "expansion": 2.0},
    },
    "sonarnet": {
        **{"widths": [8, 12], "blocks": [1, 1]},
        **{"polar": True, "lines": True, "mask": True, "forget": 0.1},
    },
}


def tiny(kind: str, **changes: Any) -> Network:
    torch.manual_seed(0)
    return build_network({"kind": kind, **TINY[kind], **changes}).eval()


def stirred(network: Network) -> Network:
    """The same with all weights away from where training begins (some begin at zero)."""
    source = torch.Generator().manual_seed(1)
    with torch.no_grad():
        for weights in network.parameters():
            weights.add_(0.1 * torch.randn(weights.shape, generator=source))
    return network
