"""A network with more parts begins as the one without them whose weights it is given."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch
from hydra import compose, initialize_config_module
from omegaconf import OmegaConf

from simnfnd.factory.errors import FactoryError
from simnfnd.factory.settings import build
from simnfnd.models.networks import build_network
from simnfnd.models.networks.weights import save_weights
from simnfnd.models.settings import ModelsSettings
from simnfnd.models.training.beginning import build_module

WORDS = (
    *("model=sonarnet", "model.widths=[8,8]", "model.lines=false", "model.told=false"),
    "dataset.dir=nowhere",
)


def settings(*words: str) -> ModelsSettings:
    with initialize_config_module("simnfnd.conf", version_base="1.3"):
        composed = compose("models", [*WORDS, *words])
    values: Any = OmegaConf.to_container(composed, resolve=True)
    made: ModelsSettings = build(ModelsSettings, values)
    return made


@pytest.fixture
def shallow(tmp_path: Path) -> Path:
    """Weights of one block a resolution, none of them zero."""
    model = settings("model.blocks=[1,1]").model
    torch.manual_seed(0)
    network = build_network(model)
    for weights in network.parameters():
        torch.nn.init.normal_(weights, std=0.1)
    path = tmp_path / "shallow.safetensors"
    save_weights(path, network, dict(model), {})
    return path


@pytest.mark.parametrize("more", ["model.blocks=[3,2]", "model.lines=true"])
def test_what_a_network_grows_by_changes_nothing_at_first(more: str, shallow: Path) -> None:
    picture = torch.rand(1, 1, 32, 32, generator=torch.Generator().manual_seed(1))
    pictures = []
    for words in ([], [more]):
        module = build_module(settings("model.blocks=[1,1]", f"start='{shallow}'", *words))
        with torch.no_grad():
            pictures.append(module.network.eval()(picture))
    torch.testing.assert_close(pictures[0], pictures[1], rtol=0, atol=1e-6)
    assert (pictures[0] - picture).abs().max() > 0.01


@pytest.mark.parametrize("word", ["model.blocks=[0,1]", "model.widths=[8,12]", "model.told=true"])
def test_what_no_new_part_explains_is_refused(word: str, shallow: Path) -> None:
    words = [f"start='{shallow}'", "model.blocks=[2,1]", word]
    with pytest.raises(FactoryError, match=r"start=.*give both the same sizes"):
        build_module(settings(*words))
