"""The networks: shapes, sizes, what they are told, and that each of them learns."""

from __future__ import annotations

import json
import math
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import yaml
from safetensors.torch import save
from torch import Tensor

from simnfnd.factory.errors import FactoryError
from simnfnd.factory.sonar.fan import fan_table, pixel_size
from simnfnd.factory.sonar.settings import ImageSettings, SonarSettings
from simnfnd.models.networks import NETWORKS, build_network, cost
from simnfnd.models.networks.cost import count_macs, example, measure
from simnfnd.models.networks.network import Network
from simnfnd.models.networks.polar import polar_grid
from simnfnd.models.networks.restormer import ChannelAttention
from simnfnd.models.networks.sonarnet import SonarNet
from simnfnd.models.networks.weights import FORMAT, load_weights, save_weights
from simnfnd.models.removal import DEFAULT, vector
from tests.project_files import ROOT

TINY: dict[str, dict[str, Any]] = {
    "ap_bsn": {"width": 8, "modules": 1, "train_stride": 2, "use_stride": 1, "passes": 2},
    "dae": {"widths": [8, 16]},
    "dgp_srgan": {
        **{"width": 8, "blocks": 2, "critic_width": 4},
        **{"adversarial": 0.001, "penalty": 10.0},
    },
    "kdlae": {"frames": 3, "widths": [8, 8], "blocks": 1},
    "nafnet": {"width": 4, "encoder": [1, 1], "middle": 1, "decoder": [1, 1]},
    "restormer": {
        **{"width": 8, "blocks": [1, 1, 1], "refinement": 1},
        **{"heads": [1, 2, 4], "expansion": 2.0},
    },
    "sid_tgan": {
        **{"width": 4, "blocks": 1, "heads": 2, "critic_width": 4},
        **{"style": 1.0, "similarity": 0.1, "adversarial": 0.01},
    },
    "sonarnet": {
        **{"widths": [8, 12], "blocks": [1, 1]},
        **{"polar": True, "lines": True, "mask": True, "forget": 0.1},
    },
    "three_stage": {"width": 8, "growth": 4, "blocks": 1, "full_blocks": 1},
    "unet": {"widths": [4, 8], "blocks": 1},
}
KINDS = sorted(NETWORKS)
SHIPPED = {
    kind: yaml.safe_load((ROOT / f"conf/model/{kind}.yaml").read_text(encoding="utf-8"))
    for kind in KINDS
}


@pytest.fixture(autouse=True, scope="module")
def one_thread() -> None:
    torch.set_num_threads(1)


def tiny(kind: str, **changes: Any) -> Network:
    torch.manual_seed(0)
    return build_network({"kind": kind, **TINY[kind], **changes}).eval()


def stirred(network: Network) -> Network:
    """The same with all weights away from where training begins (some begin at zero)."""
    source = torch.Generator().manual_seed(1)
    with torch.no_grad():
        for weights in network.parameters():
            weights.add_(0.1 * torch.randn(weights.shape, generator=source))
    return network


def test_every_network_is_tried_here() -> None:
    assert sorted(TINY) == KINDS


# --- the contract of all networks


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("size", [(1, 1), (17, 30), (48, 64), (33, 5)])
def test_any_size(kind: str, size: tuple[int, int]) -> None:
    image = torch.rand(2, 1, *size)
    restored = stirred(tiny(kind))(image)
    assert restored.shape == image.shape
    assert torch.isfinite(restored).all()


@pytest.mark.parametrize("kind", KINDS)
def test_colours_are_images_of_their_own(kind: str) -> None:
    network, colours = stirred(tiny(kind)), torch.rand(2, 3, 16, 24)
    restored = network(colours)
    assert restored.shape == colours.shape
    for channel in range(3):
        alone = network(colours[:, channel : channel + 1])
        torch.testing.assert_close(restored[:, channel : channel + 1], alone)


@pytest.mark.parametrize("kind", sorted(set(KINDS) - {"sonarnet", "kdlae"}))
def test_a_network_built_for_three_channels_takes_one(kind: str) -> None:
    network = stirred(tiny(kind, channels=3))
    assert network(torch.rand(2, 3, 16, 24)).shape == (2, 3, 16, 24)
    assert network(torch.rand(2, 1, 16, 24)).shape == (2, 1, 16, 24)


