"""Colours of sonar displays: the levels that a colour map painted, and the way back.

Programs of sonars save images in colours, and a level of echo has one colour of a map.  Noise was
in the levels, and only levels have means: between the blue and the red of a map lies its green, and
between these colours themselves a violet that the map does not hold.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np

from ...factory.common.array_types import Array, Bools, Float32s, UInt32s
from .base import FULL_SCALE

Colours = Float32s
"""(N, 3), 0 to 255."""

# Colour maps of OpenCV, without those that end as they begin: these are no scale of levels.
_MAPS = (
    *("JET", "TURBO", "RAINBOW", "PARULA", "VIRIDIS", "PLASMA", "INFERNO", "MAGMA", "CIVIDIS"),
    *("DEEPGREEN", "OCEAN", "HOT", "BONE", "PINK", "AUTUMN", "WINTER", "SUMMER", "SPRING", "COOL"),
)
_OTHERS = {
    "jet": (
        ((0, 0.11, 0.34, 0.65, 1), (0.5, 1, 1, 0, 0)),
        ((0, 0.125, 0.375, 0.64, 0.91, 1), (0, 0, 1, 1, 0, 0)),
        ((0, 0.35, 0.66, 0.89, 1), (0, 0, 1, 1, 0.5)),
    ),
    "red": (((0, 0.5, 1), (0, 0, 1)), ((0, 0.5, 1), (0, 0, 1)), ((0, 0.5, 1), (0, 1, 1))),
}
"""Levels, and blue, green and red at these, 0 to 1, of Matplotlib's jet (beside OpenCV's by 1.6 of
255 on average), and of chart plotters: black, red, white."""
_LOOKED_AT = 4000  # pixels by which a map is recognised
_FLAT = 0.1  # part of the pixels from which one colour counts as background
_NEAR = 12.0  # of 255: how far the colours of pixels may lie from a map
_BLURRED = 36.0  # the same where JPEG mixed colours
_ENOUGH = 0.9  # part of the pixels that must be of the map
_LEAST = 64  # pixels beside the background
_STEPS = 128  # of the sum of the channels
_HALF_STEP = 0.5 / 255
_MIXED = 2.0  # of 255: colours farther from a map than this were mixed
_MIXED_SHARE = 0.1  # share of such pixels in an image whose colours were mixed
_SPECK = 30  # pixels of what mixing leaves
_STROKE = 7  # pixels: pages and panels are at least as wide, lines are thinner
_GREY = 3.0  # of 255: maximum difference between the channels of a grey image
_COLOURED = 6.0  # of 255: minimum difference between the channels of coloured marks
# How near a known map half of the colours lie where others were drawn over it, and part of the
# pixels that must have colours at all.
_EXACT = 1.5
_EXACT_SHARE = 0.5
_SOME = 0.2


@dataclass(frozen=True, eq=False)
class Palette:
    """A colour map.

    name: of a known map; `grey`, where colours were drawn over a grey image; else `sum`: the
        levels are the means of the three channels.
    colours: (N, 3), the levels lie evenly from 0 to 1, or as `at` says.  at: (N,) ascending.
    """

    name: str
    colours: Colours
    at: Float32s

    def levels(self, colours: Colours) -> Float32s:
        """(N,) levels of colours, those of the nearest colours of the map."""
        if self.name == SUM:
            return np.asarray(colours.mean(axis=1) / np.float32(255))
        half = np.square(self.colours).sum(axis=1) / 2
        parts = np.split(colours, range(8192, len(colours), 8192))
        nearest = [np.argmin(half - part @ self.colours.T, axis=1) for part in parts]
        return np.asarray(self.at[np.concatenate(nearest)])

    def painted(self, levels: Float32s) -> Colours:
        """(..., 3) colours of levels, between the map's own in proportion."""
        channels = [np.interp(levels, self.at, self.colours[:, k]) for k in range(3)]
        return np.asarray(np.stack(channels, axis=-1), np.float32)

    def misses(self, colours: Colours) -> Float32s:
        """(N,) root mean square distance of the channels from the map, of 255."""
        away = colours - self.painted(self.levels(colours))
        return np.asarray(np.sqrt(np.square(away).mean(axis=1)))


SUM = "sum"
GREY = "grey"
NAMES = (*map(str.lower, _MAPS), *_OTHERS, GREY, SUM)
"""Names that a colour map may have."""


