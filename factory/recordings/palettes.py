"""Colours of sonar displays: the levels that a colour map painted, and the way back.

Programs of sonars save pictures in colours, and a level of echo has one colour of a map.  Noise was
in the levels, and only levels have means: between the blue and the red of a map lies its green, and
between these colours themselves a violet that the map does not hold.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt

from simnfnd.factory.recordings.base import FULL_SCALE, Samples

Colours = npt.NDArray[np.float32]
"""(N, 3), 0 to 255."""
Levels = npt.NDArray[np.float32]

_MAPS = (
    *("JET", "TURBO", "RAINBOW", "PARULA", "VIRIDIS", "PLASMA", "INFERNO", "MAGMA", "CIVIDIS"),
    *("DEEPGREEN", "OCEAN", "HOT", "BONE", "PINK", "AUTUMN", "WINTER", "SUMMER", "SPRING", "COOL"),
)
"""Of OpenCV; those that end as they begin are no scale of levels."""
_LOOKED_AT = 4000  # pixels from which a map is told
_FLAT = 0.1  # part of the pixels from which one colour counts as background
_NEAR, _BLURRED = 12.0, 36.0  # of 255: how far pixels may lie beside a map; JPEG mixes colours
_ENOUGH = 0.9  # part of the pixels that must be of the map
_LEAST = 64  # pixels beside the background
_STEPS = 128  # of the sum of the channels
_HALF_STEP = 0.5 / 255
_MIXED, _MIXED_SHARE = 2.0, 0.1  # so far beside a map, of 255, lie so many where colours were mixed
_SPECK, _SPECK_MIXED = 100, 30  # pixels of a mark in a sonar picture, and of what mixing leaves
_SPECK_AROUND = 7  # pixels a side


@dataclass(frozen=True, eq=False)
class Palette:
    """A colour map.

    name: of a known map; else `sum`: the levels are the means of the three channels.
    colours: (N, 3), the levels lie evenly from 0 to 1, or as `at` says.  at: (N,) ascending.
    """

    name: str
    colours: Colours
    at: Levels

    def levels(self, colours: Colours) -> Levels:
        """(N,) levels of colours, those of the nearest colours of the map."""
        if self.name == SUM:
            return np.asarray(colours.mean(axis=1) / np.float32(255))
        return self.at[_nearest(colours, self.colours)]

    def painted(self, levels: Levels) -> Colours:
        """(..., 3) colours of levels, between the map's own in proportion."""
        channels = [np.interp(levels, self.at, self.colours[:, k]) for k in range(3)]
        return np.stack(channels, axis=-1).astype(np.float32)

    def misses(self, colours: Colours) -> npt.NDArray[np.float32]:
        """(N,) root mean square distance of the channels from the map, of 255."""
        away = colours - self.painted(self.levels(colours))
        return np.asarray(np.sqrt(np.square(away).mean(axis=1)))


SUM = "sum"


@dataclass(frozen=True, eq=False)
class Painted:
    """A picture whose colours stand for levels.

    picture: (H, W, C) as it is stored.  levels: (H, W) in 0..1.  known: (H, W), False where a
    colour is none of the map: a line of text, the page around the fan; the level is 0 there, or, of
    a small mark, that of its surroundings.
    """

    picture: Samples
    palette: Palette
    levels: Levels
    known: npt.NDArray[np.bool_]

    def repainted(self, levels: Levels) -> Samples:
        """The picture with other levels, (H, W); what did not change keeps its very colours."""
        full = FULL_SCALE[str(self.picture.dtype)]
        changed = self.known & (np.abs(levels - self.levels) >= _HALF_STEP)
        colours = self.palette.painted(levels[changed]) * np.float32(full / 255)
        if full > 1:
            colours = np.rint(colours)
        result = self.picture.copy()
        result[changed, :3] = colours.astype(result.dtype)
        return result


def find_painted(picture: Samples, before: Palette | None = None) -> Painted | None:
    """The levels of a picture in colours; None for a grey one, and for colours of no map.

    picture: (H, W, C) uint8, uint16 or float32, red or blue first.  before: the map of the picture
    before it; a known one is kept where it fits.  A known map is told by its colours; of others
    each sum of the three channels must have one colour.
    """
    if picture.ndim != 3 or picture.shape[2] not in (3, 4) or str(picture.dtype) not in FULL_SCALE:
        return None
    flat = picture[..., :3].reshape(-1, 3)
    if not len(flat) or (flat == flat[:, :1]).all():
        return None
    if picture.dtype == np.float32 and not (flat.min() >= 0 and flat.max() <= 1):
        return None
    codes = _codes(flat)
    seen = _foreground(codes)
    if len(seen) < _LEAST:
        return None
    # What is known of another map ends with the brightest colour of that picture.
    kept = before is not None and before.name != SUM and _fits(before, seen, _NEAR)
    palette = before if kept else _palette_of(seen)
    if palette is None:
        return None
    # Few colours stand for many pixels.
    codes, place = np.unique(codes, return_inverse=True)
    colours = _uncoded(codes)
    misses = palette.misses(colours)
    near = misses <= _BLURRED
    levels = np.where(near, palette.levels(colours), 0).astype(np.float32)
    mixed = float((misses[place] > _MIXED).mean()) > _MIXED_SHARE
    shape = picture.shape[:2]
    return Painted(
        picture,
        palette,
        *_without_specks(levels[place].reshape(shape), near[place].reshape(shape), mixed),
    )


