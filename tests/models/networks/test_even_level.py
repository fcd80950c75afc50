"""The local level by which a network sees an image evenly bright."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from simnfnd.factory.common.errors import FactoryError
from simnfnd.models.networks import build_network
from simnfnd.models.networks.even_level import CELL_PX, evening_gain

MODEL = {
    "kind": "sonarnet", "widths": [4, 6, 8], "blocks": [0, 0, 1], "polar": False, "lines": True,
    "mask": True, "forget": 0.1, "frames": True, "even_level": True,
}  # fmt: skip


def speckle(height: int = 256, width: int = 128) -> Tensor:
    generator = torch.Generator().manual_seed(0)
    return 0.1 + 0.1 * torch.rand(1, 1, height, width, generator=generator)


def test_parts_of_an_image_are_seen_equally_bright() -> None:
    image = speckle()
    image[..., 128:, :] *= 4
    even = image * evening_gain(image, torch.ones_like(image))
    means = even.unfold(2, 32, 32).mean(dim=(0, 1, 3, 4))
    inner = torch.cat([means[:3], means[5:]])  # without the rows around the step
    assert inner.min() / inner.max() > 0.9
    assert float(even.mean()) == pytest.approx(0.25, abs=0.02)


def test_a_gain_over_one_part_changes_no_level_elsewhere() -> None:
    image = speckle()
    brighter = image.clone()
    brighter[..., 160:, :] *= 3
    ones = torch.ones_like(image)
    changed = (evening_gain(brighter, ones) / evening_gain(image, ones) - 1).abs()
    reach = 4 * CELL_PX + CELL_PX // 2
    assert float(changed[..., : 160 - reach, :].max()) < 1e-5
    assert float(changed[..., 168:, :].max()) > 0.5


def test_darkness_outside_the_sector_makes_nothing_brighter() -> None:
    image = speckle()
    sector = torch.ones_like(image)
    sector[..., 64:] = 0
    gain = evening_gain(image * sector, sector)
    whole = evening_gain(image, torch.ones_like(image))
    assert float((gain / whole - 1).abs()[..., :48].max()) < 0.05


def trained_looking(model: dict[str, object]) -> torch.nn.Module:
    torch.manual_seed(1)
    network = build_network(model)
    for parameter in network.parameters():
        parameter.data.add_(torch.randn_like(parameter), alpha=0.1)
    return network.eval()


def test_the_change_of_an_image_is_in_proportion_to_its_gain() -> None:
    """But for the floor under dark levels and for saturation."""
    image = speckle(96, 96)
    network = trained_looking(MODEL)
    plain = trained_looking({**MODEL, "even_level": False})
    with torch.inference_mode():
        change, brighter_change = (network(x) - x for x in (image, 3 * image))
        relative = float((brighter_change - 3 * change).norm() / (3 * change).norm())
        plain_change, plain_brighter = (plain(x) - x for x in (image, 3 * image))
        plain_relative = float((plain_brighter - 3 * plain_change).norm() / plain_brighter.norm())
    assert float(change.abs().max()) > 0.01
    assert relative < 0.2
    assert relative < plain_relative


def test_too_few_resolutions_are_refused() -> None:
    with pytest.raises(FactoryError, match="even_level"):
        build_network({**MODEL, "widths": [4, 6], "blocks": [0, 1]})
