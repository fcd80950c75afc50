"""SonarNet: its conditions, its mask, its weight, and the polar grid inside."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from simnfnd.factory.dataset.fan_geometry import pixel_size
from simnfnd.factory.simulation.sonar.fan import fan_table
from simnfnd.factory.simulation.sonar.settings import ImageSettings, SonarSettings
from simnfnd.models.networks import DEFAULT, vector
from simnfnd.models.networks.network import Network
from simnfnd.models.networks.polar_grid import polar_grid, sampled
from simnfnd.models.networks.sonarnet import SonarNet
from tests.models.networks.tiny_networks import stirred, tiny


def random_inputs(network: Network, size: int) -> tuple[Tensor, dict[str, Tensor]]:
    """A random image of a fan of 60 degrees that fills it, and what goes with it."""
    image = torch.rand(1, 1, size, size, generator=torch.Generator().manual_seed(0))
    step = (torch.arange(size) + 0.5) / size
    ahead = 1 - 0.9 * step[:, None]
    right = (step - 0.5)[None]
    radius = torch.hypot(ahead, right)
    azimuth = torch.atan2(right, ahead)
    sector = ((azimuth.abs() <= torch.pi / 6) & (radius <= 1)).float()
    maps = {"range_fraction": radius, "azimuth_rad": azimuth, "sector": sector}
    extras = {name: x[None, None] for name, x in maps.items() if name in network.extras}
    return image * extras["sector"], extras


def test_the_mask_gates_the_image_inside_the_sector() -> None:
    network = stirred(tiny("sonarnet"))
    image, extras = random_inputs(network, 32)
    image = image + 0.1
    restored, logits, _ = network.with_heads(image, **extras)
    outside = extras["sector"] == 0
    assert outside.any()
    assert torch.equal(restored[outside], image[outside])
    assert (logits[outside] < 0).all()
    open_gate = stirred(tiny("sonarnet", mask=False)).with_heads(image, **extras)[0]
    gated = open_gate * torch.sigmoid(-logits)
    torch.testing.assert_close(restored[~outside], gated[~outside])


def test_the_weight_is_the_part_of_the_change_that_an_image_gets() -> None:
    network = stirred(tiny("sonarnet", forget=0.0))
    assert isinstance(network, SonarNet)
    image, extras = random_inputs(network, 32)
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


def test_what_to_remove_changes_the_image() -> None:
    network = stirred(tiny("sonarnet"))
    image, extras = random_inputs(network, 32)
    usual = network(image, **extras)
    default = torch.from_numpy(vector(DEFAULT))[None]
    assert torch.equal(network(image, **extras, remove=default), usual)
    speckle = torch.from_numpy(vector(["speckle"]))[None]
    assert not torch.allclose(network(image, **extras, remove=speckle), usual)


def test_geometry_is_forgotten_in_training_alone() -> None:
    network = stirred(tiny("sonarnet", forget=0.999999))
    image, extras = random_inputs(network, 32)
    blind = network(image)
    seeing = network(image, **extras)
    assert torch.equal(network.train()(image, **extras), blind)
    assert not torch.allclose(blind, seeing)


# --- polar inside


def fan_and_polar() -> tuple[Tensor, Tensor, dict[str, Tensor]]:
    """A smooth polar image, the factory's fan image of it, and the maps of the fan."""
    rows = 80
    columns = 96
    near = 0.3
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
    observed = sampled(fan, grid.to_polar)
    # Away from the edges, where the fan ends between two pixels.
    inner = np.s_[..., 4:-4, 4:-4]
    assert (observed - polar)[inner].abs().max() < 0.02
    near_row, far_row = grid.range_fraction[0, 0, [0, -1], 0].tolist()
    assert near_row == pytest.approx(0.3, abs=0.02)
    assert far_row == pytest.approx(1.0, abs=0.02)
    bearings = grid.azimuth_rad[0, 0, 0, [0, -1]].tolist()
    assert bearings == pytest.approx([-math.pi / 6, math.pi / 6], abs=0.02)


def test_what_is_always_forgotten_is_no_input() -> None:
    always = {"polar": False, "forget": 1.0}
    assert not {"range_fraction", "azimuth_rad", "sector"} & set(tiny("sonarnet", **always).extras)
    assert "sector" in tiny("sonarnet", polar=False, forget=0.9).extras