def _without_specks(
    levels: Levels, known: npt.NDArray[np.bool_], mixed: bool
) -> tuple[Levels, npt.NDArray[np.bool_]]:
    """Levels and what is known of them where single pixels are of no map.

    They get the mean of what is known around them, else weights would see black specks; where JPEG
    or a video mixed the colours they are levels like others, elsewhere a mark that somebody drew.
    """
    if known.all() or not known.any():
        return levels, known
    import cv2  # an extra, as are pictures with colours

    _, parts, stats, _ = cv2.connectedComponentsWithStats((~known).astype(np.uint8), connectivity=8)
    area = np.where(known, 0, stats[parts, cv2.CC_STAT_AREA])
    small = (area > 0) & (area <= _SPECK)
    around = (_SPECK_AROUND, _SPECK_AROUND)
    there = cv2.boxFilter(known.astype(np.float32), -1, around)
    mean = cv2.boxFilter(levels * known, -1, around) / np.maximum(there, 1e-6)
    filled = np.where(small & (there > 0.01), mean, levels).astype(np.float32)
    return filled, known | (small & (area <= _SPECK_MIXED) & (there > 0.01) & mixed)


def grey_of_colours(picture: Samples) -> Levels:
    """(H, W) float32 in 0..1 of (H, W, C) colours, blue first: levels of a map, else luminance.

    Equal channels stay exactly what they are.
    """
    scaled = picture.astype(np.float32) / np.float32(FULL_SCALE[str(picture.dtype)])
    if picture.shape[2] < 3 or (picture[..., :3] == picture[..., :1]).all():
        return np.ascontiguousarray(scaled[..., 0])
    found = find_painted(picture)
    if found is not None:
        return found.levels
    import cv2  # an extra, as are pictures with colours

    return np.asarray(cv2.cvtColor(np.ascontiguousarray(scaled[..., :3]), cv2.COLOR_BGR2GRAY))


def _palette_of(seen: Colours) -> Palette | None:
    """The map that fits best; a known one where another fits hardly better."""
    own = _by_sums(seen)
    fit = {one: one.misses(seen).mean() for one in (*_known(), own) if _fits(one, seen, _NEAR)}
    if not fit:
        # JPEG of half the quality lies 9 beside a map on average, a murky photograph 14.
        blurred = {one: one.misses(seen).mean() for one in _known() if _fits(one, seen, _BLURRED)}
        fit = {one: miss for one, miss in blurred.items() if miss <= _NEAR}
    return min(fit, key=lambda one: fit[one] + (one is own), default=None)


def _fits(palette: Palette, seen: Colours, near: float) -> bool:
    few = seen[:: max(1, len(seen) // 300)]
    return all(float((palette.misses(some) <= near).mean()) >= _ENOUGH for some in (few, seen))


@cache
def _known() -> tuple[Palette, ...]:
    """Maps of OpenCV, blue first and red first; none without OpenCV."""
    try:
        import cv2  # an extra
    except ImportError:
        return ()
    ramp = np.arange(256, dtype=np.uint8)[:, None]
    at = (np.arange(256) / 255).astype(np.float32)
    found = []
    for name in _MAPS:
        colours = cv2.applyColorMap(ramp, getattr(cv2, f"COLORMAP_{name}"))[:, 0].astype(np.float32)
        found += [
            Palette(name.lower(), np.ascontiguousarray(one), at)
            for one in (colours, colours[:, ::-1])
        ]
    return tuple(found)


def _by_sums(seen: Colours) -> Palette:
    """The mean colour of each step of the channels' sum, and black at its foot."""
    step = np.minimum(seen.mean(axis=1) * (_STEPS / 256), _STEPS - 1).astype(np.int64)
    count = np.bincount(step, minlength=_STEPS)
    there = count > 0
    means = [np.bincount(step, seen[:, k], _STEPS)[there] / count[there] for k in range(3)]
    colours = np.insert(np.stack(means, axis=1), 0, 0, axis=0).astype(np.float32)
    return Palette(SUM, colours, colours.mean(axis=1) / np.float32(255))


def _foreground(codes: npt.NDArray[np.uint32]) -> Colours:
    """(N, 3) colours of pixels spread evenly, without those of flat areas."""
    some = codes[:: max(1, len(codes) // (8 * _LOOKED_AT))]
    _, place, count = np.unique(some, return_inverse=True, return_counts=True)
    rare = some[count[place] <= _FLAT * len(some)]
    return _uncoded(rare[:: max(1, len(rare) // _LOOKED_AT)])


def _codes(flat: npt.NDArray[Any]) -> npt.NDArray[np.uint32]:
    """(N,) one number a colour, its channels rounded to 8 bits."""
    scale = 255 / FULL_SCALE[str(flat.dtype)]
    channels = np.rint(np.clip(flat * np.float32(scale), 0, 255)).astype(np.uint32)
    return np.asarray(channels[:, 0] | channels[:, 1] << 8 | channels[:, 2] << 16)


def _uncoded(codes: npt.NDArray[np.uint32]) -> Colours:
    channels = [codes >> shift & 255 for shift in (0, 8, 16)]
    return np.asarray(np.stack(channels, axis=1), np.float32)


def _nearest(colours: Colours, known: Colours) -> npt.NDArray[np.int64]:
    """(N,) number of the nearest of the known colours; a few thousand at a time."""
    half = np.square(known).sum(axis=1) / 2
    parts = [
        np.argmin(half - colours[start : start + 8192] @ known.T, axis=1)
        for start in range(0, len(colours), 8192)
    ]
    return np.concatenate(parts) if parts else np.zeros(0, np.int64)
