"""Fan images of speckle, the geometry they were made with, and screens that show them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import cv2
import numpy as np

from simnfnd.factory.common.array_types import Array, UInt8s
from simnfnd.factory.dataset.fan_geometry import FanGeometry
from simnfnd.factory.simulation.sonar.fan import fan_table
from simnfnd.factory.simulation.sonar.settings import SonarSettings
from tests.sonar_presets import sonar_preset


@cache
def preset(name: str, width: int, height: int) -> SonarSettings:
    """A device of conf/sonar with a fan image of this size."""
    sonar = sonar_preset(name)
    image = type(sonar.image)(layout="fan", width_px=width, height_px=height)
    return replace(sonar, image=image)


def fan(
    sonar: SonarSettings, near: float, holes: bool, seed: int = 0
) -> tuple[UInt8s, FanGeometry]:
    """Speckle with gains along range and across; with holes, half of it is zero, and a shadow."""
    rng = np.random.default_rng(seed)
    polar = rng.rayleigh(0.15, (sonar.range_bins, sonar.beams))
    polar *= (1 + 0.8 * np.sin(np.linspace(0, 9, sonar.range_bins)))[:, None]
    polar *= 0.6 + 0.4 * np.cos(np.linspace(-1.2, 1.2, sonar.beams))
    if holes:
        polar[rng.random(polar.shape) < 0.5] = 0
        polar[sonar.range_bins // 2 :, sonar.beams // 3 : sonar.beams // 2] = 0
    image = fan_table(sonar, near).bilinear(polar.astype(np.float32))
    grey = np.rint(np.clip(image, 0, 1) * 255).astype(np.uint8)
    return grey, FanGeometry.from_sonar(sonar, near * 10, 10.0)


LEFT = 140
TOP = 30


def screen(fan: Array, inside: Array, ground: tuple[int, int, int]) -> Array:
    """(H, W, 3): a fan, grey or in colours, where `inside`, from (TOP, LEFT) on; text, a panel."""
    height, width = inside.shape
    image = np.full((height + 2 * TOP, width + 2 * LEFT, 3), ground, np.uint8)
    fan = np.repeat(fan[..., None], 3, axis=2) if fan.ndim == 2 else fan
    image[TOP : TOP + height, LEFT : LEFT + width][inside] = fan[inside]
    for line in range(8):
        place = (4, 30 + 24 * line)
        cv2.putText(image, f"Range {line}.5", place, cv2.FONT_HERSHEY_SIMPLEX, 0.4, (255,) * 3)
    right = LEFT + width + 40
    cv2.rectangle(image, (right, 30), (right + 80, 160), (90, 90, 90), -1)
    cv2.putText(image, "123.4", (right + 8, 60), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (255,) * 3)
    return image


def with_rings(image: Array, fan: FanGeometry, colour: tuple[int, int, int]) -> Array:
    """A screen with rings of range and a bearing drawn into its fan."""
    drawn = image.copy()
    apex = round(fan.apex_x_px) + LEFT, round(fan.apex_y_px) + TOP
    half_deg = float(np.rad2deg(fan.sector_rad / 2))
    for part in (0.5, 0.75):
        size = (round(part * fan.far_px),) * 2
        cv2.ellipse(drawn, apex, size, 0, -90 - half_deg, -90 + half_deg, colour, 1)
    cv2.line(drawn, apex, (apex[0], round(apex[1] - fan.far_px)), colour, 1)
    return drawn
