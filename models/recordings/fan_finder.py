"""Finds the geometry of a fan image in the image itself: the outline at which it turns black.

A fan image is lit inside a sector and black outside it, usually with far range on top.  A pixel is
lit with one probability inside the sector and with another outside; the finder takes the outline
with the greatest likelihood, so that holes (shadows, noise that reaches zero) and specks (ringing
of JPEG or MPEG, text) cost little each.  An outline is accepted by the share of it that the image
shows.  If none is accepted, the finder tries quarter turns of the image, then the largest area of
a screen alone, and last a V of white lines, as chart plotters draw it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import product
from typing import Any, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from ...factory.sonar.geometry import FanGeometry
from .palettes import find_painted

Numbers = npt.NDArray[np.float64]
Bytes = npt.NDArray[np.uint8]

_SURE = 0.7  # share of the outline that must be seen
_SURE_ODD = 0.8  # of turned fans, and of fans on screens
_MOST_BLACK = 48  # of 255: a border lighter than this is no black one
_LEAST_PART = 0.05  # of all pixels: the smallest fan on a screen
_MOST_PART = 0.9  # the largest
_LEAST_TURNED = 0.15  # part of the image that a turned fan fills, unlike the mask of some object
_MOST_OUTSIDE = 0.05  # of all pixels may be lit and not in the sector
# Largest squeeze, or its inverse, that a fit may reach, and that an accepted fan may have: a fit
# that runs into its limit has found no fan.
_MOST_FITTED_SQUEEZE = 2.0
_MOST_ACCEPTED_SQUEEZE = 1.95
# Grey levels, of 255, by which the ground of a screen may vary.  Videos need the larger one; it is
# tried last, as it also takes the dark grain of a fan for ground.
_GROUND_SPREADS = 2, 6
_LEAST_INNER = 0.1  # share of lit pixels just inside the outline
_OUTER_OF_INNER = 0.35  # share of lit pixels just outside, as a part of that
_LEAST_HALF_DEG = 2.0
_MOST_HALF_DEG = 88.0
_PIECES = 12  # of each side of the outline, looked at one by one


class Sector(NamedTuple):
    """A sector with far range on top, in pixels of the image.

    left_tangent, right_tangent: of the bearings of both edges, positive to the right.
    squeeze: pixels along x that are as long as one pixel along y.
    """

    apex_x: float
    apex_y: float
    far_px: float
    near_px: float
    left_tangent: float
    right_tangent: float
    squeeze: float


def find_geometry(image: npt.NDArray[Any]) -> FanGeometry | None:
    """The fan in (H, W) or (H, W, colours) grey values of any number type, if there is one.

    In pixels and shares of the largest range; metres cannot be seen.
    None for an image without a sector on black or on a bright page, such as a camera image, a polar
    image or a full rectangle.  Raises ValueError for another shape.
    """
    grey = grey_bytes(image)
    if min(grey.shape) < 32:
        return None
    for spread in (None, *_GROUND_SPREADS):
        shown = grey if spread is None else _isolate_largest_area(grey, spread)
        if shown is None:
            continue
        for turns in (0, 2, 1, 3):
            sure = _SURE_ODD if turns or spread else _SURE
            upright = _find_upright(np.ascontiguousarray(np.rot90(shown, turns)), sure)
            if upright is not None:
                geometry = upright.turned_back(turns, *grey.shape)
                if not turns or geometry.sector_mask(*grey.shape).mean() >= _LEAST_TURNED:
                    return geometry
    return _find_drawn(grey)


def _find_upright(image: Bytes, sure: float) -> FanGeometry | None:
    """The fan with far range on top; None where none is found with confidence `sure`."""
    black = _black_level(image)
    if black > _MOST_BLACK:
        return None
    grey, top, left = _cropped(image, black)
    sector = fit_sector(grey > black)
    if sector is None:
        return None

    ringing = _ringing_level(grey, sector)
    if ringing > black:
        refitted = fit_sector(grey > ringing)
        if refitted is not None:
            black = ringing
            sector = refitted
    if not _is_plausible(sector):
        return None

    lit = grey > black
    outside = _sector_mask(sector, *grey.shape) == 0
    if (lit & outside).mean() > _MOST_OUTSIDE:
        return None
    fan = _fan_of_sector(sector)
    if _confidence(lit, fan) < sure:
        return None
    return replace(fan, apex_x_px=fan.apex_x_px + left, apex_y_px=fan.apex_y_px + top)


def _black_level(grey: Bytes) -> int:
    """Grey value of the darker upper corner: no fan reaches the corners, but text may."""
    size = max(2, min(grey.shape) // 40)
    corners = grey[:size, :size], grey[:size, -size:]
    return min(int(np.quantile(corner, 0.99)) for corner in corners)


def _ringing_level(grey: Bytes, sector: Sector) -> int:
    """Grey value of the border beside a sector, where JPEG and MPEG ring and it is not black."""
    inside = _sector_mask(sector, *grey.shape)
    near, wide = (cv2.dilate(inside, np.ones((side, side), np.uint8)) for side in (5, 17))
    beside = grey[(wide > 0) & (near == 0)]
    return min(int(np.quantile(beside, 0.97)), _MOST_BLACK) if beside.size else 0


def _fan_of_sector(sector: Sector) -> FanGeometry:
    first_rad = math.atan(sector.left_tangent)
    last_rad = math.atan(sector.right_tangent)
    symmetric_fan = FanGeometry.fan(
        2 * max(-first_rad, last_rad),
        apex_x_px=sector.apex_x,
        apex_y_px=sector.apex_y,
        near_px=sector.near_px,
        far_px=sector.far_px,
        x_scale=sector.squeeze,
    )
    return replace(symmetric_fan, azimuth_min_rad=first_rad, azimuth_max_rad=last_rad)


def _is_plausible(sector: Sector) -> bool:
    """Whether a sonar may have such a sector, and a screen such pixels."""
    halves_deg = (
        math.degrees(-math.atan(sector.left_tangent)),
        math.degrees(math.atan(sector.right_tangent)),
    )
    if min(halves_deg) < _LEAST_HALF_DEG or max(halves_deg) > _MOST_HALF_DEG:
        return False
    return abs(math.log(sector.squeeze)) <= math.log(_MOST_ACCEPTED_SQUEEZE)


class _Crop(NamedTuple):
    """A part of an image, and its first row and column."""

    grey: Bytes
    top: int
    left: int


def _cropped(grey: Bytes, black: int) -> _Crop:
    """The part of an image that is not black, with a margin."""
    spans = []
    for share in ((grey > black).mean(axis=1), (grey > black).mean(axis=0)):
        some = np.flatnonzero(share > 0.02).tolist() or [0, len(share) - 1]
        spans.append(slice(max(some[0] - 16, 0), some[-1] + 17))
    rows, columns = spans
    return _Crop(np.ascontiguousarray(grey[rows, columns]), rows.start, columns.start)


def grey_bytes(image: npt.NDArray[Any]) -> Bytes:
    """(H, W) of 8 bits: grey values, or the levels of a colour map."""
    if image.ndim == 3:
        painted = find_painted(image)
        image = image[..., :3].max(axis=2) if painted is None else painted.levels
    if image.ndim != 2:
        raise ValueError(f"image has shape {image.shape}; expected (H, W) or (H, W, colours)")
    if image.dtype == np.uint8:
        return image
    full = float(np.iinfo(image.dtype).max) if image.dtype.kind in "iu" else 1.0
    # Samples of 10 or 12 bits in files of 16 leave most of the scale empty.
    brightest = float(np.nan_to_num(image, posinf=0).max(initial=0))
    full = brightest if 0 < brightest < full / 4 else full
    # Rounded up, so that only zero becomes zero.
    return np.asarray(np.ceil(np.clip(np.nan_to_num(image / full), 0, 1) * 255), np.uint8)


def _sector_mask(sector: Sector, height: int, width: int) -> Bytes:
    """(H, W), 1 in the sector and 0 elsewhere."""
    (top,), (bottom,) = row_limits(np.array([sector]), np.arange(width, dtype=np.float64))
    row = np.arange(height)[:, None]
    return np.asarray((row >= top) & (row <= bottom), np.uint8)


def _confidence(lit: npt.NDArray[np.bool_], fan: FanGeometry) -> float:
    """0..1, the share of the outline at which the lit area visibly ends.

    There more than `_LEAST_INNER` of the pixels just inside are lit, and just outside less than
    `_OUTER_OF_INNER` of that.  Both edges and the far arc count alike: a fan whose outline is half
    in the dark has 0.5.
    """
    ends_here = []
    for just_inside, just_outside in _outline_sides(fan):
        inner = _lit_share(lit, *fan.pixels(*just_inside))
        outer = _lit_share(lit, *fan.pixels(*just_outside))
        ends_here.append(light_ends(inner, outer))
    return float(np.mean(ends_here))


def light_ends(inner: Numbers, outer: Numbers) -> npt.NDArray[np.bool_]:
    """Where the lit area ends, by the shares of pixels lit just inside and outside an outline."""
    return (inner > _LEAST_INNER) & (outer < _OUTER_OF_INNER * inner)


class _Places(NamedTuple):
    """Points by range, as shares of the largest, and bearing, radians; both broadcast."""

    range_fraction: Numbers
    azimuth_rad: Numbers


def _outline_sides(fan: FanGeometry) -> tuple[tuple[_Places, _Places], ...]:
    """Points just inside and just outside the left edge, the right edge and the far arc."""
    count = _PIECES * 12
    first = fan.azimuth_min_rad
    last = fan.azimuth_max_rad
    # Some pixels away from the outline, as shares of the largest range.
    away: Numbers = np.maximum(np.linspace(0.004, 0.02, 5), np.arange(2, 7) / fan.far_px)
    ranges = np.linspace(fan.near_fraction + 0.03, 0.97, count)[:, None]
    bearings = np.linspace(first, last, count + 8)[4:-4, None]
    aside = away / ranges
    return (
        (_Places(ranges, first + aside), _Places(ranges, first - aside)),
        (_Places(ranges, last - aside), _Places(ranges, last + aside)),
        (_Places(1.0 - away, bearings), _Places(1.0 + away, bearings)),
    )


def outline_pixels(
    fan: FanGeometry, height: int, width: int
) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Return the pixels just inside and those just outside the outline of a fan.

    Both are (3, pieces, samples) indices of the flattened image, -1 outside the image.  The first
    axis is the left edge, the right edge and the far arc, each cut into pieces of some samples.
    """
    sides = _outline_sides(fan)
    inner = [_indices(fan, inside, height, width) for inside, _ in sides]
    outer = [_indices(fan, outside, height, width) for _, outside in sides]
    return np.stack(inner), np.stack(outer)


