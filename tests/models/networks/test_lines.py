"""Means along beams and arcs, on grids and on fans."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from simnfnd.models.networks.sonarnet import GridLines, LineContext, MapLines


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


def test_what_lies_outside_the_sector_counts_for_nothing() -> None:
    azimuth, radius, sector = fan(32)
    lines = MapLines.of(azimuth, radius, sector, (32, 32))
    x = torch.rand(1, 2, 32, 32)
    outside = x + 5 * (1 - sector)
    torch.testing.assert_close(lines.beam_means(outside), lines.beam_means(x))
    nothing = MapLines.of(azimuth, radius, torch.zeros_like(sector), (32, 32))
    assert not nothing.beam_means(x).any()


def test_the_context_starts_as_nothing_and_then_sees_whole_lines() -> None:
    torch.manual_seed(0)
    context, x = LineContext(4, 3), torch.rand(1, 4, 24, 24)
    lines = GridLines()
    assert torch.equal(context(x, lines), x)
    torch.nn.init.normal_(context.added.weight)
    changed = x.clone()
    changed[..., 0, 12] += 1
    seen = (context(changed, lines) - context(x, lines)).abs().sum(1)[0] > 1e-6
    # One cell of a beam and of an arc: all of both, and some neighbours of either.
    assert seen[:, 12].all()
    assert seen[0].all()
    assert not seen[20, 0]
