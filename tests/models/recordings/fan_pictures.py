"""Fan pictures of speckle, and the geometry that they were made with."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from hydra import compose, initialize_config_module
from omegaconf import OmegaConf

from simnfnd.factory.settings import build
from simnfnd.factory.sonar.fan import fan_table
from simnfnd.factory.sonar.geometry import FanGeometry
from simnfnd.factory.sonar.settings import SonarSettings

Grey = npt.NDArray[np.uint8]


def preset(name: str, width: int, height: int) -> SonarSettings:
    """A device of conf/sonar with a fan picture of this size."""
    with initialize_config_module("simnfnd.conf", version_base=None):
        config = compose("factory", [f"sonar={name}"])
    given: Any = OmegaConf.to_container(config.sonar)
    image = {"layout": "fan", "width_px": width, "height_px": height}
    settings: SonarSettings = build(SonarSettings, {**given, "image": image})
    return settings


def fan(sonar: SonarSettings, near: float, holes: bool, seed: int = 0) -> tuple[Grey, FanGeometry]:
    """Speckle with gains along range and across; with holes, half of it is zero, and a shadow."""
    rng = np.random.default_rng(seed)
    polar = rng.rayleigh(0.15, (sonar.range_bins, sonar.beams))
    polar *= (1 + 0.8 * np.sin(np.linspace(0, 9, sonar.range_bins)))[:, None]
    polar *= 0.6 + 0.4 * np.cos(np.linspace(-1.2, 1.2, sonar.beams))
    if holes:
        polar[rng.random(polar.shape) < 0.5] = 0
        polar[sonar.range_bins // 2 :, sonar.beams // 3 : sonar.beams // 2] = 0
    picture = fan_table(sonar, near).bilinear(polar.astype(np.float32))
    grey = np.rint(np.clip(picture, 0, 1) * 255).astype(np.uint8)
    return grey, FanGeometry.from_sonar(sonar, near * 10, 10.0)
