"""Learning from a teacher's pictures."""

from __future__ import annotations

import copy
from pathlib import Path

import pytest
import torch

from simnfnd.factory.errors import FactoryError
from simnfnd.factory.files import sha256_of
from simnfnd.models import WEIGHTS_NAME
from simnfnd.models.networks import build_network
from simnfnd.models.networks.weights import load_weights, save_weights
from simnfnd.models.training.module import Teacher, completed
from simnfnd.models.training.train import train
from tests.models.training.small_training import SMALL, config_for, train_small
from tests.small_dataset import write_dataset

SONARNET = {
    **{"kind": "sonarnet", "widths": [8, 8], "blocks": [1, 1], "polar": False, "lines": False},
    **{"mask": True, "forget": 0.0},
}


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_dataset(tmp_path_factory.mktemp("data"), train=24, test=4, size=48)


@pytest.fixture(scope="module")
def teacher(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Weights of a network that darkens what it sees."""
    torch.manual_seed(3)
    network = build_network(SONARNET)
    with torch.no_grad():
        network.outro.bias[:4] = -0.1  # type: ignore[union-attr, operator]
    path = tmp_path_factory.mktemp("teacher") / "teacher.safetensors"
    save_weights(path, network, SONARNET, {})
    return path


def batch_of(size: int = 16) -> dict[str, torch.Tensor]:
    drawn = torch.Generator().manual_seed(1)
    noisy = torch.rand(2, 1, size, size, generator=drawn)
    return {
        "noisy": noisy,
        "clean": torch.rand(2, 1, size, size, generator=drawn),
        "shadow": (noisy < 0.3).float(),
    }


def test_share_weighs_truth_and_teacher(teacher: Path) -> None:
    batch = batch_of()
    network = load_weights(teacher).network
    with torch.no_grad():
        image = network.with_heads(batch["noisy"]).image
    for share in (0.0, 0.25, 1.0):
        got = completed(batch, batch["noisy"], Teacher(teacher, share))["clean"]
        torch.testing.assert_close(got, share * image + (1 - share) * batch["clean"])


def test_a_student_becomes_like_its_teacher(teacher: Path, dataset: Path, tmp_path: Path) -> None:
    """Taught alone, it darkens pictures as the teacher does, whatever the clean ones say."""
    before = copy.deepcopy(load_weights(teacher).network.state_dict())
    out = tmp_path / "student"
    words = ["model=sonarnet", "model.widths=[8,8]", "model.blocks=[1,1]", "model.lines=false"]
    words += [word for word in SMALL if not word.startswith("model.")]
    words += [f"train.teacher='{teacher}'", "train.teacher_share=1"]
    train(*config_for(dataset, out, *words))
    student = load_weights(out / WEIGHTS_NAME)
    assert student.training["train.teacher"] == sha256_of(teacher)[:16]
    batch = batch_of(48)
    with torch.no_grad():
        want = load_weights(teacher).network.with_heads(batch["noisy"]).image
        got = student.network.with_heads(batch["noisy"]).image
    assert (got - want).abs().mean() < 0.5 * (batch["noisy"] - want).abs().mean()
    for name, values in load_weights(teacher).network.state_dict().items():
        assert torch.equal(values, before[name]), name


def test_odd_teachers_are_one_line(dataset: Path, tmp_path: Path) -> None:
    with pytest.raises(FactoryError, match=r"weights=nowhere: no such file"):
        train_small(dataset, tmp_path / "none", "train.teacher=nowhere")
