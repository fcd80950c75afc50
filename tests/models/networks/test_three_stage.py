"""Three stages: parts of a picture that come back, and a lesson for each stage."""

from __future__ import annotations

import pytest
import torch
from torch.nn import functional

from simnfnd.factory.settings import build
from simnfnd.models.losses import build_loss
from simnfnd.models.networks.literature.three_stage import (
    ThreeStage,
)
from simnfnd.models.settings import TrainSettings
from simnfnd.models.training.module import DenoisingModule
from tests.models.networks.tiny_networks import stirred, tiny


def three_stage() -> ThreeStage:
    network = stirred(tiny("three_stage"))
    assert isinstance(network, ThreeStage)
    return network


@pytest.mark.parametrize("size", [(17, 30), (8, 8), (33, 5)])
def test_stages_are_pictures_and_the_last_is_the_result(size: tuple[int, int]) -> None:
    network, image = three_stage(), torch.rand(2, 3, *size)
    stages = network.with_stages(image)
    assert [stage.shape for stage in stages] == [image.shape] * 3
    assert torch.equal(stages[-1], network(image))
    assert not torch.allclose(stages[0], stages[1], atol=1e-3)
    with pytest.raises(TypeError, match="UNet has no stages"):
        tiny("unet").with_stages(image)


SETTINGS = {
    **{"steps": 10, "check_every": 5, "patience": None, "learning_rate": 0.01},
    **{"weight_decay": 0.0, "warmup": 1, "clip": 1.0, "ema": 0.5, "precision": "32-true"},
}


def test_every_stage_is_taught() -> None:
    network = three_stage()
    settings: TrainSettings = build(TrainSettings, SETTINGS, "train")
    loss = build_loss({"kind": "l1"})
    module = DenoisingModule(network, loss, settings)
    noisy, clean = torch.rand(2, 2, 1, 16, 16)
    found = module({"noisy": noisy, "clean": clean})
    expected = [functional.l1_loss(stage, clean) for stage in network.with_stages(noisy)]
    torch.testing.assert_close(found, torch.stack(expected).mean())
    found.backward()
    without = [name for name, p in network.named_parameters() if p.grad is None]
    assert not without
    first = dict(network.named_parameters())["supervised.0.residual.weight"].grad
    assert first is not None
    assert first.abs().max() > 0
