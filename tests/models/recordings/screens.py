"""Pictures as screens of sonar software show them: a fan amid text, panels and rings."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from simnfnd.factory.sonar.geometry import FanGeometry

LEFT, TOP = 140, 30
Picture = npt.NDArray[Any]


def screen(fan: Picture, inside: Picture, ground: tuple[int, int, int]) -> Picture:
    """(H, W, 3): a fan, grey or in colours, where `inside`, from (TOP, LEFT) on; text, a panel."""
    height, width = inside.shape
    picture = np.full((height + 2 * TOP, width + 2 * LEFT, 3), ground, np.uint8)
    fan = np.repeat(fan[..., None], 3, axis=2) if fan.ndim == 2 else fan
    picture[TOP : TOP + height, LEFT : LEFT + width][inside] = fan[inside]
    for line in range(8):
        place = (4, 30 + 24 * line)
        cv2.putText(picture, f"Range {line}.5", place, cv2.FONT_HERSHEY_SIMPLEX, 0.4, (255,) * 3)
    right = LEFT + width + 40
    cv2.rectangle(picture, (right, 30), (right + 80, 160), (90, 90, 90), -1)
    cv2.putText(picture, "123.4", (right + 8, 60), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (255,) * 3)
    return picture


def with_rings(picture: Picture, fan: FanGeometry, colour: tuple[int, int, int]) -> Picture:
    """A screen with rings of range and a bearing drawn into its fan."""
    drawn = picture.copy()
    apex = round(fan.apex_x_px) + LEFT, round(fan.apex_y_px) + TOP
    half_deg = float(np.rad2deg(fan.sector_rad / 2))
    for part in (0.5, 0.75):
        size = (round(part * fan.far_px),) * 2
        cv2.ellipse(drawn, apex, size, 0, -90 - half_deg, -90 + half_deg, colour, 1)
    cv2.line(drawn, apex, (apex[0], round(apex[1] - fan.far_px)), colour, 1)
    return drawn
