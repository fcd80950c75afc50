"""The blend head: its inputs, and that it learns which pictures should be changed."""

from __future__ import annotations

import pytest
import torch
from scipy.ndimage import gaussian_filter1d

from simnfnd.models.networks.sonarnet import BlendHead

SECTOR = torch.zeros(1, 1, 32, 32)
SECTOR[..., 4:] = 1


def picture(seed: int = 0) -> torch.Tensor:
    """White noise without dark cells, (1, 1, 32, 32)."""
    return 0.1 + 0.9 * torch.rand(1, 1, 32, 32, generator=torch.Generator().manual_seed(seed))


@pytest.mark.parametrize("size", [(32, 32), (29, 31), (1, 1), (2, 6)])
def test_any_size_gets_a_weight_and_at_first_the_same(size: tuple[int, int]) -> None:
    height, width = size
    head = BlendHead(3)
    half = torch.rand(2, 3, -(-height // 8) * 4, -(-width // 8) * 4)
    planes = [torch.rand(2, 1, height, width) for _ in range(2)]
    weights = head(half, *planes, torch.ones(2, 1, height, width))
    assert weights.tolist() == pytest.approx([0.9526, 0.9526], abs=1e-4)


def test_it_learns_which_pictures_are_blurred_along_range() -> None:
    torch.manual_seed(0)
    head, features = BlendHead(2), torch.zeros(8, 2, 16, 16)
    noisy = torch.cat([picture(seed) for seed in range(8)])
    noisy[:4] = torch.from_numpy(gaussian_filter1d(noisy[:4].numpy(), 1.0, axis=2))
    inputs = (features, noisy, torch.zeros_like(noisy), SECTOR.expand(8, -1, -1, -1))
    wanted = torch.tensor([0.9] * 4 + [0.1] * 4)
    optimizer = torch.optim.AdamW(head.parameters(), lr=0.01)
    for _ in range(80):
        optimizer.zero_grad()
        torch.nn.functional.smooth_l1_loss(head(*inputs), wanted).backward()
        optimizer.step()
    assert (head(*inputs) - wanted).abs().max() < 0.2
    # Neither the picture nor the features are made better for its sake.
    given = [features.requires_grad_(), torch.zeros_like(noisy, requires_grad=True)]
    head(given[0], noisy, given[1], inputs[3]).sum().backward()
    assert [x.grad for x in given] == [None, None]