def _indices(fan: FanGeometry, places: _Places, height: int, width: int) -> npt.NDArray[np.intp]:
    row, column = np.broadcast_arrays(*fan.pixels(*places))
    row = np.rint(row).astype(np.intp)
    column = np.rint(column).astype(np.intp)
    is_within = (row >= 0) & (row < height) & (column >= 0) & (column < width)
    return np.where(is_within, row * width + column, -1).reshape(_PIECES, -1)


def _lit_share(lit: npt.NDArray[np.bool_], row: Numbers, column: Numbers) -> Numbers:
    """(_PIECES,) share of lit pixels of each piece of the outline; 0 outside the image."""
    hit, inside = (counts.reshape(_PIECES, -1).sum(axis=1) for counts in _at(lit, row, column))
    return np.asarray(hit / np.maximum(inside, 1))


def _at(
    values: npt.NDArray[Any], row: Numbers, column: Numbers
) -> tuple[npt.NDArray[Any], npt.NDArray[np.bool_]]:
    """Values of the nearest pixels of (H, W), 0 outside it, and where it is not outside."""
    height, width = values.shape
    row, column = np.broadcast_arrays(np.rint(row).astype(int), np.rint(column).astype(int))
    is_inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
    return is_inside * values[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)], is_inside


def _isolate_largest_area(grey: Bytes, spread: int) -> Bytes | None:
    """Blacken all but the largest area on the flat ground of a screen, which may hold a fan.

    spread: levels by which the ground may vary.  None where the area is too small or too large, or
    nothing else is there.
    """
    rim = np.ones(grey.shape, bool)
    rim[1:-1, 1:-1] = False
    ground = int(np.median(grey[rim]))
    has_bright_ground = ground > spread
    shown = grey
    if has_bright_ground:
        # The ground is all of its level that is connected to the image's border.
        has_ground_level = np.abs(grey.astype(np.int16) - ground) <= spread
        _, parts = cv2.connectedComponents(has_ground_level.astype(np.uint8), connectivity=4)
        border_parts = np.setdiff1d(parts[rim], 0)  # 0: pixels of other levels
        shown = np.where(np.isin(parts, border_parts), 0, grey).astype(np.uint8)
    closed = cv2.morphologyEx(
        (shown > spread).astype(np.uint8), cv2.MORPH_CLOSE, np.ones((7, 7), np.uint8)
    )
    count, parts, stats, _ = cv2.connectedComponentsWithStats(closed, connectivity=4)
    area_count = count - 1  # label 0 is the ground
    # A single area on black would be the image that was searched already.
    if area_count < (1 if has_bright_ground else 2):
        return None
    largest = 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
    share = stats[largest, cv2.CC_STAT_AREA] / grey.size
    alone = np.where(parts == largest, shown, 0).astype(np.uint8)
    return alone if _LEAST_PART <= share <= _MOST_PART else None