@dataclass(frozen=True, eq=False)
class Painted:
    """An image whose colours stand for levels."""

    image: Array  # (H, W, C) as it is stored
    palette: Palette
    levels: Float32s  # (H, W) in 0..1
    known: Bools
    """(H, W), False where a colour is none of the map: a line of text, the page around the fan; the
    level is 0 there, or, of a small mark, that of its surroundings."""

    def repainted(self, levels: Float32s) -> Array:
        """The image with other levels, (H, W); what did not change keeps its very colours."""
        full = FULL_SCALE[str(self.image.dtype)]
        changed = self.known & (np.abs(levels - self.levels) >= _HALF_STEP)
        colours = self.palette.painted(levels[changed]) * np.float32(full / 255)
        if full > 1:
            colours = np.rint(colours)
        result = self.image.copy()
        result[changed, :3] = colours.astype(result.dtype)
        return result


def find_painted(image: Array, before: Palette | None = None) -> Painted | None:
    """The levels of an image in colours; None for a grey one, and for colours of no map.

    image: (H, W, C) uint8, uint16 or float32, red or blue first.  before: the map of the image
    before it; a known one is kept where it fits.  A known map is recognised by its colours; of
    other maps each sum of the three channels must have one colour.
    """
    full = FULL_SCALE.get(str(image.dtype))
    if full is None or image.ndim != 3 or image.shape[2] not in (3, 4):
        return None
    flat = image[..., :3].reshape(-1, 3)
    if (flat == flat[:, :1]).all() or not (flat.min() >= 0 and flat.max() <= full):
        return None
    codes = _codes(flat)
    foreground = _foreground(codes.reshape(image.shape[:2]))
    if len(foreground) < _LEAST:
        return None
    # What is known of another map ends with the brightest colour of that image.
    is_kept = before is not None and before.name != SUM and _fits(before, foreground, _NEAR)
    palette = before if is_kept else _palette_of(foreground)
    if palette is None:
        return None
    # Few colours stand for many pixels.
    codes, place = np.unique(codes, return_inverse=True)
    colours = _uncoded(codes)
    size = (_STROKE, _STROKE)
    shape = image.shape[:2]
    misses = palette.misses(colours)
    near = misses <= (_COLOURED if palette.name == GREY else _BLURRED)
    levels = np.where(near, palette.levels(colours), 0).astype(np.float32)
    levels = levels[place].reshape(shape)
    known = near[place].reshape(shape)
    if known.all() or not known.any():
        return Painted(image, palette, levels, known)
    # Specks, lines and letters of no map get the mean of what is known around them, else weights
    # would see black ones.
    unknown = (~known).astype(np.uint8)
    wide = cv2.morphologyEx(unknown, cv2.MORPH_OPEN, np.ones(size, np.uint8))
    share_known = cv2.blur(known.astype(np.float32), size)
    means = cv2.blur(levels * known, size) / np.maximum(share_known, np.float32(1e-6))
    drawn = (unknown > wide) & (share_known > 0)
    # Where JPEG or a video mixed the colours specks are levels like others, else they were drawn.
    if float((misses[place] > _MIXED).mean()) > _MIXED_SHARE:
        _, parts, stats, _ = cv2.connectedComponentsWithStats(unknown, connectivity=8)
        known = known | (drawn & (stats[parts, cv2.CC_STAT_AREA] <= _SPECK))
    return Painted(image, palette, np.where(drawn, means, levels).astype(np.float32), known)


def grey_of_colours(image: Array) -> Float32s:
    """(H, W) float32 in 0..1 of (H, W, C) colours, blue first: levels of a map, else luminance.

    Equal channels stay exactly what they are.
    """
    scaled = image.astype(np.float32) / np.float32(FULL_SCALE[str(image.dtype)])
    if image.shape[2] < 3 or (image[..., :3] == image[..., :1]).all():
        return np.ascontiguousarray(scaled[..., 0])
    painted = find_painted(image)
    if painted is not None:
        return painted.levels
    return np.asarray(cv2.cvtColor(np.ascontiguousarray(scaled[..., :3]), cv2.COLOR_BGR2GRAY))


