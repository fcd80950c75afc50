"""A network of the user's own: trained by the command, and run from its weights."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from pydantic.dataclasses import dataclass
from torch import Tensor, nn

from simnfnd.command import main
from simnfnd.extensions import STRICT, register_network
from simnfnd.factory.common import extensions
from simnfnd.models.networks.network import Network
from tests.small_dataset import write_dataset


@dataclass(frozen=True, config=STRICT)
class OneLayerSettings:
    side: int = 3


class OneLayer(Network):
    settings = OneLayerSettings

    def __init__(self, settings: OneLayerSettings) -> None:
        super().__init__(stride=1)
        self.layer = nn.Conv2d(1, 1, settings.side, padding=settings.side // 2)

    def restore(self, noisy: Tensor) -> Tensor:
        output: Tensor = self.layer(noisy)
        return output


@pytest.mark.slow
def test_own_network_trains_and_denoises(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(extensions, "_registered", {})
    monkeypatch.setattr("sys.argv", ["simnfnd"])
    register_network("one_layer", OneLayer)
    dataset = write_dataset(tmp_path / "data", train=24, test=4, size=48)
    out = tmp_path / "model"
    words = [f"dataset={dataset}", f"out={out}", "model=one_layer", "train.steps=4"]
    more = ["model.side=5", "train.check_every=2", "data.patch=16", "data.batch=2"]
    assert main(["train", *words, *more]) == 0, capfd.readouterr().err
    assert "side: 5" in (out / "config.yaml").read_text()
    image = tmp_path / "a.png"
    cv2.imwrite(str(image), np.random.default_rng(0).integers(0, 99, (40, 50), np.uint8))
    denoise = ["denoise", str(image), "--weights", str(out), "--out", str(tmp_path / "out")]
    assert main(denoise) == 0, capfd.readouterr().err
