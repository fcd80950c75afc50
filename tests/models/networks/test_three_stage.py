"""Three stages: parts of a picture that come back, and a lesson for each stage."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from torch.nn import functional

from simnfnd.factory.settings import build
from simnfnd.models.losses import build_loss
from simnfnd.models.networks.literature.three_stage import (
    ThreeStage,
    join_columns,
    join_rows,
    split_columns,
    split_rows,
)
from simnfnd.models.settings import TrainSettings
from simnfnd.models.training.module import DenoisingModule
from simnfnd.models.training.train import train
from tests.models.networks.tiny_networks import stirred, tiny
from tests.models.training.small_training import SMALL, config_for
from tests.small_dataset import write_dataset


def three_stage() -> ThreeStage:
    network = stirred(tiny("three_stage"))
    assert isinstance(network, ThreeStage)
    return network


def test_parts_are_halves_in_order_and_come_back() -> None:
    image = torch.rand(3, 2, 8, 12)
    rows, columns = split_rows(image), split_columns(image)
    assert torch.equal(rows[:2], torch.stack([image[0, :, :4], image[0, :, 4:]]))
    assert torch.equal(columns[:2], torch.stack([image[0, ..., :6], image[0, ..., 6:]]))
    assert torch.equal(join_rows(rows), image)
    assert torch.equal(join_columns(columns), image)


@pytest.mark.parametrize("size", [(17, 30), (8, 8), (33, 5)])
def test_stages_are_pictures_and_the_last_is_the_result(size: tuple[int, int]) -> None:
    network, image = three_stage(), torch.rand(2, 3, *size)
    stages = network.with_stages(image)
    assert [stage.shape for stage in stages] == [image.shape] * 3
    assert torch.equal(stages[-1], network(image))
    assert not torch.allclose(stages[0], stages[1], atol=1e-3)
    with pytest.raises(TypeError, match="UNet has no stages"):
        tiny("unet").with_stages(image)


def test_the_first_stages_see_halves_alone_and_the_last_the_whole() -> None:
    """What changes in the lower half reaches the upper one from the second stage on."""
    network, image = three_stage(), torch.rand(1, 1, 32, 32)
    other = image.clone()
    other[..., 20:28, 20:28] += 0.5
    moved = [
        (after - before).abs()[..., :16, :].max()
        for before, after in zip(
            network.with_stages(image), network.with_stages(other), strict=True
        )
    ]
    assert moved[0] == 0
    assert min(moved[1:]) > 0


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


def test_it_trains(tmp_path: Path) -> None:
    dataset = write_dataset(tmp_path / "data", train=4, test=0, size=48)
    words = ("model=three_stage", "model.width=4", "model.growth=2", "model.full_blocks=1")
    small = [word for word in SMALL if not word.startswith("model")]
    done = ("train.steps=2", "train.check_every=1", "device=cpu")
    row = train(*config_for(dataset, tmp_path / "out", *small, *words, *done))
    assert row["step"] in (1, 2)
    assert (tmp_path / "out" / "weights.safetensors").is_file()