_THUMBNAIL_PX = 160  # longest side of the thumbnail for the first guess
_INVALID_COST = 1e15  # of an outline that is no sector
# Largest differences from the best corner in a simplex that has converged: of costs, and of
# coordinates (pixels, or the logarithm of the squeeze).
_CONVERGED_COST = 1.0
_CONVERGED_DISTANCE = 0.05


def fit_sector(lit: npt.NDArray[np.bool_]) -> Sector | None:
    """The sector that best separates lit from black pixels, (H, W); None where there is none."""
    guess = _guess_outline(lit)
    if guess is None:
        return None
    outline = guess.outline
    likelihood = _Likelihood(lit, guess.rows)
    # Twice: the first fit improves the shares of lit pixels inside and outside.
    for size_px in (guess.cell_px, 1.0):
        if not likelihood.learn(outline):
            return None
        outline = likelihood.improve(outline, size_px, squeezed=False)

    squeezed = likelihood.improve(outline, 0.5, squeezed=True)
    squeezed_cost, square_cost = likelihood.costs([squeezed.tolist(), outline.tolist()])
    # Pixels count as square unless the arcs contradict it by this log-likelihood.
    if squeezed_cost < square_cost - 30.0:
        outline = squeezed
    return _sector(likelihood.polish(outline).tolist(), guess.rows)


