"""Train a plain U-Net on an endless stream of fresh pairs, and log its PSNR.

simnfnd make experiment=demo dataset.dir=outputs/demo
python examples/train_unet_on_stream.py outputs/demo [STEPS]
"""

import sys
from itertools import islice

import torch
from torch import nn
from torch.nn import functional
from torch.utils.data import DataLoader

from simnfnd import FactoryError, PairDataset, PairStream


def convolutions(inputs: int, outputs: int) -> nn.Sequential:
    """Two convolutions, each with its rectifier."""
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, 3, padding=1),
        nn.ReLU(),
        nn.Conv2d(outputs, outputs, 3, padding=1),
        nn.ReLU(),
    )


class UNet(nn.Module):
    """Three levels; what comes out is added to the noisy image."""

    def __init__(self, width: int = 16) -> None:
        super().__init__()
        self.down = nn.ModuleList([convolutions(1, width), convolutions(width, 2 * width)])
        self.bottom = convolutions(2 * width, 4 * width)
        self.up = nn.ModuleList(
            [convolutions(6 * width, 2 * width), convolutions(3 * width, width)]
        )
        self.last = nn.Conv2d(width, 1, 1)

    def forward(self, noisy: torch.Tensor) -> torch.Tensor:
        """(N, 1, H, W) in 0..1 -> the same, denoised; H and W are multiples of 4."""
        features = noisy
        skipped = []
        for level in self.down:
            features = level(features)
            skipped.append(features)
            features = functional.max_pool2d(features, 2)
        features = self.bottom(features)
        for level in self.up:
            features = functional.interpolate(features, scale_factor=2.0)
            features = level(torch.cat([features, skipped.pop()], dim=1))
        return noisy + self.last(features)


def psnr_db(image: torch.Tensor, clean: torch.Tensor) -> float:
    """Of images in 0..1."""
    return float(-10 * torch.log10(functional.mse_loss(image.clamp(0, 1), clean)))


def main() -> None:
    """Train on fresh pairs of the training scenes; measure on stored pairs of the test scenes."""
    dataset = sys.argv[1]
    steps = int(sys.argv[2]) if len(sys.argv) > 2 else 300
    torch.manual_seed(0)
    network = UNet()
    optimizer = torch.optim.Adam(network.parameters(), 2e-3)
    with PairDataset(dataset, "test", scaled=True) as pairs:
        held = {name: torch.from_numpy(images)[:, None] for name, images in pairs[:8].items()}
    height, width = held["noisy"].shape[2:]
    if height % 4 or width % 4:
        sys.exit(f"{dataset}: images of {height} x {width}; this network takes multiples of 4")
    print(f"noisy: {psnr_db(held['noisy'], held['clean']):.2f} dB")

    stream = PairStream(dataset=dataset, batch_size=4)
    loader = DataLoader(stream, batch_size=None, num_workers=1)
    for step, batch in enumerate(islice(loader, steps), start=1):
        loss = functional.l1_loss(network(batch["noisy"][:, None]), batch["clean"][:, None])
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        if step % 50 == 0 or step == steps:
            with torch.no_grad():
                figure = psnr_db(network(held["noisy"]), held["clean"])
            print(f"step {step}: loss {loss.item():.4f}, test {figure:.2f} dB")


# Workers that are spawned import this file again.
if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    try:
        main()
    except FactoryError as error:
        sys.exit(str(error))
