"""`simnfnd physics`: its statistics know speckle, its pictures show something."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from simnfnd.factory.commands import physics
from simnfnd.factory.errors import FactoryError
from simnfnd.factory.gallery.statistics import PEERS, statistics

SMALL = [
    "scenes.width=240", "scenes.height=160", "render=analytic", "sonar.image.width_px=128",
    "sonar.image.height_px=128", "sonar.range_bins=96", "sonar.beams=64",
]  # fmt: skip


def test_statistics_of_rayleigh_amplitude() -> None:
    found = statistics(3 * np.random.default_rng(0).rayleigh(size=(500, 400)))
    assert found.enl == pytest.approx(3.66, rel=0.01)
    assert found.ks < 0.004
    assert found.scintillation == pytest.approx(1, rel=0.02)
    assert found.decibels == pytest.approx(5.57, rel=0.01)


def test_statistics_of_what_is_no_speckle() -> None:
    """Gaussian amplitude noise of 20 %, as one of the peers has it."""
    amplitude = np.abs(1 + 0.2 * np.random.default_rng(0).standard_normal(200_000))
    found = statistics(amplitude)
    assert found.enl == pytest.approx(25, rel=0.02)
    assert found.ks > max(0.1, PEERS["NPS-DAVE"][1])


def test_it_draws_devices_and_effects(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    assert len(physics.devices()) == 16
    monkeypatch.setattr(physics, "devices", lambda: ["camera_matched", "aris_explorer_3000"])
    paths = physics.pictures(tmp_path, SMALL)
    assert [path.name for path in paths] == ["presets.png", "physical-effects.png"]
    for path in paths:
        assert np.asarray(Image.open(path).convert("L"), np.float64).std() > 15


def test_another_formation_is_refused() -> None:
    with pytest.raises(FactoryError, match=r"acoustics\.formation must be field"):
        physics.pictures(Path("nowhere"), ["acoustics=points", "noise=simnfnd"])
