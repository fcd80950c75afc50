"""SonarNet: what it is told, its mask, its weight, its lines, and the polar grid inside."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter1d
from torch import Tensor

from simnfnd.factory.sonar.fan import fan_table, pixel_size
from simnfnd.factory.sonar.settings import ImageSettings, SonarSettings
from simnfnd.models.networks.network import Network
from simnfnd.models.networks.sonarnet import (
    BlendHead,
    GridLines,
    LineContext,
    MapLines,
    SonarNet,
    polar_grid,
)
from simnfnd.models.removal import DEFAULT, vector
from tests.models.networks.tiny_networks import stirred, tiny


def told(network: Network, size: int) -> tuple[Tensor, dict[str, Tensor]]:
    """A random picture of a fan of 60 degrees that fills it, and what goes with it."""
    image = torch.rand(1, 1, size, size, generator=torch.Generator().manual_seed(0))
    step = (torch.arange(size) + 0.5) / size
    ahead, right = 1 - 0.9 * step[:, None], (step - 0.5)[None]
    radius, azimuth = torch.hypot(ahead, right), torch.atan2(right, ahead)
    sector = ((azimuth.abs() <= torch.pi / 6) & (radius <= 1)).float()
    maps = {"range_fraction": radius, "azimuth_rad": azimuth, "sector": sector}
    extras = {name: x[None, None] for name, x in maps.items() if name in network.extras}
    return image * extras["sector"], extras


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


def test_geometry_is_forgotten_in_training_alone() -> None:
    network = stirred(tiny("sonarnet", forget=1.0))
    image, extras = told(network, 32)
    blind, seeing = network(image), network(image, **extras)
    assert torch.equal(network.train()(image, **extras), blind)
    assert not torch.allclose(blind, seeing)


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


SECTOR = torch.zeros(1, 1, 32, 32)
SECTOR[..., 4:] = 1


def picture(seed: int = 0) -> torch.Tensor:
    """White noise without dark cells, (1, 1, 32, 32)."""
    return 0.1 + 0.9 * torch.rand(1, 1, 32, 32, generator=torch.Generator().manual_seed(seed))


def test_it_learns_which_pictures_are_blurred_along_range() -> None:
    torch.manual_seed(0)
    head, features = BlendHead(2), torch.zeros(8, 2, 16, 16)
    noisy = torch.cat([picture(seed) for seed in range(8)])
    noisy[:4] = torch.from_numpy(gaussian_filter1d(noisy[:4].numpy(), 1.0, axis=2))
    inputs = (features, noisy, torch.zeros_like(noisy), SECTOR.expand(8, -1, -1, -1))
    wanted = torch.tensor([0.9] * 4 + [0.1] * 4)
    optimizer = torch.optim.AdamW(head.parameters(), lr=0.01)
    for _ in range(80):
        optimizer.zero_grad()
        torch.nn.functional.smooth_l1_loss(head(*inputs), wanted).backward()
        optimizer.step()
    assert (head(*inputs) - wanted).abs().max() < 0.2
    # Neither the picture nor the features are made better for its sake.
    given = [features.requires_grad_(), torch.zeros_like(noisy, requires_grad=True)]
    head(given[0], noisy, given[1], inputs[3]).sum().backward()
    assert [x.grad for x in given] == [None, None]


def fan(size: int) -> tuple[Tensor, Tensor, Tensor]:
    """Azimuth, range and sector of a fan of 60 degrees, (1, 1, size, size) each."""
    step = (torch.arange(size) + 0.5) / size
    ahead, right = 1 - 0.9 * step[:, None], (step - 0.5)[None]
    radius, azimuth = torch.hypot(ahead, right), torch.atan2(right, ahead)
    sector = ((azimuth.abs() <= torch.pi / 6) & (radius <= 1)).float()
    return azimuth[None, None], radius[None, None], sector[None, None]


def test_a_grid_gets_what_maps_of_it_would_give() -> None:
    torch.manual_seed(2)
    x, context = torch.rand(2, 4, 7, 5), LineContext(4, 3)
    torch.nn.init.normal_(context.added.weight)
    row, column = (torch.arange(n, dtype=torch.float32) for n in (7, 5))
    radius = row[:, None].expand(2, 1, 7, 5)
    maps = MapLines.of(column.expand(2, 1, 7, 5), radius, torch.ones(2, 1, 7, 5), (7, 5))
    torch.testing.assert_close(context(x, GridLines()), context(x, maps))


def test_a_spoke_of_a_fan_is_one_beam_and_an_arc_one_range() -> None:
    azimuth, radius, sector = fan(64)
    lines = MapLines.of(azimuth, radius, sector, (64, 64))
    spoke = ((azimuth - 0.2).abs() < 0.02).float() * sector
    beams = lines.beam_means(spoke)[0, 0]
    # The sector is 60 degrees wide: 0.2 rad is 69 % of the way.
    assert beams.argmax().item() == pytest.approx(0.69 * 64, abs=1.5)
    assert beams.max() > 0.8
    assert beams.median() < 0.02
    arc = ((radius - 0.6).abs() < 0.02).float() * sector
    assert lines.arc_means(arc)[0, 0].max() > 0.8
    assert lines.beam_means(arc)[0, 0].max() < 0.2
