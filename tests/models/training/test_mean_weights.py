"""Means of weights along a chain of trainings."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from simnfnd.factory.errors import FactoryError
from simnfnd.models.networks import build_network
from simnfnd.models.networks.weights import load_weights, save_weights
from tools.mean_weights import mean

SMALL = {
    "kind": "sonarnet",
    "widths": [4, 6],
    "blocks": [1, 1],
    "polar": False,
    "lines": False,
    "mask": True,
    "forget": 0.0,
}


def written(path: Path, seed: int, blocks: list[int], lines: bool = False) -> str:
    torch.manual_seed(seed)
    model = {**SMALL, "blocks": blocks, "lines": lines}
    network = build_network(model)
    for weights in network.parameters():
        torch.nn.init.normal_(weights, std=0.1)
    save_weights(path, network, model, {"seed": seed})
    return str(path)


def test_the_mean_of_two_and_a_grown_one(tmp_path: Path) -> None:
    small = written(tmp_path / "small.safetensors", 1, [1, 1])
    large = written(tmp_path / "large.safetensors", 2, [1, 2], lines=True)
    out = tmp_path / "mean.safetensors"
    mean({large: 0.75, small: 0.25}, out)
    found, (old, new) = load_weights(out), map(load_weights, (small, large))
    assert found.model["blocks"] == [1, 2]
    assert found.training["seed"] == 2
    assert sorted(found.training["mean"].values()) == [0.25, 0.75]
    one, other, both = (each.network.state_dict() for each in (old, new, found))
    for key, value in both.items():
        if key in one:
            torch.testing.assert_close(value, 0.25 * one[key] + 0.75 * other[key])
        else:
            share = 0.75 if ".second." in key or ".added." in key else 1.0
            torch.testing.assert_close(value, share * other[key])
    mean({large: 0.0, small: 1.0}, out)
    picture = torch.rand(1, 1, 16, 20)
    expected = old.network.restore_with_heads(picture).image
    torch.testing.assert_close(
        load_weights(out).network.restore_with_heads(picture).image, expected
    )


def test_weights_that_have_no_mean(tmp_path: Path) -> None:
    small = written(tmp_path / "small.safetensors", 1, [1, 1])
    large = written(tmp_path / "large.safetensors", 2, [1, 2])
    with pytest.raises(FactoryError, match=r"large\.safetensors: holds"):
        mean({small: 0.5, large: 0.5}, tmp_path / "mean.safetensors")
    with pytest.raises(FactoryError, match=r"add up to 1\.25"):
        mean({large: 0.75, small: 0.5}, tmp_path / "mean.safetensors")
    assert not (tmp_path / "mean.safetensors").exists()