def _palette_of(colours: Colours) -> Palette | None:
    """The map that fits best; a known one where another fits hardly better."""
    drawn_over = _exact(colours)
    if drawn_over is not None:
        return drawn_over
    own = _by_sums(colours)
    fit = {
        palette: palette.misses(colours).mean()
        for palette in (*_known(), own)
        if _fits(palette, colours, _NEAR)
    }
    # JPEG of half the quality lies 9 beside a map on average, a murky camera image 14.
    for palette in () if fit else _known():
        if _fits(palette, colours, _BLURRED) and (miss := palette.misses(colours).mean()) <= _NEAR:
            fit[palette] = miss
    return min(fit, key=lambda palette: fit[palette] + (palette is own), default=None)


def _exact(colours: Colours) -> Palette | None:
    """The map, or grey, of most pixels, where marks in other colours are the rest."""
    coloured = colours[np.ptp(colours, axis=1) > _GREY]
    fit: dict[Palette, float] = {}
    if len(coloured) < (1 - _EXACT_SHARE) * len(colours):
        ramp = np.repeat(np.arange(256, dtype=np.float32)[:, None], 3, axis=1)
        fit[Palette(GREY, ramp, ramp[:, 0] / np.float32(255))] = np.inf
    if len(coloured) >= max(_SOME * len(colours), _LEAST):
        few = coloured[:: max(1, len(coloured) // 300)]
        for palette in _known():
            misses = np.minimum(palette.misses(few), _NEAR)
            if (misses <= _EXACT).mean() >= _EXACT_SHARE:
                fit[palette] = misses.mean()
    return min(fit, key=lambda palette: fit[palette], default=None)


def _fits(palette: Palette, colours: Colours, near: float) -> bool:
    few = colours[:: max(1, len(colours) // 300)]
    return all(float((palette.misses(some) <= near).mean()) >= _ENOUGH for some in (few, colours))


@cache
def _known() -> tuple[Palette, ...]:
    """Known maps, blue first and red first."""
    ramp = np.arange(256, dtype=np.uint8)[:, None]
    at = (np.arange(256) / 255).astype(np.float32)
    maps = [
        (name.lower(), cv2.applyColorMap(ramp, getattr(cv2, f"COLORMAP_{name}"))[:, 0])
        for name in _MAPS
    ]
    for name, channels in _OTHERS.items():
        colours = np.stack([np.interp(at, *channel) for channel in channels], axis=1)
        maps.append((name, np.rint(255 * colours)))
    return tuple(
        Palette(name, np.ascontiguousarray(ordered, np.float32), at)
        for name, colours in maps
        for ordered in (colours, colours[:, ::-1])
    )


def _by_sums(pixels: Colours) -> Palette:
    """The mean colour of each step of the channels' sum, and black at its foot."""
    step = np.minimum(pixels.mean(axis=1) * (_STEPS / 256), _STEPS - 1).astype(np.int64)
    count = np.bincount(step, minlength=_STEPS)
    is_present = count > 0
    means = [
        np.bincount(step, pixels[:, k], _STEPS)[is_present] / count[is_present] for k in range(3)
    ]
    colours = np.insert(np.stack(means, axis=1), 0, 0, axis=0).astype(np.float32)
    return Palette(SUM, colours, colours.mean(axis=1) / np.float32(255))


def _foreground(codes: UInt32s) -> Colours:
    """(N, 3) colours of pixels spread evenly, without those of flat areas.  codes: (H, W)."""
    inner = codes[1:-1, 1:-1]
    beside = (codes[:-2, 1:-1], codes[2:, 1:-1], codes[1:-1, :-2], codes[1:-1, 2:])
    grain = inner[np.any([inner != neighbour for neighbour in beside], axis=0)]
    codes = grain if len(grain) >= _LEAST else codes.ravel()
    some = codes[:: max(1, len(codes) // (8 * _LOOKED_AT))]
    _, place, count = np.unique(some, return_inverse=True, return_counts=True)
    rare = some[count[place] <= _FLAT * len(some)]
    return _uncoded(rare[:: max(1, len(rare) // _LOOKED_AT)])


def _codes(flat: Array) -> UInt32s:
    """(N,) one number a colour, its channels rounded to 8 bits."""
    scale = 255 / FULL_SCALE[str(flat.dtype)]
    channels = np.rint(np.clip(flat * np.float32(scale), 0, 255)).astype(np.uint32)
    return np.asarray(channels[:, 0] | channels[:, 1] << 8 | channels[:, 2] << 16)


def _uncoded(codes: UInt32s) -> Colours:
    return np.asarray(np.stack([codes >> k & 255 for k in (0, 8, 16)], axis=1), np.float32)
