"""Train three layers to take the noise away, straight from the shards.

python examples/train_a_tiny_network.py outputs/demo [STEPS]
"""

import sys

import numpy as np
import torch
from torch import nn

from simnfnd import FactoryError, PairDataset

if len(sys.argv) < 2:
    sys.exit(__doc__)
try:
    pairs = PairDataset(sys.argv[1], "train", scaled=True)
except FactoryError as error:
    sys.exit(str(error))

steps = int(sys.argv[2]) if len(sys.argv) > 2 else 200
torch.manual_seed(0)
rng = np.random.default_rng(0)
network = nn.Sequential(
    nn.Conv2d(1, 16, 5, padding=2),
    nn.ReLU(),
    nn.Conv2d(16, 16, 5, padding=2),
    nn.ReLU(),
    nn.Conv2d(16, 1, 5, padding=2),
)
optimizer = torch.optim.Adam(network.parameters(), 2e-3)
losses = []

with pairs:
    for _ in range(steps):
        batch = pairs[rng.integers(len(pairs), size=4)]  # a dict of (4, H, W) arrays in 0..1
        noisy, clean = (torch.from_numpy(batch[name])[:, None] for name in ("noisy", "clean"))
        loss = nn.functional.mse_loss(network(noisy), clean)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())

few = max(1, steps // 10)
print(f"mean squared error {np.mean(losses[:few]):.4f} -> {np.mean(losses[-few:]):.4f}")