@pytest.mark.parametrize("kind", ["nafnet", "restormer", "unet", "dae"])
def test_padding_repeats_the_last_row_and_column(kind: str) -> None:
    network, image = stirred(tiny(kind)), torch.rand(1, 1, 37, 41)
    more = (0, -41 % network.stride, 0, -37 % network.stride)
    larger = torch.nn.functional.pad(image, more, mode="replicate")
    torch.testing.assert_close(network(image), network(larger)[..., :37, :41])


@pytest.mark.parametrize("shape", [(1, 2, 8, 8), (8, 8), (1, 1, 0, 8)])
def test_other_shapes_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="expected"):
        tiny("unet")(torch.zeros(shape))


@pytest.mark.parametrize("kind", KINDS)
def test_every_network_learns(kind: str) -> None:
    """Smooth pictures under heavy haze: a few steps take away half of the error."""
    network = tiny(kind).train()
    source = torch.Generator().manual_seed(2)
    coarse = torch.rand(8, 1, 3, 3, generator=source)
    clean = torch.nn.functional.interpolate(coarse, (16, 16), mode="bilinear") * 0.6
    noisy = clean + 0.3 + 0.05 * torch.randn(clean.shape, generator=source)
    optimizer = torch.optim.AdamW(network.parameters(), lr=0.01)
    for _ in range(40):
        loss = (network(noisy) - clean).square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    with torch.inference_mode():
        left = (network.eval()(noisy) - clean).abs().mean()
    assert left < 0.5 * (noisy - clean).abs().mean()


@pytest.mark.parametrize("kind", KINDS)
def test_weights_on_disk_are_the_network(kind: str, tmp_path: Path) -> None:
    network, image = stirred(tiny(kind)), torch.rand(1, 1, 16, 16)
    config = {"kind": kind, **TINY[kind]}
    save_weights(tmp_path / "w.safetensors", network, config, {})
    loaded = load_weights(tmp_path / "w.safetensors").network.eval()
    torch.testing.assert_close(loaded(image), network(image))


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_weights_that_are_no_numbers_are_refused(tmp_path: Path, value: float) -> None:
    network, path = tiny("nafnet"), tmp_path / "w.safetensors"
    last = list(network.parameters())[-1]
    for tensors in ([last], network.parameters()):
        with torch.no_grad():
            for tensor in tensors:
                tensor.fill_(value)
        save_weights(path, network, {"kind": "nafnet", **TINY["nafnet"]}, {})
        with pytest.raises(FactoryError, match=r"^weights=.*: \S+ holds NaN or infinity") as caught:
            load_weights(path)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "model",
    [{"kind": ["nafnet"]}, {"kind": {"a": 1}}, {"kind": None}, {}, [], "nafnet", 7,
     {"kind": "nafnet", "width": [4]}, {"kind": "nafnet", "encoder": {"a": 1}}],
)  # fmt: skip
def test_a_description_that_makes_no_sense_is_refused(tmp_path: Path, model: Any) -> None:
    path, header = tmp_path / "w.safetensors", {"format": FORMAT, "model": model, "training": {}}
    path.write_bytes(save({"a": torch.zeros(1)}, {"simnfnd": json.dumps(header)}))
    with pytest.raises(FactoryError, match=r"^weights=.*: do not fit their network") as caught:
        load_weights(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("kind", "change", "words"),
    [
        ("nafnet", {"kind": "restormer9"}, r"model\.kind"),
        ("nafnet", {"width": 0}, r"model\.width"),
        ("nafnet", {"decoder": [1]}, "as many of each"),
        ("nafnet", {"depth": 3}, r"model\.depth: unknown key"),
        ("nafnet", {"channels": 2}, r"model\.channels"),
        ("restormer", {"heads": [1, 2]}, "as many of each"),
        ("restormer", {"heads": [1, 3, 4]}, "16 channels cannot be shared by 3 heads"),
        ("restormer", {"width": 7, "heads": [1, 1, 1]}, "width must be even"),
        ("unet", {"widths": [8]}, "two resolutions or more"),
        ("dae", {"widths": []}, "one layer or more"),
        ("sid_tgan", {"heads": 5}, "which 5 heads cannot share"),
        ("sonarnet", {"blocks": [1]}, "as many of each"),
        ("ap_bsn", {"passes": 8}, r"model\.passes"),
        ("dgp_srgan", {"penalty": -1}, r"model\.penalty"),
        ("three_stage", {"width": 2}, r"model\.width"),
        ("kdlae", {"frames": 4}, "frames must be odd"),
        ("kdlae", {"widths": [8]}, "two resolutions or more"),
        ("kdlae", {"channels": 3}, r"model\.channels"),
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
        ("restormer", {"width": 16}, 1.14e6, 6.10),
        ("nafnet", {}, 1.14e6, 1.27),
        ("nafnet", {"width": 32, "encoder": [2, 2, 4, 8], "middle": 12, "decoder": [2] * 4},
         29.2e6, 15.97),
        ("unet", {}, 1.065e6, 4.45),
        ("dae", {}, 0.333e6, 1.40),
        ("sid_tgan", {}, 1.67e6, 4.25),
        ("three_stage", {}, 0.229e6, 6.44),
        ("kdlae", {}, 0.320e6, 6.07),
        ("dgp_srgan", {}, 0.0716e6, 4.67),
        ("ap_bsn", {}, 0.0456e6, 23.73),
        ("ap_bsn", {"passes": 0}, 0.0456e6, 2.966),
    ],
)  # fmt: skip
def test_networks_are_as_large_as_published(
    kind: str, change: dict[str, Any], parameters: float, gmac: float
) -> None:
    """Parameters and 1e9 multiply-accumulates for one gray image of 256x256."""
    network = on_meta({**SHIPPED[kind], **change})
    assert sum(p.numel() for p in network.parameters()) == pytest.approx(parameters, rel=0.005)
    assert count_macs(network, 256) / 1e9 == pytest.approx(gmac, rel=0.005)


