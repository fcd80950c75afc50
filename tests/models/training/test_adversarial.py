"""Training against a discriminator: its terms, its turns, and that it resumes exactly."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch
from hydra import compose, initialize_config_module
from omegaconf import OmegaConf
from safetensors import safe_open

from simnfnd.factory.errors import FactoryError
from simnfnd.factory.settings import build
from simnfnd.models.networks.sid_tgan import Discriminator, SIDTGANSettings
from simnfnd.models.settings import ModelsSettings
from simnfnd.models.training.adversarial import AdversarialModule, dissimilarity, gram, hinge, style
from simnfnd.models.training.train import train
from tests.small_dataset import write_dataset

SMALL = (
    *("model=sid_tgan", "model.width=4", "model.blocks=1", "model.heads=2"),
    *("model.critic_width=4", "data.patch=32", "data.batch=2", "data.validation_limit=2"),
    *("train.steps=6", "train.check_every=3", "train.warmup=1", "train.ema=0.5"),
    *("tensorboard=false", "pictures=0"),
)
SETTINGS = SIDTGANSettings("sid_tgan", 4, 1, 2, 4, 1.0, 0.1, 0.01)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_dataset(tmp_path_factory.mktemp("data"), train=16, test=0, size=48)


def train_small(dataset: Path, out: Path, *overrides: str) -> dict[str, float | int]:
    with initialize_config_module("simnfnd.conf", version_base="1.3"):
        composed = compose(
            "models", [f"dataset.dir='{dataset}'", f"out='{out}'", *SMALL, *overrides]
        )
    values: Any = OmegaConf.to_container(composed, resolve=True)
    return train(build(ModelsSettings, values), values)


def test_hinge_is_satisfied_by_clear_judgements() -> None:
    assert hinge(torch.tensor([1.0, 2.0]), torch.tensor([-1.0, -5.0])).item() == 0
    assert hinge(torch.tensor([0.0]), torch.tensor([0.0])).item() == 2
    assert hinge(torch.tensor([-1.0]), torch.tensor([3.0])).item() == 6


def test_texture_is_what_stays_when_places_change() -> None:
    source = torch.Generator().manual_seed(0)
    features = torch.rand(2, 3, 4, 5, generator=source)
    shuffled = features.flatten(2)[:, :, torch.randperm(20, generator=source)].reshape(2, 3, 4, 5)
    assert style([features], [shuffled]).item() == pytest.approx(0, abs=1e-6)
    assert style([features], [features + 0.1]).item() > 0.05
    expected = torch.einsum("nchw,ndhw->ncd", features, features) / 20
    torch.testing.assert_close(gram(features), expected)


def test_global_similarity_is_about_direction_alone() -> None:
    a, b = torch.tensor([[1.0, 0.0], [0.0, 2.0]]), torch.tensor([[3.0, 0.0], [0.0, -1.0]])
    assert dissimilarity(a, a).item() == pytest.approx(0)
    assert dissimilarity(a, b).item() == pytest.approx((0 + 2) / 2)


def test_the_discriminator_learns_to_tell() -> None:
    torch.manual_seed(0)
    judge = Discriminator(SETTINGS)
    noisy, true = torch.rand(2, 4, 1, 32, 32)
    false = torch.nn.functional.avg_pool2d(true, 5, stride=1, padding=2)
    optimizer = torch.optim.AdamW(judge.parameters(), lr=0.003)
    for _ in range(40):
        loss = hinge(judge(noisy, true)[0], judge(noisy, false)[0])
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    right, wrong = judge(noisy, true)[0].mean(), judge(noisy, false)[0].mean()
    assert right > wrong + 0.5


def test_both_learn_and_only_the_generator_is_kept(
    dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before: dict[str, torch.Tensor] = {}
    modules: list[AdversarialModule] = []
    start = AdversarialModule.on_fit_start

    def remember(module: AdversarialModule) -> None:
        modules.append(module)
        before.update({name: x.detach().clone() for name, x in module.named_parameters()})
        start(module)

    monkeypatch.setattr(AdversarialModule, "on_fit_start", remember)
    row = train_small(dataset, tmp_path)
    assert row["step"] in (3, 6)
    (module,) = modules
    # Six steps of six, not twelve: a step is one turn of each.
    assert module.trainer.global_step == 6
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
    train_small(dataset, tmp_path / "whole")
    step = AdversarialModule.training_step

    def stop(module: AdversarialModule, batch: Any, index: int) -> torch.Tensor:
        if module.current_epoch == 1 and index == 1:
            raise FactoryError("pulled the plug")
        return step(module, batch, index)

    with monkeypatch.context() as patch:
        patch.setattr(AdversarialModule, "training_step", stop)
        with pytest.raises(FactoryError, match="pulled the plug"):
            train_small(dataset, tmp_path / "cut")
    train_small(dataset, tmp_path / "cut")
    names = ("weights.safetensors", "metrics.csv")
    weights = [(tmp_path / run / names[0]).read_bytes() for run in ("whole", "cut")]
    assert weights[0] == weights[1]


def test_a_loss_that_is_not_a_number_stops_it(
    dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def nothing(true: torch.Tensor, false: torch.Tensor) -> torch.Tensor:
        return (true.mean() + false.mean()) * torch.nan

    monkeypatch.setattr("simnfnd.models.training.adversarial.hinge", nothing)
    with pytest.raises(FactoryError, match="became nan at step 0"):
        train_small(dataset, tmp_path)


def test_images_without_clean_ones_are_refused(dataset: Path, tmp_path: Path) -> None:
    folder = tmp_path / "images"
    folder.mkdir()
    for number in range(4):
        cv2.imwrite(str(folder / f"{number}.png"), np.full((40, 40), 50 * number, np.uint8))
    with pytest.raises(FactoryError, match=r"sid_tgan.*clean images"):
        train_small(dataset, tmp_path / "out", "data=self_supervised", f"data.folder='{folder}'")
