"""What a training is made of: a network, losses, figures of merit, the learning rate."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from simnfnd.evaluation.metrics import fidelity as metrics
from simnfnd.models.training import module as quality
from simnfnd.models.training.module import learning_rate_factor
from tests.small_dataset import fan_images


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