def test_the_light_network_costs_a_twentieth_of_restormer() -> None:
    network = build_network(SHIPPED["sonarnet"])
    full = {**SHIPPED["restormer"], "blocks": [4, 6, 6, 8], "refinement": 4}
    assert count_macs(network, 256) <= 0.05 * count_macs(on_meta(full), 256)
    # Half-precision weights are to fit 8 MB.
    assert sum(p.numel() for p in network.parameters()) <= 4e6


def test_counted_operations_are_those_of_the_formula() -> None:
    """Two 3x3 convolutions, and attention between all places of the coarsest resolution."""
    dae = tiny("dae", widths=[5])
    assert count_macs(dae, 32) == 9 * (32 * 32 * 5 + 16 * 16 * 5 * 5 + 32 * 32 * 5)
    few, many = (count_macs(tiny("sid_tgan"), size) for size in (64, 128))
    width = TINY["sid_tgan"]["width"] * 8
    # What grows with the number of pixels squared: two products over the places.
    assert many - 4 * few == 2 * width * ((128 // 8) ** 4 - 4 * (64 // 8) ** 4)


def test_measuring_leaves_the_network_as_it_was() -> None:
    network = tiny("unet").train()
    threads = torch.get_num_threads()
    found = measure(network, gmac_px=32, time_px=32)
    assert found.parameters == sum(p.numel() for p in network.parameters())
    assert found.gmac > 0
    assert found.cpu_ms > 0
    assert network.training
    assert torch.get_num_threads() == threads


def test_the_table_of_costs_is_printed(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(cost, "NETWORKS", {"dae": NETWORKS["dae"]})
    monkeypatch.setattr(cost, "cpu_seconds", lambda network, size_px: 0.1234)
    assert cost.main() == 0
    assert capsys.readouterr().out.splitlines()[2:] == ["| dae | 0.33 | 1.40 | 123 |"]


# --- single networks


def test_channel_attention_is_the_formula_of_the_paper() -> None:
    """V softmax(temperature K Q), head by head, with unit vectors over the pixels."""
    torch.manual_seed(0)
    attention, x = ChannelAttention(8, heads=2), torch.randn(2, 8, 5, 6)
    with torch.no_grad():
        attention.temperature.copy_(torch.tensor([0.7, 3.0]).reshape(2, 1, 1))
        planes = attention.depth(attention.point(x)).flatten(2)
        mixed = []
        for head in range(2):
            part = slice(4 * head, 4 * head + 4)
            query, key, value = (planes[:, 8 * i : 8 * i + 8][:, part] for i in range(3))
            query = query / query.square().sum(-1, keepdim=True).sqrt()
            key = key / key.square().sum(-1, keepdim=True).sqrt()
            scores = torch.einsum("ncp,ndp->ncd", query, key) * attention.temperature[head]
            mixed.append(torch.einsum("ncd,ndp->ncp", scores.softmax(-1), value))
        expected = attention.project(torch.cat(mixed, dim=1).reshape(2, 8, 5, 6))
        torch.testing.assert_close(attention(x), expected)


def told(network: Network, size: int) -> tuple[Tensor, dict[str, Tensor]]:
    image, extras = example(network, size)
    return image * extras["sector"], extras


def test_only_what_a_network_uses_is_taken() -> None:
    with pytest.raises(TypeError, match="UNet does not use sector"):
        tiny("unet")(torch.zeros(1, 1, 8, 8), sector=torch.ones(1, 1, 8, 8))
    with pytest.raises(TypeError, match="UNet has no heads"):
        tiny("unet").with_heads(torch.zeros(1, 1, 8, 8))
    network = stirred(tiny("sonarnet"))
    image, extras = told(network, 32)
    nothing = {name: None for name in extras}
    assert torch.equal(network(image, **nothing), network(image))
    assert not torch.allclose(network(image, **extras), network(image))


def test_the_mask_gates_the_picture_inside_the_sector() -> None:
    network = stirred(tiny("sonarnet"))
    image, extras = told(network, 32)
    image = image + 0.1
    restored, logits, _ = network.with_heads(image, **extras)
    outside = extras["sector"] == 0
    assert outside.any()
    assert torch.equal(restored[outside], image[outside])
    assert (logits[outside] < 0).all()
    open_gate = stirred(tiny("sonarnet", mask=False)).with_heads(image, **extras)[0]
    gated = open_gate * torch.sigmoid(-logits)
    torch.testing.assert_close(restored[~outside], gated[~outside])


def test_the_weight_is_the_part_of_the_change_that_a_picture_gets() -> None:
    network = stirred(tiny("sonarnet", forget=0.0))
    assert isinstance(network, SonarNet)
    image, extras = told(network, 32)
    for known in ({}, extras):
        for logit, part in ((-50.0, 0.0), (0.0, 0.5), (50.0, 1.0)):
            with torch.no_grad():
                network.blend.logit.weight.zero_()
                network.blend.logit.bias.fill_(logit)
            whole = network.with_heads(image, **known)
            assert whole.weight.item() == pytest.approx(part)
            torch.testing.assert_close(
                network(image, **known), image + part * (whole.image - image)
            )
        assert not torch.equal(whole.image, image)


def test_what_to_remove_changes_the_picture() -> None:
    network = stirred(tiny("sonarnet"))
    image, extras = told(network, 32)
    usual = network(image, **extras)
    default = torch.from_numpy(vector(DEFAULT))[None]
    assert torch.equal(network(image, **extras, remove=default), usual)
    speckle = torch.from_numpy(vector(["speckle"]))[None]
    assert not torch.allclose(network(image, **extras, remove=speckle), usual)
    with pytest.raises(ValueError, match="'hiss' is none of speckle, haze"):
        vector(["hiss"])


def test_a_network_that_looks_twice_does_not_care_for_left_and_right() -> None:
    network = stirred(tiny("sonarnet", mirror=True))
    once = stirred(tiny("sonarnet"))
    image, extras = told(network, 32)
    turned = {name: plane.flip(-1) for name, plane in extras.items()}
    turned["azimuth_rad"] = -turned["azimuth_rad"]
    for known, mirrored in (({}, {}), (extras, turned)):
        both, logits, weight = network.with_heads(image, **known)
        first, second = once.with_heads(image, **known), once.with_heads(image.flip(-1), **mirrored)
        torch.testing.assert_close(both, (first.image + second.image.flip(-1)) / 2)
        torch.testing.assert_close(weight, (first.weight + second.weight) / 2)
        again = network.with_heads(image.flip(-1), **mirrored)
        torch.testing.assert_close(again.image.flip(-1), both)
        torch.testing.assert_close(again.shadow_logits.flip(-1), logits)


def test_geometry_is_forgotten_in_training_alone() -> None:
    network = stirred(tiny("sonarnet", forget=1.0))
    image, extras = told(network, 32)
    blind, seeing = network(image), network(image, **extras)
    assert torch.equal(network.train()(image, **extras), blind)
    assert not torch.allclose(blind, seeing)


def test_colours_share_one_mask_and_one_geometry() -> None:
    network = stirred(tiny("sonarnet"))
    image, extras = told(network, 32)
    colours = image.expand(-1, 3, -1, -1)
    restored, logits, weight = network.with_heads(colours, **extras)
    alone, mask, of_one = network.with_heads(image, **extras)
    torch.testing.assert_close(weight, of_one)
    torch.testing.assert_close(restored, alone.expand(-1, 3, -1, -1))
    torch.testing.assert_close(logits, mask)


def test_configs_are_those_of_the_registry() -> None:
    found = {path.stem for path in (ROOT / "conf" / "model").glob("*.yaml")}
    assert found == set(KINDS)
    for kind, config in SHIPPED.items():
        assert config["kind"] == kind
        module, settings_name, _ = NETWORKS[kind]
        fields = getattr(import_module(module), settings_name).__dataclass_fields__
        assert set(config) == set(fields)


# --- polar inside


def fan_and_polar() -> tuple[Tensor, Tensor, dict[str, Tensor]]:
    """A smooth polar picture, the factory's fan picture of it, and the maps of the fan."""
    rows, columns, near = 80, 96, 0.3
    sonar = SonarSettings(
        name="test", frequency_khz=900, hfov_deg=60, vfov_deg=20, beams=columns, range_bins=rows,
        image=ImageSettings(width_px=columns, height_px=rows),
    )  # fmt: skip
    u, v = np.meshgrid(np.linspace(0, 1, rows), np.linspace(0, 1, columns), indexing="ij")
    polar = 0.5 + 0.25 * np.sin(7 * u + 2) + 0.25 * np.cos(9 * v * (1 + u))
    fan = fan_table(sonar, near).bilinear(polar)
    pixel = pixel_size(sonar, near)
    ahead = 1 - (np.arange(rows)[:, None] + 0.5) * pixel
    right = (np.arange(columns)[None] + 0.5 - columns / 2) * pixel
    maps = {
        "range_fraction": np.hypot(ahead, right),
        "azimuth_rad": np.arctan2(right, ahead),
        "sector": (fan > 0).astype(float),
    }
    tensors = {name: torch.tensor(x, dtype=torch.float32)[None, None] for name, x in maps.items()}
    return (
        torch.tensor(polar, dtype=torch.float32)[None, None],
        torch.from_numpy(fan)[None, None],
        tensors,
    )


def test_the_polar_grid_is_the_factorys() -> None:
    polar, fan, maps = fan_and_polar()
    grid = polar_grid(**maps, fan=None)
    assert grid is not None
    seen = grid.polar(fan)
    # Away from the edges, where the fan ends between two pixels.
    inner = np.s_[..., 4:-4, 4:-4]
    assert (seen - polar)[inner].abs().max() < 0.02
    near_row, far_row = grid.range_fraction[0, 0, [0, -1], 0].tolist()
    assert near_row == pytest.approx(0.3, abs=0.02)
    assert far_row == pytest.approx(1.0, abs=0.02)
    bearings = grid.azimuth_rad[0, 0, 0, [0, -1]].tolist()
    assert bearings == pytest.approx([-math.pi / 6, math.pi / 6], abs=0.02)


def test_there_and_back_is_the_same_picture() -> None:
    _, fan, maps = fan_and_polar()
    grid = polar_grid(**maps, fan=None)
    assert grid is not None
    inside = torch.nn.functional.max_pool2d(1 - maps["sector"], 7, stride=1, padding=3) == 0
    difference = (grid.fan(grid.polar(fan)) - fan)[inside].abs()
    assert difference.max() < 0.02


def test_a_mirrored_picture_has_the_mirrored_grid() -> None:
    _, fan, maps = fan_and_polar()
    grid = polar_grid(**maps, fan=None)
    flipped = {name: x.flip(-1) for name, x in maps.items()}
    flipped["azimuth_rad"] = -flipped["azimuth_rad"]
    mirrored = polar_grid(**flipped, fan=None)
    assert grid is not None
    assert mirrored is not None
    torch.testing.assert_close(
        mirrored.polar(fan.flip(-1)), grid.polar(fan).flip(-1), atol=1e-4, rtol=0
    )


def test_polar_pictures_and_single_pixels_stay_as_they_are() -> None:
    rows = torch.linspace(0.2, 1, 8)[None, None, :, None].expand(1, 1, 8, 6)
    columns = torch.linspace(-0.3, 0.3, 6)[None, None, None].expand(1, 1, 8, 6)
    assert polar_grid(rows, columns, torch.ones(1, 1, 8, 6)) is None
    one = torch.full((1, 1, 1, 1), 0.5)
    assert polar_grid(one, one, one) is None


def test_a_window_without_sector_is_as_good_as_any() -> None:
    network = stirred(tiny("sonarnet"))
    image, extras = told(network, 32)
    nothing = {**extras, "sector": torch.zeros_like(image)}
    restored, logits, leave = network.with_heads(image, **nothing)
    assert torch.isfinite(leave).all()
    assert torch.equal(restored, image)
    assert torch.isfinite(logits).all()
