"""The weighted mean of trained weights, one after the other of a chain of trainings.

    python -m tools.mean_weights OUT A.safetensors=0.65 B.safetensors=0.35

After Wortsman et al. (CVPR 2022), for weights that began from each other: others have no mean that
denoises.  The first names the network; residual blocks and lines that another one lacks are the
identity there, as where training grows a network (`start=`).  Parts add up to 1.
"""

from __future__ import annotations

import hashlib
import sys
from pathlib import Path

import torch
from torch import Tensor

from simnfnd.factory.errors import FactoryError
from simnfnd.models.networks import build_network
from simnfnd.models.networks.weights import load_weights, save_weights
from simnfnd.models.pretrained import find_weights
from simnfnd.models.training.beginning import LAST_LAYERS, fresh_parts


def mean(parts: dict[str, float], out: Path) -> None:
    """Write the mean; the recipe is that of the first, with hashes and parts of all.

    parts: file, or name of weights that ship -> its part.
    Raises FactoryError when parts do not add up to 1 or networks do not fit each other.
    """
    if abs(sum(parts.values()) - 1) > 1e-6:
        raise FactoryError(f"the parts add up to {sum(parts.values()):g}; give parts of 1")
    files = [find_weights(name) for name in parts]
    trained = [load_weights(file) for file in files]
    network = build_network(trained[0].model)
    states: list[dict[str, Tensor]] = []
    for name, one in zip(parts, trained, strict=True):
        state = dict(one.network.state_dict())
        # The last layer of a part decides how much it adds, so only that is weighed.
        first = states[0] if states else state
        missing = fresh_parts(network, state)
        state |= {
            key: torch.zeros_like(value)
            if any(layer in key for layer in LAST_LAYERS)
            else first[key]
            for key, value in missing.items()
        }
        try:
            network.load_state_dict(state)
        except RuntimeError as error:
            raise FactoryError(
                f"{name}: holds {dict(one.model)}, the first {dict(trained[0].model)}; only blocks "
                "and lines may be fewer"
            ) from error
        states.append(state)
    shares = list(parts.values())
    mixed = {
        key: sum((share * state[key] for share, state in zip(shares, states, strict=True)))
        if value.is_floating_point()
        else value
        for key, value in states[0].items()
    }
    network.load_state_dict(mixed)
    hashes = [hashlib.blake2b(file.read_bytes(), digest_size=8).hexdigest() for file in files]
    training = {**trained[0].training, "mean": dict(zip(hashes, shares, strict=True))}
    save_weights(out, network, trained[0].model, training)


if __name__ == "__main__":
    if len(sys.argv) < 4 or not all("=" in word for word in sys.argv[2:]):
        sys.exit("usage: python -m tools.mean_weights OUT FILE=PART FILE=PART...")
    words = (word.rpartition("=") for word in sys.argv[2:])
    try:
        mean({name: float(part) for name, _, part in words}, Path(sys.argv[1]))
    except (FactoryError, ValueError) as error:
        sys.exit(f"error: {error}")
