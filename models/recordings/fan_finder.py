"""Finds the geometry of a fan image in the image itself: the outline at which it turns black.

A fan image is lit inside a sector and black outside it, usually with far range on top.  A pixel is
lit with one probability inside the sector and with another outside; the finder takes the outline
with the greatest likelihood, so that holes (shadows, noise that reaches zero) and specks (ringing
of JPEG or MPEG, text) cost little each.  An outline is accepted by the share of it that the image
shows.  If none is accepted, the finder tries quarter turns of the image, then the largest area of
a screen alone, and last a V of white lines, as chart plotters draw it.  The steps are in `fans`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...factory.common.array_types import Array, Bools, UInt8s
from ...factory.dataset.fan_geometry import FanGeometry
from .fans.confidence import measure_confidence
from .fans.drawn_lines import find_drawn_fan
from .fans.fit import fit_sector
from .fans.levels import MAX_BLACK, black_level, grey_bytes, ringing_level
from .fans.lit_area import crop_lit_area, isolate_largest_area
from .fans.sector import Sector

_MIN_SIDE_PX = 32  # of an image
_MIN_CONFIDENCE = 0.7  # share of the outline that must be seen
_MIN_CONFIDENCE_UNUSUAL = 0.8  # of turned fans, and of fans on screens
_MIN_TURNED_SHARE = 0.15  # of the image that a turned fan fills, unlike the mask of some object
_MAX_LIT_OUTSIDE = 0.05  # share of all pixels that may be lit and not in the sector
# Grey levels, of 255, by which the ground of a screen may vary.  Videos need the larger one; it is
# tried last, as it also takes the dark grain of a fan for ground.
_GROUND_SPREADS = 2, 6


def find_geometry(image: Array) -> FanGeometry | None:
    """The fan in (H, W) or (H, W, colours) grey values of any number type, if there is one.

    In pixels and shares of the largest range; metres cannot be seen.
    None for an image without a sector on black or on a bright page, such as a camera image, a polar
    image or a full rectangle.  Raises ValueError for another shape.
    """
    grey = grey_bytes(image)
    if min(grey.shape) < _MIN_SIDE_PX:
        return None
    fan = _find_on_black(grey, _MIN_CONFIDENCE)
    if fan is not None:
        return fan
    for ground_spread in _GROUND_SPREADS:
        area = isolate_largest_area(grey, ground_spread)
        if area is None:
            continue
        fan = _find_on_black(area, _MIN_CONFIDENCE_UNUSUAL)
        if fan is not None:
            return fan
    return find_drawn_fan(grey)


def _find_on_black(grey: UInt8s, min_upright_confidence: float) -> FanGeometry | None:
    """The fan on black, in whichever quarter turn it lies.

    min_upright_confidence: of a fan with far range on top; others need `_MIN_CONFIDENCE_UNUSUAL`.
    """
    upright = _find_upright(grey, min_upright_confidence)
    if upright is not None:
        return upright
    for turns in (2, 1, 3):
        turned = _find_upright(np.rot90(grey, turns), _MIN_CONFIDENCE_UNUSUAL)
        if turned is None:
            continue
        fan = turned.turned_back(turns, *grey.shape)
        if fan.sector_mask(*grey.shape).mean() >= _MIN_TURNED_SHARE:
            return fan
    return None


def _find_upright(grey: UInt8s, min_confidence: float) -> FanGeometry | None:
    """The fan with far range on top; None where none is found with this confidence."""
    grey = np.ascontiguousarray(grey)
    black = black_level(grey)
    if black > MAX_BLACK:
        return None
    crop = crop_lit_area(grey, black)
    sector = fit_sector(crop.grey > black)
    if sector is None:
        return None

    ringing = ringing_level(crop.grey, sector)
    if ringing > black:
        refitted = fit_sector(crop.grey > ringing)
        if refitted is not None:
            black = ringing
            sector = refitted
    lit = crop.grey > black
    if not sector.is_plausible() or _lit_outside(lit, sector) > _MAX_LIT_OUTSIDE:
        return None

    fan = sector.to_geometry()
    if measure_confidence(lit, fan) < min_confidence:
        return None
    return replace(fan, apex_x_px=fan.apex_x_px + crop.left, apex_y_px=fan.apex_y_px + crop.top)


def _lit_outside(lit: Bools, sector: Sector) -> float:
    """Share of all pixels that are lit and not in the sector."""
    is_outside = sector.mask(*lit.shape) == 0
    return float((lit & is_outside).mean())
