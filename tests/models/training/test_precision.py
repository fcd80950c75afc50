"""train.precision=auto: what it chooses, that it says so once, and that a training keeps it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
import yaml

from simnfnd.factory.errors import FactoryError
from simnfnd.models.networks.weights import load_weights
from simnfnd.models.settings import ModelsSettings
from simnfnd.models.training import precision
from simnfnd.models.training.train import train
from tests.models.training.small_training import SMALL, config_for
from tests.small_dataset import write_dataset

FLAGS = "processor\t: 0\nflags\t\t: fpu avx512f {}\n"


@pytest.fixture
def settings(tmp_path: Path) -> ModelsSettings:
    return config_for(tmp_path, tmp_path / "out", "train.precision=auto")[0]


def has(monkeypatch: pytest.MonkeyPatch, *, cpu: bool = False, gpu: bool = False) -> None:
    monkeypatch.setattr(precision, "cpu_has_bf16", lambda: cpu)
    monkeypatch.setattr(precision, "gpu_has_bf16", lambda: gpu)


@pytest.mark.parametrize(
    ("accelerator", "bf16", "expected"),
    [
        ("cpu", True, "bf16-mixed"),
        ("cpu", False, "32-true"),
        ("gpu", True, "bf16-mixed"),
        ("gpu", False, "16-mixed"),
    ],
)
def test_the_device_decides_and_one_line_tells(
    accelerator: str,
    bf16: bool,
    expected: str,
    settings: ModelsSettings,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    has(monkeypatch, **{accelerator: bf16})
    assert precision.decided(settings, accelerator).train.precision == expected
    said = capsys.readouterr().err
    assert said.startswith(f"train.precision=auto: {expected} (")
    assert said.count("\n") == 1


def test_adversarial_training_stays_clear_of_float16(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    has(monkeypatch)
    settings = config_for(tmp_path, tmp_path, "model=sid_tgan", "train.precision=auto")[0]
    assert precision.decided(settings, "gpu").train.precision == "32-true"


def test_a_training_that_goes_on_keeps_what_it_began_with(
    settings: ModelsSettings, monkeypatch: pytest.MonkeyPatch
) -> None:
    has(monkeypatch, cpu=True)
    assert precision.decided(settings, "cpu", "32-true").train.precision == "32-true"
    with pytest.raises(FactoryError, match="16-mixed needs a GPU"):
        precision.decided(settings, "cpu", "16-mixed")


def test_slow_bf16_is_told_once_and_done(
    settings: ModelsSettings,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    asked: Any = {"precision": "bf16-mixed"}
    settings = replace(settings, train=replace(settings.train, **asked))
    has(monkeypatch)
    assert precision.decided(settings, "cpu") == settings
    said = capsys.readouterr().err
    assert "no instructions for it" in said
    assert said.count("\n") == 1
    has(monkeypatch, cpu=True)
    assert precision.decided(settings, "cpu") == settings
    assert not capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (FLAGS.format("avx512_bf16"), True),
        (FLAGS.format("amx_bf16 amx_tile"), True),
        (FLAGS.format("avx512_vnni"), False),
        ("Features\t: fp asimd\n", False),
        (None, False),
    ],
)
def test_flags_of_the_cpu(
    text: str | None, expected: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(precision, "_CPU_FACTS", tmp_path / "cpuinfo")
    if text is not None:
        (tmp_path / "cpuinfo").write_text(text)
    assert precision.cpu_has_bf16() is expected


def test_a_resumed_training_and_its_files_state_the_chosen_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    torch.set_num_threads(1)
    dataset, out = write_dataset(tmp_path / "data", train=4, test=0, size=48), tmp_path / "out"
    words = (*SMALL, "train.precision=auto", "train.steps=2", "train.check_every=1", "device=cpu")
    has(monkeypatch)
    train(*config_for(dataset, out, *words))
    first = (out / "weights.safetensors").read_bytes()
    assert load_weights(out / "weights.safetensors").training["train.precision"] == "32-true"
    assert yaml.safe_load((out / "config.yaml").read_text())["train"]["precision"] == "32-true"
    has(monkeypatch, cpu=True)  # moved to another machine
    train(*config_for(dataset, out, *words))
    assert (out / "weights.safetensors").read_bytes() == first
