"""Training of DGP-SRGAN: the penalty is its formula, both sides learn, and it resumes exactly."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file
from torch import Tensor

from simnfnd.factory.errors import FactoryError
from simnfnd.models.networks.dgp_srgan import Critic, DGPSRGANSettings
from simnfnd.models.training.adversarial import AdversarialModule
from simnfnd.models.training.gradient_penalty import GradientPenaltyModule, penalty
from simnfnd.models.training.train import train
from tests.models.training.small_training import config_for
from tests.small_dataset import write_dataset

SMALL = (
    *("model=dgp_srgan", "model.width=4", "model.blocks=1", "model.critic_width=4"),
    *("data.patch=32", "data.batch=2", "data.crops=2", "data.validation_limit=1"),
    *("train.steps=4", "train.check_every=2", "train.warmup=1", "train.ema=0.5"),
    *("tensorboard=false", "pictures=0", "device=cpu"),
)
SETTINGS = DGPSRGANSettings("dgp_srgan", 4, 1, 4, 0.001, 10.0)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_dataset(tmp_path_factory.mktemp("data"), train=8, test=0, size=48)


class Slope(torch.nn.Module):
    """A critic whose slope has the same length everywhere."""

    def __init__(self, length: float) -> None:
        super().__init__()
        self.length = torch.nn.Parameter(torch.tensor(length))

    def forward(self, image: Tensor) -> Tensor:
        judged: Tensor = self.length * image.flatten(1).sum(dim=1) / image[0].numel() ** 0.5
        return judged


def test_the_penalty_is_how_far_slopes_are_from_one() -> None:
    images = torch.rand(3, 1, 5, 8)
    for length, expected in ((1.0, 0.0), (3.0, 4.0), (0.0, 1.0)):
        assert penalty(Slope(length), images).item() == pytest.approx(expected, abs=1e-5)
    critic = Slope(3.0)
    penalty(critic, images).backward()
    assert critic.length.grad is not None
    assert critic.length.grad.item() == pytest.approx(2 * (3 - 1), rel=1e-4)


def test_the_critic_learns_to_tell_with_slopes_in_bounds() -> None:
    torch.manual_seed(0)
    critic = Critic(SETTINGS)
    true = torch.rand(4, 1, 32, 32)
    false = torch.nn.functional.avg_pool2d(true, 5, stride=1, padding=2)
    optimizer = torch.optim.AdamW(critic.parameters(), lr=0.003, betas=(0.0, 0.9))
    for _ in range(60):
        between = true.lerp(false, torch.rand(4, 1, 1, 1))
        loss = critic(false).mean() - critic(true).mean() + 10 * penalty(critic, between)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    assert critic(true).min() > critic(false).max()
    assert penalty(critic, true.lerp(false, 0.5)).item() < 0.7


def test_both_learn_and_only_the_generator_is_kept(
    dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before: dict[str, Tensor] = {}
    modules: list[AdversarialModule] = []
    start = AdversarialModule.on_fit_start

    def remember(module: AdversarialModule) -> None:
        modules.append(module)
        before.update({name: x.detach().clone() for name, x in module.named_parameters()})
        start(module)

    monkeypatch.setattr(AdversarialModule, "on_fit_start", remember)
    train(*config_for(dataset, tmp_path, *SMALL))
    (module,) = modules
    assert isinstance(module, GradientPenaltyModule)
    assert module.trainer.global_step == 4
    moved = {name for name, x in module.named_parameters() if not torch.equal(x, before[name])}
    for part in ("network.", "discriminator."):
        names = {name for name, _ in module.named_parameters() if name.startswith(part)}
        assert len(names & moved) > 0.8 * len(names), part
    with safe_open(tmp_path / "weights.safetensors", framework="pt") as file:
        kept = set(file.keys())
    assert kept == set(module.network.state_dict())


def test_an_interrupted_training_ends_with_the_same_weights(
    dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    train(*config_for(dataset, tmp_path / "whole", *SMALL))
    step = AdversarialModule.training_step

    def stop(module: AdversarialModule, batch: Any, index: int) -> Tensor:
        if module.current_epoch == 1 and index == 1:
            raise FactoryError("pulled the plug")
        return step(module, batch, index)

    with monkeypatch.context() as patch:
        patch.setattr(AdversarialModule, "training_step", stop)
        with pytest.raises(FactoryError, match="pulled the plug"):
            train(*config_for(dataset, tmp_path / "cut", *SMALL))
    train(*config_for(dataset, tmp_path / "cut", *SMALL))
    whole, cut = (load_file(tmp_path / run / "weights.safetensors") for run in ("whole", "cut"))
    assert all(torch.equal(whole[name], cut[name]) for name in whole)


def test_images_without_clean_ones_are_refused(dataset: Path, tmp_path: Path) -> None:
    folder = tmp_path / "images"
    folder.mkdir()
    for number in range(4):
        cv2.imwrite(str(folder / f"{number}.png"), np.full((40, 40), 50 * number, np.uint8))
    words = ("data=self_supervised", f"data.folder='{folder}'")
    with pytest.raises(FactoryError, match=r"dgp_srgan.*clean images"):
        train(*config_for(dataset, tmp_path / "out", *SMALL, *words))
