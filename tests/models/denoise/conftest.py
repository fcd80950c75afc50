"""What tests of `denoise` share."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from simnfnd.models.denoise import command
from simnfnd.models.networks import build_network
from simnfnd.models.networks.weights import save_weights
from tests.models.denoise.untrained import TINY, Halving


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Weights of an untrained network: it changes images, and by how much can be computed."""
    torch.manual_seed(0)
    path = tmp_path_factory.mktemp("weights") / "weights.safetensors"
    save_weights(path, build_network(TINY), TINY, {})
    return path


@pytest.fixture
def halving(monkeypatch: pytest.MonkeyPatch) -> Halving:
    denoiser = Halving()
    monkeypatch.setattr(command, "Denoiser", lambda *arguments, **named: denoiser)
    return denoiser
