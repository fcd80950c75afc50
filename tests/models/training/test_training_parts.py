"""What a training is made of: a network, losses, figures of merit, the learning rate."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import yaml

from simnfnd.evaluation.metrics import fidelity as metrics
from simnfnd.factory.errors import FactoryError
from simnfnd.models.losses import build_loss
from simnfnd.models.networks import build_network
from simnfnd.models.training import quality
from simnfnd.models.training.module import learning_rate_factor
from tests.models.training.small_training import TINY
from tests.project_files import ROOT
from tests.small_dataset import fan_images


@pytest.mark.parametrize("size", [(1, 1), (17, 30), (48, 64), (33, 5)])
def test_nafnet_takes_any_size(size: tuple[int, int]) -> None:
    network = build_network(TINY)
    assert network(torch.rand(2, 1, *size)).shape == (2, 1, *size)


def test_small_nafnet_is_as_large_as_published() -> None:
    """1.14 M parameters and 1.27 GMAC at 256x256, counted by torch from the operations."""
    from torch.utils.flop_counter import FlopCounterMode

    config = yaml.safe_load((ROOT / "conf/model/nafnet.yaml").read_text(encoding="utf-8"))
    network = build_network(config)
    assert sum(p.numel() for p in network.parameters()) == pytest.approx(1.14e6, rel=0.005)
    with FlopCounterMode(display=False) as counter, torch.inference_mode():
        network(torch.zeros(1, 1, 256, 256))
    assert counter.get_total_flops() / 2 == pytest.approx(1.27e9, rel=0.005)


def test_padding_does_not_reach_far_pixels() -> None:
    """An image and its upper left part agree where attention over the whole image is the same."""
    network = build_network(TINY)
    image = torch.rand(1, 1, 37, 41)
    padded = torch.nn.functional.pad(image, (0, 3, 0, 3), mode="replicate")
    assert torch.equal(network(image), network(padded)[..., :37, :41])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"kind": "restormer9"}, "model.kind"),
        ({"width": 0}, "model.width"),
        ({"decoder": [1]}, "as many of each"),
        ({"depth": 3}, "model.depth: unknown key"),
    ],
)
def test_odd_networks_are_refused(change: dict[str, object], words: str) -> None:
    with pytest.raises(FactoryError, match=words):
        build_network({**TINY, **change})


def test_losses_are_their_formulas() -> None:
    a = torch.tensor([[0.0, 0.5]]).reshape(1, 1, 1, 2).requires_grad_()
    b = torch.tensor([[0.3, 0.5]]).reshape(1, 1, 1, 2)
    assert build_loss({"kind": "l1"})(a, b).item() == pytest.approx(0.15)
    smooth = build_loss({"kind": "charbonnier", "epsilon": 0.4})
    assert smooth(a, b).item() == pytest.approx((0.5 + 0.4) / 2)
    (gradient,) = torch.autograd.grad(smooth(a, b), a)
    assert gradient.flatten().tolist() == pytest.approx([-0.3 / 0.5 / 2, 0])
    with pytest.raises(FactoryError, match=r"loss\.kind"):
        build_loss({"kind": "l7"})


def test_quality_agrees_with_the_evaluation() -> None:
    noisy, clean, _ = fan_images(48, np.random.default_rng(3))
    batch = [torch.from_numpy(image)[None, None] for image in (noisy, clean)]
    assert float(quality.psnr_db(*batch)) == pytest.approx(
        metrics.psnr(clean, noisy, data_range=1), abs=1e-4
    )
    assert float(quality.ssim(*batch)) == pytest.approx(
        metrics.ssim(clean, noisy, data_range=1), abs=1e-6
    )


def test_learning_rate_climbs_and_falls() -> None:
    factors = [learning_rate_factor(step, 10, 100) for step in range(101)]
    assert factors[0] == pytest.approx(1 / 11)
    assert factors[10] == 1 == max(factors)
    assert factors[55] == pytest.approx(0.5)
    assert factors[100] == pytest.approx(0)
    assert factors[10:] == sorted(factors[10:], reverse=True)
