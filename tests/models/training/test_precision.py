"""train.precision=auto: what it chooses, and that the weights say so."""

from __future__ import annotations

from pathlib import Path

import pytest

from simnfnd.models.networks.weights import load_weights
from simnfnd.models.training import loop as device
from simnfnd.models.training.train import train
from tests.models.training.small_training import SMALL, config_for
from tests.small_dataset import write_dataset


@pytest.mark.parametrize(("has", "expected"), [(True, "bf16-mixed"), (False, "32-true")])
def test_the_device_decides_and_the_weights_say_so(
    has: bool,
    expected: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    dataset, out = write_dataset(tmp_path / "data", train=4, test=0, size=48), tmp_path / "out"
    words = (*SMALL, "train.precision=auto", "train.steps=2", "train.check_every=1", "device=cpu")
    monkeypatch.setattr(device, "has_bf16", lambda device: has)
    train(*config_for(dataset, out, *words))
    assert f"train.precision=auto: {expected}\n" in capsys.readouterr().err
    assert load_weights(out / "weights.safetensors").training["train.precision"] == expected
