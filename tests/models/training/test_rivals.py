"""Networks of other authors: a critic in turns."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

from simnfnd.models.networks.rivals.sid_tgan import hinge
from simnfnd.models.training.loop import TrainingLoop
from simnfnd.models.training.objective import Opponent
from simnfnd.models.training.train import train
from tests.models.networks.tiny_networks import TINY
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
