"""Training against a discriminator: its terms, its turns, and that it resumes exactly."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors import safe_open
from torch import Tensor

from simnfnd.factory.errors import FactoryError
from simnfnd.models.networks.literature.dgp_srgan import penalty
from simnfnd.models.networks.literature.sid_tgan import hinge
from simnfnd.models.training.adversarial import AdversarialModule
from simnfnd.models.training.train import train
from tests.models.training.small_training import config_for
from tests.small_dataset import write_dataset

SMALL = (
    *("data.patch=32", "data.batch=2", "data.crops=2", "data.validation_limit=1"),
    *("train.steps=4", "train.check_every=2", "train.warmup=1", "train.ema=0.5"),
    *("tensorboard=false", "pictures=0", "device=cpu", "model.critic_width=4", "model.width=4"),
)
KINDS = {
    "sid_tgan": ("model=sid_tgan", "model.blocks=1", "model.heads=2", *SMALL),
    "dgp_srgan": ("model=dgp_srgan", "model.blocks=1", *SMALL),
}


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_dataset(tmp_path_factory.mktemp("data"), train=8, test=0, size=48)


def test_hinge_is_satisfied_by_clear_judgements() -> None:
    assert hinge(torch.tensor([1.0, 2.0]), torch.tensor([-1.0, -5.0])).item() == 0
    assert hinge(torch.tensor([0.0]), torch.tensor([0.0])).item() == 2
    assert hinge(torch.tensor([-1.0]), torch.tensor([3.0])).item() == 6


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


@pytest.mark.parametrize("kind", KINDS)
def test_both_learn_in_turns_and_only_the_generator_is_kept(
    kind: str, dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And an interrupted training ends with the same weights."""
    before: dict[str, Tensor] = {}
    modules: list[AdversarialModule] = []
    step = AdversarialModule.update

    def remember(module: AdversarialModule, *given: Any) -> Tensor:
        if not modules:
            modules.append(module)
            before.update({name: x.detach().clone() for name, x in module.named_parameters()})
        return step(module, *given)

    def stop(module: AdversarialModule, *given: Any) -> Tensor:
        if module.step == 3:
            raise FactoryError("pulled the plug")
        return step(module, *given)

    with monkeypatch.context() as patch:
        patch.setattr(AdversarialModule, "update", remember)
        train(*config_for(dataset, tmp_path / "whole", *KINDS[kind]))
    (module,) = modules
    moved = {name for name, x in module.named_parameters() if not torch.equal(x, before[name])}
    for part in ("network.", "discriminator."):
        names = {name for name, _ in module.named_parameters() if name.startswith(part)}
        assert len(names & moved) > 0.8 * len(names), part
    weights = tmp_path / "whole" / "weights.safetensors"
    with safe_open(weights, framework="pt") as file:
        assert set(file.keys()) == set(module.network.state_dict())
    with monkeypatch.context() as patch:
        patch.setattr(AdversarialModule, "update", stop)
        with pytest.raises(FactoryError, match="pulled the plug"):
            train(*config_for(dataset, tmp_path / "cut", *KINDS[kind]))
    train(*config_for(dataset, tmp_path / "cut", *KINDS[kind]))
    assert (tmp_path / "cut" / "weights.safetensors").read_bytes() == weights.read_bytes()


def test_a_loss_that_is_not_a_number_stops_it(
    dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def nothing(true: Tensor, false: Tensor) -> Tensor:
        return (true.mean() + false.mean()) * torch.nan

    monkeypatch.setattr("simnfnd.models.networks.literature.sid_tgan.hinge", nothing)
    with pytest.raises(FactoryError, match="became nan at step 0"):
        train(*config_for(dataset, tmp_path, *KINDS["sid_tgan"]))
