"""All networks: shapes, files, refusals, what they cost, and that each of them learns."""

from __future__ import annotations

import json
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
import torch
import yaml
from safetensors.torch import save

from simnfnd.factory.common.errors import FactoryError
from simnfnd.models.networks import NETWORKS, RIVALS, build_network
from simnfnd.models.networks.network import Network, count_macs
from simnfnd.models.networks.weights import FORMAT, load_weights, save_weights
from tests.models.networks.tiny_networks import TINY, stirred, tiny
from tests.project_files import ROOT

KINDS = sorted({**NETWORKS, **RIVALS})
SHIPPED = {
    kind: yaml.safe_load((ROOT / f"conf/model/{kind}.yaml").read_text(encoding="utf-8"))
    for kind in KINDS
}


# --- the contract of all networks


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("size", [(1, 1), (33, 18)])
def test_any_size(kind: str, size: tuple[int, int]) -> None:
    image = torch.rand(2, 1, *size)
    restored = stirred(tiny(kind))(image)
    assert restored.shape == image.shape
    assert torch.isfinite(restored).all()


def test_weights_of_earlier_versions_are_taken() -> None:
    config = {"kind": "sonarnet", **TINY["sonarnet"]}
    assert build_network({**config, "channels": 1, "mirror": False})
    with pytest.raises(FactoryError, match=r"model\.mirror: unknown key"):
        build_network({**config, "mirror": True})


@pytest.mark.parametrize("kind", KINDS)
def test_every_network_learns(kind: str) -> None:
    """Smooth images under heavy haze: a few steps take away half of the error."""
    network = tiny(kind).train()
    source = torch.Generator().manual_seed(2)
    coarse = torch.rand(8, 1, 3, 3, generator=source)
    clean = torch.nn.functional.interpolate(coarse, (16, 16), mode="bilinear") * 0.6
    noisy = clean + 0.3 + 0.05 * torch.randn(clean.shape, generator=source)
    optimizer = torch.optim.AdamW(network.parameters(), lr=0.01)
    for _ in range(24):
        loss = (network(noisy) - clean).square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    with torch.inference_mode():
        left = (network.eval()(noisy) - clean).abs().mean()
    assert left < 0.5 * (noisy - clean).abs().mean()


@pytest.mark.parametrize("kind", KINDS)
def test_weights_on_disk_are_the_network(kind: str, tmp_path: Path) -> None:
    network = stirred(tiny(kind))
    image = torch.rand(1, 1, 16, 16)
    config = {"kind": kind, **TINY[kind]}
    save_weights(tmp_path / "w.safetensors", network, config, {})
    loaded = load_weights(tmp_path / "w.safetensors").network.eval()
    torch.testing.assert_close(loaded(image), network(image))


def test_weights_that_are_no_numbers_are_refused(tmp_path: Path) -> None:
    network = tiny("nafnet")
    path = tmp_path / "w.safetensors"
    last = list(network.parameters())[-1]
    for tensors in ([last], network.parameters()):
        with torch.no_grad():
            for tensor in tensors:
                tensor.fill_(float("nan"))
        save_weights(path, network, {"kind": "nafnet", **TINY["nafnet"]}, {})
        with pytest.raises(FactoryError, match=r"^weights=.*NaN") as caught:
            load_weights(path)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "model",
    [{"kind": ["nafnet"]}, {"kind": {"a": 1}}, {"kind": None}, {}, [], "nafnet", 7,
     {"kind": "nafnet", "width": [4]}, {"kind": "nafnet", "encoder": {"a": 1}}],
)  # fmt: skip
def test_a_description_that_makes_no_sense_is_refused(tmp_path: Path, model: Any) -> None:
    path = tmp_path / "w.safetensors"
    header = {"format": FORMAT, "model": model, "training": {}}
    path.write_bytes(save({"a": torch.zeros(1)}, {"simnfnd": json.dumps(header)}))
    with pytest.raises(FactoryError, match=r"^weights=.*: .*network") as caught:
        load_weights(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("kind", "change", "words"),
    [
        ("nafnet", {"kind": "restormer9"}, r"model\.kind"),
        ("nafnet", {"width": 0}, r"model\.width"),
        ("nafnet", {"depth": 3}, r"model\.depth: unknown key"),
        ("restormer", {"heads": [1, 3, 4]}, "16 channels cannot be shared by 3 heads"),
        ("restormer", {"width": 7, "heads": [1, 1, 1]}, "width must be even"),
        ("sonarnet", {"blocks": [1]}, "as many of each"),
        ("sid_tgan", {"width": 3, "heads": 7}, "heads cannot share"),
    ],
)
def test_odd_networks_are_refused(kind: str, change: dict[str, Any], words: str) -> None:
    with pytest.raises(FactoryError, match=words):
        build_network({"kind": kind, **TINY[kind], **change})


# --- what they cost


def on_meta(config: dict[str, Any]) -> Network:
    """The network without numbers: its operations can be counted, not computed."""
    with torch.device("meta"):
        return build_network(config)


@pytest.mark.parametrize(
    ("kind", "change", "parameters", "gmac"),
    [
        ("restormer", {"blocks": [4, 6, 6, 8], "refinement": 4}, 26.11e6, 154.7),
        ("restormer", {}, 9.95e6, 50.9),
        ("nafnet", {}, 1.14e6, 1.27),
        ("nafnet", {"width": 32, "encoder": [2, 2, 4, 8], "middle": 12, "decoder": [2] * 4},
         29.2e6, 15.97),
    ],
)  # fmt: skip
def test_networks_are_as_large_as_published(
    kind: str, change: dict[str, Any], parameters: float, gmac: float
) -> None:
    """Parameters and 1e9 multiply-accumulates for one grey image of 256x256."""
    network = on_meta({**SHIPPED[kind], **change})
    assert sum(p.numel() for p in network.parameters()) == pytest.approx(parameters, rel=0.005)
    assert count_macs(network, 256) / 1e9 == pytest.approx(gmac, rel=0.005)


def test_configs_are_those_of_the_registry() -> None:
    actual = {path.stem for path in (ROOT / "conf" / "model").glob("*.yaml")}
    sizes = {"sonarnet_small"}  # of a kind that has a configuration of its own
    assert actual - sizes == set(KINDS) == set(TINY)
    for kind, config in SHIPPED.items():
        assert config["kind"] == kind
        folder = "rivals." if kind in RIVALS else ""
        module = import_module(f"simnfnd.models.networks.{folder}{kind}")
        name = {**NETWORKS, **RIVALS}[kind]
        fields = getattr(module, f"{name}Settings").__dataclass_fields__
        assert set(config) == set(fields)
