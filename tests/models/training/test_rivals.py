"""Networks of other authors: a critic in turns, noisy images alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

from simnfnd.factory.common.errors import FactoryError
from simnfnd.models.networks.rivals.log_residual import LogResidual, median_of, structure_of
from simnfnd.models.networks.rivals.sid_tgan import hinge
from simnfnd.models.training.adversarial import Opponent
from simnfnd.models.training.loop import TrainingLoop
from simnfnd.models.training.train import train
from tests.models.networks.tiny_networks import TINY, tiny
from tests.models.training.small_training import config_for
from tests.small_dataset import write_dataset

SMALL = (
    *("data.patch=32", "data.batch=2", "data.crops=2", "data.validation_limit=1"),
    *("train.steps=4", "train.check_every=2", "train.warmup=1", "train.ema=0.5", "device=cpu"),
)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_dataset(tmp_path_factory.mktemp("data"), train=8, test=0, size=48)


def words_of(kind: str) -> list[str]:
    return [f"model={kind}", *(f"model.{key}={value}" for key, value in TINY[kind].items()), *SMALL]


def test_hinge_is_satisfied_by_clear_judgements() -> None:
    assert hinge(torch.tensor([1.0, 2.0]), torch.tensor([-1.0, -5.0])).item() == 0
    assert hinge(torch.tensor([0.0]), torch.tensor([0.0])).item() == 2
    assert hinge(torch.tensor([-1.0]), torch.tensor([3.0])).item() == 6


@pytest.mark.slow
def test_a_critic_learns_in_turns_and_an_interrupted_training_ends_alike(
    dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    critics: list[Opponent] = []
    update = TrainingLoop.update
    created = Opponent.__init__

    def noted(self: Opponent, *arguments: Any) -> None:
        created(self, *arguments)
        critics.append(self)
        starts.append({n: x.clone() for n, x in self.state_dict()["critic"].items()})

    def stopped(self: TrainingLoop, *arguments: Any) -> Tensor:
        if self.step == 3:
            raise OSError("pulled the plug")
        return update(self, *arguments)

    starts: list[dict[str, Tensor]] = []
    with monkeypatch.context() as patch:
        patch.setattr(Opponent, "__init__", noted)
        train(*config_for(dataset, tmp_path / "whole", *words_of("sid_tgan")))
    end = critics[0].state_dict()["critic"]
    moved = [name for name, values in starts[0].items() if not torch.equal(values, end[name])]
    assert len(moved) > 0.8 * len(end)
    with monkeypatch.context() as patch:
        patch.setattr(TrainingLoop, "update", stopped)
        with pytest.raises(OSError, match="pulled the plug"):
            train(*config_for(dataset, tmp_path / "cut", *words_of("sid_tgan")))
    train(*config_for(dataset, tmp_path / "cut", *words_of("sid_tgan")))
    files = [tmp_path / folder / "weights.safetensors" for folder in ("whole", "cut")]
    assert files[0].read_bytes() == files[1].read_bytes()


def test_a_critic_and_a_teacher_exclude_each_other(dataset: Path, tmp_path: Path) -> None:
    words = [*words_of("sid_tgan"), "train.teacher=simnfnd"]
    with pytest.raises(FactoryError, match=r"train\.teacher=simnfnd: .*critic"):
        train(*config_for(dataset, tmp_path, *words))


@pytest.mark.slow
def test_a_network_learns_from_noisy_images_alone(dataset: Path, tmp_path: Path) -> None:
    """What it takes away gets the variance of speckle; it sees no clean image."""
    network = tiny("log_residual").train()
    assert isinstance(network, LogResidual)
    clean = torch.full((4, 1, 24, 24), 0.3)
    clean[..., 12:] = 0.6
    speckle = torch.distributions.Gamma(9.0, 9.0)
    torch.manual_seed(0)
    noisy = (clean * speckle.sample(clean.shape)).clamp(1e-3, 1)
    optimizer = torch.optim.Adam(network.parameters(), lr=0.003)
    for step in range(150):
        loss = network.own_loss(noisy, step / 150)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    with torch.inference_mode():
        denoised = network.eval()(noisy)
    assert (denoised - clean).square().mean() < 0.6 * (noisy - clean).square().mean()
    train(*config_for(dataset, tmp_path, *words_of("log_residual")))
    assert (tmp_path / "weights.safetensors").is_file()


def test_parts_of_the_self_supervised_loss() -> None:
    even = torch.full((1, 1, 6, 6), 0.5)
    assert structure_of(torch.zeros_like(even), even).item() == 0
    step = torch.zeros_like(even)
    step[..., 3:] = 1
    # A step of the residual costs where the image is even, and hardly where it has an edge.
    assert structure_of(step, even).item() == pytest.approx(1 / 5)
    assert structure_of(step, step).item() < 1e-6
    spike = even.clone()
    spike[0, 0, 3, 3] = 1
    assert torch.equal(median_of(spike), even)
