"""The loss on what is taken away: speckle satisfies it, and black pixels have no say."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from scipy import ndimage
from torch import Tensor

from simnfnd.models.training.residual_statistics import median, residual_loss
from simnfnd.models.training.train import train
from tests.models.networks.tiny_networks import tiny
from tests.models.training.small_training import config_for
from tests.small_dataset import write_dataset

NINE_LOOKS = 0.1175
"""Variance of the logarithm of a gamma variable of shape 9."""


def speckled(seed: int = 0, count: int = 4) -> tuple[Tensor, Tensor]:
    """(noisy, clean), (count, 1, 48, 64)."""
    rng = np.random.default_rng(seed)
    clean = ndimage.gaussian_filter(rng.random((count, 1, 48, 64)), (0, 0, 6, 6))
    clean = 0.15 + 0.35 * (clean - clean.min()) / np.ptp(clean)
    noisy = np.clip(clean * rng.gamma(9, 1 / 9, clean.shape), 0, 1)
    return torch.tensor(noisy, dtype=torch.float32), torch.tensor(clean, dtype=torch.float32)


def test_the_median_is_that_of_scipy() -> None:
    image = torch.rand(2, 1, 13, 9)
    expected = ndimage.median_filter(image.numpy(), size=(1, 1, 5, 5), mode="nearest")
    np.testing.assert_array_equal(median(image).numpy(), expected)


def test_speckle_satisfies_the_statistics_and_neither_nothing_nor_too_much_does() -> None:
    noisy, clean = speckled()

    def loss(image: Tensor, variance: float = NINE_LOOKS) -> float:
        return residual_loss(image, noisy, variance, 0.0).item()

    nothing, flat = noisy, clean.mean(dim=(2, 3), keepdim=True).expand_as(clean)
    assert loss(nothing) == pytest.approx(0.4 * NINE_LOOKS, rel=1e-4)
    assert loss(nothing, 0.41) == pytest.approx(0.4 * 0.41, rel=1e-4)
    # Roughness of what is taken is the same of both; the spread is not.
    assert loss(clean) < loss(flat)
    darker = loss(0.7 * clean) - loss(clean)
    # Speckle of mean 1 has a logarithm of mean -1/18.
    assert darker == pytest.approx(0.4 * (np.log(1 / 0.7) - 2 / 18), abs=0.02)


def test_the_median_counts_more_and_more() -> None:
    noisy, clean = speckled()
    at = [residual_loss(clean, noisy, NINE_LOOKS, done).item() for done in (0, 0.3, 0.6, 1)]
    assert at[0] < at[1] < at[2] == at[3]
    assert at[1] - at[0] == pytest.approx((at[2] - at[0]) / 2, rel=1e-4)


def test_black_pixels_teach_nothing_and_others_do() -> None:
    noisy, clean = speckled()
    noisy[..., :20] = 0
    image = clean.clone().requires_grad_(True)
    residual_loss(image, noisy, NINE_LOOKS, 1.0).backward()
    assert image.grad is not None
    assert not image.grad[..., :20].any()
    assert (image.grad[..., 21:] != 0).float().mean() > 0.9
    empty = torch.zeros(1, 1, 8, 8, requires_grad=True)
    nothing = residual_loss(empty, torch.zeros(1, 1, 8, 8), NINE_LOOKS, 1.0)
    assert nothing.item() == 0


def test_a_network_learns_by_it_to_denoise() -> None:
    noisy, clean = speckled()
    torch.manual_seed(0)
    network = tiny("unet", widths=[8, 16]).train()
    optimizer = torch.optim.AdamW(network.parameters(), lr=0.01)
    steps = 100
    for step in range(steps):
        loss = residual_loss(network(noisy), noisy, NINE_LOOKS, step / steps)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    with torch.inference_mode():
        denoised = network.eval()(noisy)
    before, after = ((image - clean).square().mean().item() for image in (noisy, denoised))
    assert 10 * np.log10(before / after) > 5


def test_it_trains(tmp_path: Path) -> None:
    folder = write_dataset(tmp_path / "data", train=4, test=0, size=48)
    words = (
        *("data=self_supervised", "data.method=variance", f"data.folder='{folder}'"),
        *("model=unet", "model.widths=[4,8]", "data.patch=32", "data.batch=2", "data.crops=2"),
        *("train.steps=2", "train.check_every=1", "train.warmup=1"),
        *("tensorboard=false", "pictures=0", "device=cpu"),
    )
    row = train(*config_for(tmp_path, tmp_path / "out", *words))
    assert np.isfinite(row["validation_loss"])