class _FirstGuess(NamedTuple):
    """An outline to start from.

    outline: (7,) columns of the left edge at two rows, columns of the right edge at these rows,
        rows of the far and of the near arc in the sonar's column, logarithm of the squeeze.
    rows: the two rows.  cell_px: pixels of the image per pixel of the thumbnail it was found in.
    """

    outline: Numbers
    rows: tuple[float, float]
    cell_px: float


class _EdgeLine(NamedTuple):
    """An edge of the part in the thumbnail: column = columns_per_row * row + first_column."""

    columns_per_row: float
    first_column: float


def _guess_outline(lit: npt.NDArray[np.bool_]) -> _FirstGuess | None:
    """Guess the outline from a thumbnail of the lit pixels; None where they form no sector."""
    height, width = lit.shape
    scale = max(1, math.ceil(max(height, width) / _THUMBNAIL_PX))
    columns = math.ceil(width / scale)
    # A wide image is reduced less in its rows, by which the edges are fitted.
    row_scale = max(1, math.ceil(height / _THUMBNAIL_PX))
    rows = math.ceil(height / row_scale)
    thumbnail = cv2.resize(lit.astype(np.float32), (columns, rows), interpolation=cv2.INTER_AREA)
    part = _largest_dense_part(thumbnail)
    if part is None:
        return None

    part_rows = np.flatnonzero(part.any(axis=1))
    last_column = part.shape[1] - 1
    left = _fit_left_edge(part_rows, part[part_rows].argmax(axis=1))
    mirrored = _fit_left_edge(part_rows, part[part_rows, ::-1].argmax(axis=1))
    if left is None or mirrored is None:
        return None
    if left.columns_per_row + mirrored.columns_per_row <= 1e-3:
        return None
    right = _EdgeLine(-mirrored.columns_per_row, last_column - mirrored.first_column)

    # The edges meet at the sonar; the part begins and ends in its column at the arcs.
    convergence = left.columns_per_row - right.columns_per_row
    apex_row = (right.first_column - left.first_column) / convergence
    apex_column = int(np.clip(np.polyval(left, apex_row), 1, last_column - 1))
    ahead = np.flatnonzero(part[:, apex_column - 1 : apex_column + 2].any(axis=1))
    if not len(ahead):
        return None

    # From the centres of thumbnail pixels to pixels of the image.
    across_px = width / columns
    down_px = height / rows
    two_rows = np.array([part_rows[len(part_rows) // 4], part_rows[-1]], float)
    left_columns = (np.polyval(left, two_rows) + 0.5) * across_px - 0.5
    right_columns = (np.polyval(right, two_rows) + 0.5) * across_px - 0.5
    arc_rows = (np.array([ahead[0], ahead[-1]]) + 0.5) * down_px - 0.5
    upper, lower = (two_rows + 0.5) * down_px - 0.5
    outline = np.concatenate([left_columns, right_columns, arc_rows, [0.0]])
    return _FirstGuess(outline, (float(upper), float(lower)), float(scale))


def _largest_dense_part(share: npt.NDArray[Any]) -> npt.NDArray[np.bool_] | None:
    """Mask of the largest area in which many pixels are lit; None where it is next to nothing.

    share: (h, w) share of lit pixels in each pixel of the thumbnail.
    """
    share = cv2.blur(share, (3, 3))
    partly_lit = share[share > 0.05]
    if partly_lit.size < 20:
        return None
    dense = (share > 0.4 * np.median(partly_lit)).astype(np.uint8)
    dense = cv2.morphologyEx(dense, cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8))
    count, labels, stats, _ = cv2.connectedComponentsWithStats(dense, connectivity=8)
    part = labels > 0
    if count > 1:
        part = labels == 1 + np.argmax(stats[1:, cv2.CC_STAT_AREA])
    if part.mean() < 0.03:
        return None
    return np.asarray(part)


def _fit_left_edge(rows: npt.NDArray[np.intp], columns: npt.NDArray[np.intp]) -> _EdgeLine | None:
    """Fit a line to the left border of a part, from its leftmost row down; robust to outliers.

    rows: of the part.  columns: its first column in each.  None where fewer than 6 rows are left.
    """
    corner = int(np.flatnonzero(columns <= columns.min()).max())
    y = rows[corner + 1 : -1].astype(float)
    x = columns[corner + 1 : -1].astype(float)
    if len(y) < 6:
        return None
    weights = np.ones(len(y))
    for _ in range(4):
        line = np.polyfit(y, x, 1, w=weights)
        off = np.abs(np.polyval(line, y) - x)
        weights = 1 / (1 + (off / max(0.7, 1.5 * float(np.median(off)))) ** 2)
    return _EdgeLine(*line)


def _sector(outline: Sequence[float], rows: tuple[float, float]) -> Sector | None:
    """The sector of an outline.

    None where the edges do not meet below, the arcs are not in order, or the squeeze is too large.

    Takes plain numbers, as the other loops here do: scalars of NumPy cost ten times as much.
    """
    upper, lower = rows
    left = (outline[1] - outline[0]) / (lower - upper)
    right = (outline[3] - outline[2]) / (lower - upper)
    if not (left > 1e-3 and right < -1e-3):
        return None
    apex_y = upper + (outline[2] - outline[0]) / (left - right)
    apex_x = outline[0] + left * (apex_y - upper)
    squeeze = math.exp(outline[6])
    far = apex_y - outline[4]
    near = max(apex_y - outline[5], 0.0)
    if not (far > near and 1 / _MOST_FITTED_SQUEEZE < squeeze < _MOST_FITTED_SQUEEZE):
        return None
    return Sector(apex_x, apex_y, far, near, -left / squeeze, -right / squeeze, squeeze)


class _Likelihood:
    """Cost of an outline: how badly it separates lit from black pixels; a fit takes 2000 of them.

    The cost is a sum of logarithms of likelihood ratios: a lit pixel inside lowers it, a black
    pixel inside raises it.
    """

    def __init__(self, lit: npt.NDArray[np.bool_], rows: tuple[float, float]) -> None:
        """rows: see `_FirstGuess`."""
        height, self._width = lit.shape
        # Number of lit pixels above the upper border of each row; the last row is there twice.
        above = np.zeros((height + 2, self._width), np.int32)
        np.cumsum(lit, axis=0, dtype=np.int32, out=above[1:-1])
        above[-1] = above[-2]
        self._above = above.ravel()
        self._height = height
        self._rows = rows
        self._pixels = lit.size
        self._lit = int(above[-1].sum())

    def learn(self, outline: Numbers) -> bool:
        """Estimate the shares of lit pixels inside and outside; False if they do not differ."""
        sector = _sector(outline.tolist(), self._rows)
        if sector is None:
            return False
        area, lit = self.count_pixels([sector], 1, False)[:, 0].tolist()
        area_outside = max(self._pixels - area, 1.0)
        share_inside = float(np.clip(lit / max(area, 1.0), 0.05, 0.97))
        share_outside = float(np.clip((self._lit - lit) / area_outside, 1e-3, 0.05))
        if share_inside <= share_outside:
            return False
        # Logarithms of the likelihood ratio, inside against outside: by which a lit pixel in the
        # sector lowers the cost, and a black one raises it.
        self._lit_gain = math.log(share_inside / share_outside)
        self._black_cost = math.log((1 - share_outside) / (1 - share_inside))
        return True

    def count_pixels(self, sectors: Sequence[Sector], step: int, whole: bool) -> Numbers:
        """(2, N) pixels and lit pixels in each of N sectors, of every `step`-th column.

        whole: whether a pixel counts as a whole if its centre is in the sector.  Otherwise parts of
        pixels count, which is smoother and draws the outline outward.
        """
        columns = np.arange(step // 2, self._width, step)
        # Pixels, and lit pixels, above the first and above the last border of each column.
        counts = np.empty((2, 2, len(sectors), len(columns)))
        rows = counts[0]
        lit = counts[1]
        # Borders instead of centres: pixel r reaches from r - 0.5 to r + 0.5.
        np.add(row_limits(np.array(sectors), columns.astype(np.float64)), 0.5, out=rows)
        if whole:
            rows[0] = np.ceil(rows[0] - 0.5)
            rows[1] = np.floor(rows[1] + 0.5)
        np.minimum(np.maximum(rows, 0.0, out=rows), self._height, out=rows)
        np.minimum(rows[0], rows[1], out=rows[0])  # a column outside the sector counts nothing
        whole_rows = rows.astype(np.int64)
        row_part = rows - whole_rows
        pixel = whole_rows * self._width + columns
        above = self._above.take(pixel)
        lit[:] = row_part * (self._above.take(pixel + self._width) - above) + above
        # Added in order, so that the sums do not depend on how NumPy splits them.
        sums: Numbers = (counts[:, 1] - counts[:, 0]).cumsum(axis=-1)[..., -1]
        return sums

    def costs(self, outlines: Sequence[Sequence[float]], whole: bool = False) -> Numbers:
        """(N,) negative log-likelihoods, up to a constant; `_INVALID_COST` without a sector."""
        sectors = [_sector(outline, self._rows) for outline in outlines]
        is_valid = [sector is not None for sector in sectors]
        costs = np.full(len(sectors), _INVALID_COST)
        valid = [sector for sector in sectors if sector is not None]
        if valid:
            step = max(1, self._width // 400)
            area, lit = self.count_pixels(valid, step, whole)
            costs[is_valid] = (self._black_cost * (area - lit) - self._lit_gain * lit) * step
        return costs

    def improve(self, outline: Numbers, size_px: float, squeezed: bool) -> Numbers:
        """Return the likeliest outline nearby.

        size_px: of the first steps.  squeezed: whether the squeeze is fitted, too.
        """
        free = 7 if squeezed else 6
        fixed = outline[free:].tolist()
        steps = np.diag([size_px] * 6 + [0.05])[:free, :free]
        simplex = np.vstack([outline[:free], outline[:free] + steps])

        def cost(values: Numbers) -> float:
            return float(self.costs([values.tolist() + fixed])[0])

        best = _lowest(cost, simplex, 40 * free)
        return np.concatenate([best, outline[free:]])

    def polish(self, outline: Numbers) -> Numbers:
        """Move each end of an edge and each arc, one at a time, to where it fits best."""
        outline = outline.copy()
        # The arcs first, and farther: short arcs hardly counted in the fit of the whole outline.
        for reach_px, parameters in ((8.0, (5, 4)), (1.5, range(6)), (0.5, range(6))):
            moves = np.linspace(-reach_px, reach_px, 21)
            for parameter in parameters:
                candidates = np.repeat(outline[None], len(moves), axis=0)
                candidates[:, parameter] += moves
                costs = self.costs(candidates.tolist(), whole=True)
                # The centre of all candidates that are as good as the best.
                outline = candidates[costs <= costs.min() + 1e-6].mean(axis=0)
        return outline


def _lowest(cost: Callable[[Numbers], float], corners: Numbers, most: int) -> Numbers:
    """The point of lowest cost near a simplex (N + 1, N), by about `most` evaluations.

    SciPy has the method, too, and takes a third of a second to import.
    """
    simplex = _Simplex(cost, corners)
    while not simplex.has_converged and simplex.evaluations < most:
        if not simplex.step(most):
            break
    return np.asarray(simplex.corners[0])


class _Simplex:
    """The simplex of Nelder and Mead 1965, with the parameters of Gao and Han 2012.

    corners: (N + 1, N), the best first.  costs: of each.  evaluations: of the cost so far.
    """

    def __init__(self, cost: Callable[[Numbers], float], corners: Numbers) -> None:
        self._cost = cost
        size = corners.shape[1]
        self._size = size
        self._expansion = 1 + 2 / size
        self._contraction = 0.75 - 1 / (2 * size)
        self._shrinkage = 1 - 1 / size
        self.evaluations = 0
        self.corners = corners
        self.costs = np.array([self._evaluate(corner) for corner in corners])
        self._sort()

    @property
    def has_converged(self) -> bool:
        """Whether all corners are close to the best one and cost about as much."""
        spread = self.costs[-1] - self.costs[0]
        distance = np.abs(self.corners[1:] - self.corners[0]).max()
        return bool(spread <= _CONVERGED_COST and distance <= _CONVERGED_DISTANCE)

    def step(self, most: int) -> bool:
        """Move the worst corner, or all but the best; False where no evaluations are left."""
        reflected = self._opposite(1.0)
        reflected_cost = self._evaluate(reflected)
        if self.costs[0] <= reflected_cost < self.costs[-2]:
            self._replace_worst(reflected, reflected_cost)
            return True
        if self.evaluations >= most:
            return False

        if reflected_cost < self.costs[0]:
            expanded = self._opposite(self._expansion)
            expanded_cost = self._evaluate(expanded)
            if expanded_cost < reflected_cost:
                self._replace_worst(expanded, expanded_cost)
            else:
                self._replace_worst(reflected, reflected_cost)
            return True

        # Outside where reflecting gained something, else between the worst corner and the others.
        is_outside = reflected_cost < self.costs[-1]
        contracted = self._opposite(self._contraction if is_outside else -self._contraction)
        contracted_cost = self._evaluate(contracted)
        if contracted_cost <= reflected_cost and contracted_cost < self.costs[-1]:
            self._replace_worst(contracted, contracted_cost)
        else:
            self._shrink()
        return True

    def _opposite(self, share: float) -> Numbers:
        """The worst corner, moved along the line through the middle of the others.

        share: how far beyond the middle, as a part of its distance from there; negative: short of
        the middle.
        """
        middle = np.add.reduce(self.corners[:-1]) / self._size
        return np.asarray((1 + share) * middle - share * self.corners[-1])

    def _evaluate(self, corner: Numbers) -> float:
        self.evaluations += 1
        return self._cost(corner)

    def _replace_worst(self, corner: Numbers, cost: float) -> None:
        self.corners[-1] = corner
        self.costs[-1] = cost
        self._sort()

    def _shrink(self) -> None:
        """Move all corners towards the best."""
        best = self.corners[0]
        self.corners[1:] = best + self._shrinkage * (self.corners[1:] - best)
        self.costs[1:] = [self._evaluate(corner) for corner in self.corners[1:]]
        self._sort()

    def _sort(self) -> None:
        by_cost = np.argsort(self.costs, kind="stable")
        self.corners = self.corners[by_cost]
        self.costs = self.costs[by_cost]


def row_limits(sectors: Numbers, x: Numbers) -> Numbers:
    """Return the first and last row of sectors in columns of the image, last < first outside.

    sectors: (N, 7), see `Sector`.  x: (W,) columns.  Returns (2, N, W) fractions of a row.
    """
    fields = sectors.T[..., None]
    apex_x = fields[0]
    apex_y = fields[1]
    radii = fields[2:4]
    tangents = fields[4:6]
    across = (x - apex_x) / fields[6]
    # Far and near limit, as distances ahead of the apex: first of the arcs.
    limits_ahead: Numbers = np.sqrt(np.maximum(np.square(radii) - across * across, 0.0))
    # An edge crosses columns of its own side ahead of the apex, the others behind it, below zero.
    edges_ahead = across / tangents
    limits_ahead[1] = np.maximum(limits_ahead[1], edges_ahead.max(axis=0))
    return np.asarray(apex_y - limits_ahead)


_WHITE = 200  # of 255
_LEAST_DEG = 3.0  # smallest angle between a side line and the rows of the image
_MOST_DEG = 75.0  # largest
_ALIKE_DEG = 1.0  # by which both angles may differ
_TRIED = 8  # of the longest lines
_ARC_SHARE = 0.35  # of an arc within the image that must be white


class _Line(NamedTuple):
    """A white line: its length, pixels; its slope, degrees, positive downwards; its left end."""

    length_px: float
    slope_deg: float
    x: float
    y: float


def _find_drawn(grey: Bytes) -> FanGeometry | None:
    """The fan bounded by two white side lines and the outermost arc."""
    mask = (grey >= _WHITE).astype(np.uint8)
    # Opening removes thin lines alone, so they are the difference.
    wide_areas = cv2.morphologyEx(mask, cv2.MORPH_OPEN, np.ones((9, 9), np.uint8))
    lines = mask - wide_areas
    height, width = lines.shape
    if lines.mean() > 0.05:  # so many thin bright pixels are speckle
        return None
    falling, rising = _side_lines(lines)
    for left, right in product(falling[:_TRIED], rising[:_TRIED]):
        # The side lines meet at the sonar.
        fall = math.tan(math.radians(left.slope_deg))
        rise = math.tan(math.radians(right.slope_deg))
        x = (right.y - left.y + fall * left.x - rise * right.x) / (fall - rise)
        y = left.y + fall * (x - left.x)
        is_symmetric = abs(left.slope_deg + right.slope_deg) <= _ALIKE_DEG
        if not is_symmetric or not (0 < x < width and height / 2 < y < height):
            continue
        half_rad = math.pi / 2 - math.radians(left.slope_deg - right.slope_deg) / 2
        far_px = _farthest_arc(lines, x, y, half_rad)
        if far_px is not None:
            return FanGeometry.fan(
                2 * half_rad, apex_x_px=x, apex_y_px=y, near_px=0.0, far_px=far_px
            )
    return None


def _side_lines(lines: npt.NDArray[Any]) -> tuple[list[_Line], list[_Line]]:
    """Lines that may be the left and the right side of a fan, the longest first.

    lines: (H, W), not 0 on thin bright lines.
    """
    # A fifth of the width or longer; between the sonar and the line there may be 12 pixels.
    shortest_px = 0.2 * lines.shape[1]
    segments = cv2.HoughLinesP(lines, 1, math.radians(0.25), 100, None, shortest_px, 12.0)
    falling: list[_Line] = []
    rising: list[_Line] = []
    for x1, y1, x2, y2 in () if segments is None else segments.reshape(-1, 4).astype(float):
        slope_deg = math.degrees(math.atan2(y2 - y1, x2 - x1))  # x1 <= x2
        if _LEAST_DEG <= abs(slope_deg) <= _MOST_DEG:
            side = rising if slope_deg < 0 else falling
            side.append(_Line(math.hypot(x2 - x1, y2 - y1), slope_deg, x1, y1))
    return sorted(falling, reverse=True), sorted(rising, reverse=True)


def _farthest_arc(lines: npt.NDArray[Any], x: float, y: float, half_rad: float) -> float | None:
    """Radius of the outermost drawn arc about the sonar at (x, y), pixels; None without any."""
    height, width = lines.shape
    bearings_rad = np.linspace(-half_rad, half_rad, 720)[10:-10]
    radii_px = np.arange(height / 4, math.hypot(width, height))[:, None]
    widened = cv2.dilate(lines, np.ones((3, 3), np.uint8))
    rows = y - radii_px * np.cos(bearings_rad)
    columns = x + radii_px * np.sin(bearings_rad)
    is_white, is_inside = _at(widened, rows, columns)
    count = is_inside.sum(axis=1)
    white_share = is_white.sum(axis=1) / np.maximum(count, 1)
    arcs = np.flatnonzero((count >= 180) & (white_share >= _ARC_SHARE))
    return float(radii_px[arcs[-1], 0]) if len(arcs) else None
