"""The geometry of a fan picture, found in the picture itself: where its black border ends.

A fan picture is lit inside a sector and black outside it, mostly with far range on top.  A pixel is
lit with one probability inside the sector and with another outside; the outline with the greatest
likelihood wins, so holes (shadows, noise that reaches zero) and specks (ringing of JPEG or MPEG,
text) cost little each.  The share of the outline that the picture really shows decides whether it
is accepted.  Where none is, the picture is turned by quarters, then the largest area of a screen is
tried alone, and last a V of white lines is searched, as chart plotters draw it.
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
# apex_x, apex_y, far_px, near_px, tangents of the edges' bearings, pixels along x for one along y.
Sector = tuple[float, float, float, float, float, float, float]
Bytes = npt.NDArray[np.uint8]

_SURE = 0.7  # share of the outline that must be seen
_SURE_ODD = 0.8  # of turned fans, and of fans on screens
_MOST_BLACK = 48  # of 255: a border lighter than this is no black one
_LEAST_PART = 0.05  # of all pixels: the smallest fan on a screen
_MOST_PART = 0.9  # the largest
_LEAST_TURNED = 0.15  # part of the picture that a turned fan fills, unlike the mask of some object
_MOST_OUTSIDE = 0.05  # of all pixels may be lit and not in the sector
_SURE_SQUEEZE = 1.95
_MOST_SQUEEZE = 2.0
# Of 255: the ground of a screen; a video's is not quite flat, and the wider it may spread, the
# farther it reaches into a fan's grain.
_GROUND_SPREADS = 2, 6
_LEAST_HALF_DEG = 2.0
_MOST_HALF_DEG = 88.0
_PIECES = 12  # of each side of the outline, looked at one by one


def find_geometry(picture: npt.NDArray[Any]) -> FanGeometry | None:
    """The fan in (H, W) or (H, W, colours) grey values of any number type, if there is one.

    In pixels and shares of the largest range; metres cannot be seen.
    None for a picture without a sector on black or on a bright page: a photo, a polar picture, a
    full rectangle.  Raises ValueError for another shape.
    """
    grey = grey_bytes(picture)
    if min(grey.shape) < 32:
        return None
    for spread in (None, *_GROUND_SPREADS):
        shown = grey if spread is None else _largest_part(grey, spread)
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


def _find_upright(grey: Bytes, sure: float) -> FanGeometry | None:
    """The fan with far range on top."""
    # The border: the lesser of both upper corners, which no fan reaches; text may be in the other.
    size = max(2, min(grey.shape) // 40)
    corners = grey[:size, :size], grey[:size, -size:]
    black = min(int(np.quantile(corner, 0.99)) for corner in corners)
    if black > _MOST_BLACK:
        return None
    grey, top, left = _cropped(grey, black)
    sector = fit_sector(grey > black)
    if sector is None:
        return None
    # JPEG and MPEG ring on both sides of an edge: there the border is not quite black.
    inside = _inside(sector, *grey.shape)
    near, wide = (cv2.dilate(inside, np.ones((side, side), np.uint8)) for side in (5, 17))
    beside = grey[(wide > 0) & (near == 0)]
    ringing = min(int(np.quantile(beside, 0.97)), _MOST_BLACK) if beside.size else 0
    if ringing > black and (again := fit_sector(grey > ringing)) is not None:
        black = ringing
        sector = again
    lit = grey > black
    apex_x, apex_y, far, near_px, *tangents, squeeze = sector
    first, last = map(math.atan, tangents)
    wider_half = max(-first, last)
    other_half = min(-first, last)
    if (
        not _LEAST_HALF_DEG
        <= math.degrees(other_half)
        <= math.degrees(wider_half)
        <= _MOST_HALF_DEG
    ):
        return None
    if abs(math.log(squeeze)) > math.log(_SURE_SQUEEZE):
        return None
    if (lit & (_inside(sector, *grey.shape) == 0)).mean() > _MOST_OUTSIDE:
        return None
    place = {"apex_x_px": apex_x, "apex_y_px": apex_y, "near_px": near_px, "far_px": far}
    fan = FanGeometry.fan(2 * wider_half, **place, x_scale=squeeze)
    geometry = replace(fan, azimuth_min_rad=first, azimuth_max_rad=last)
    if _confidence(lit, geometry) < sure:
        return None
    return replace(geometry, apex_x_px=apex_x + left, apex_y_px=apex_y + top)


def _cropped(grey: Bytes, black: int) -> tuple[Bytes, int, int]:
    """What is not border, with some border around it; its first row and column."""
    spans = []
    for share in ((grey > black).mean(axis=1), (grey > black).mean(axis=0)):
        some = np.flatnonzero(share > 0.02).tolist() or [0, len(share) - 1]
        spans.append(slice(max(some[0] - 16, 0), some[-1] + 17))
    rows, columns = spans
    return np.ascontiguousarray(grey[rows, columns]), rows.start, columns.start


def grey_bytes(picture: npt.NDArray[Any]) -> Bytes:
    """(H, W) of 8 bits: grey values, or the levels of a colour map."""
    if picture.ndim == 3:
        painted = find_painted(picture)
        picture = picture[..., :3].max(axis=2) if painted is None else painted.levels
    if picture.ndim != 2:
        raise ValueError(f"picture has shape {picture.shape}; expected (H, W) or (H, W, colours)")
    if picture.dtype == np.uint8:
        return picture
    full = float(np.iinfo(picture.dtype).max) if picture.dtype.kind in "iu" else 1.0
    # Samples of 10 or 12 bits in files of 16 leave most of the scale empty.
    brightest = float(np.nan_to_num(picture, posinf=0).max(initial=0))
    full = brightest if 0 < brightest < full / 4 else full
    # A level that is not zero stays one.
    return np.asarray(np.ceil(np.clip(np.nan_to_num(picture / full), 0, 1) * 255), np.uint8)


def _inside(sector: Sector, height: int, width: int) -> Bytes:
    (top,), (bottom,) = limits(np.array([sector]), np.arange(width, dtype=np.float64))
    row = np.arange(height)[:, None]
    return np.asarray((row >= top) & (row <= bottom), np.uint8)


def _confidence(lit: npt.NDArray[np.bool_], fan: FanGeometry) -> float:
    """0..1, the share of the outline at which all is lit just inside and black just outside.

    Both edges and the far arc, in equal parts: a fan whose outline is half in the dark has 0.5.
    """
    ends_here = []
    for just_inside, just_outside in _outline_sides(fan):
        # Outside the picture all is black, and inside there must be something.
        inner = _lit_share(lit, *fan.pixels(*just_inside))
        outer = _lit_share(lit, *fan.pixels(*just_outside))
        ends_here.append((inner > 0.1) & (outer < 0.35 * inner))
    return float(np.mean(ends_here))


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
    """Pixels just inside and just outside the outline of a fan.

    (3, pieces, samples) each, indices of the flattened image, for both edges and the far arc; -1
    outside the image.
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
    """(_PIECES,) share of lit pixels of each piece of the outline; 0 outside the picture."""
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


def _largest_part(grey: Bytes, spread: int) -> Bytes | None:
    """What is largest on a flat ground, alone on black: a fan amid text and panels."""
    rim = np.ones(grey.shape, bool)
    rim[1:-1, 1:-1] = False
    ground = int(np.median(grey[rim]))
    shown = grey
    if ground > spread:
        # What reaches in from the picture's border.
        alike = (np.abs(grey.astype(np.int16) - ground) <= spread).astype(np.uint8)
        _, parts = cv2.connectedComponents(alike, connectivity=4)
        shown = np.where(np.isin(parts, np.setdiff1d(parts[rim], 0)), 0, grey).astype(np.uint8)
    closed = cv2.morphologyEx(
        (shown > spread).astype(np.uint8), cv2.MORPH_CLOSE, np.ones((7, 7), np.uint8)
    )
    count, parts, stats, _ = cv2.connectedComponentsWithStats(closed, connectivity=4)
    if count < (2 if ground > spread else 3):
        return None  # a single one on black is no other picture than before
    largest = 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
    share = stats[largest, cv2.CC_STAT_AREA] / grey.size
    alone = np.where(parts == largest, shown, 0).astype(np.uint8)
    return alone if _LEAST_PART <= share <= _MOST_PART else None


_SIDE = 160  # the picture is made about this large for the first guess
_NONE = 1e15  # cost of an outline that is no sector
_LEAST_SPREAD = 1.0  # of the costs of a simplex that has converged
_LEAST_DISTANCE = 0.05  # of its corners


def fit_sector(lit: npt.NDArray[np.bool_]) -> Sector | None:
    """The sector that best separates lit from black pixels, (H, W); None where there is none."""
    guess = _first_guess(lit)
    if guess is None:
        return None
    outline, rows, cell = guess
    fit = _Likelihood(lit, rows)
    # Twice: after the first the shares inside and outside are known better.
    for size_px in (cell, 1.0):
        if not fit.learn(outline):
            return None
        outline = fit.improve(outline, size_px, squeezed=False)
    squeezed = fit.improve(outline, 0.5, squeezed=True)
    # Pixels are square unless the arcs say plainly that they are not: by this log-likelihood.
    changed, square = fit.costs([squeezed.tolist(), outline.tolist()])
    outline = squeezed if changed < square - 30.0 else outline
    return _sector(fit.polish(outline).tolist(), rows)


def _first_guess(lit: npt.NDArray[np.bool_]) -> tuple[Numbers, tuple[float, float], float] | None:
    """(outline, its two rows, pixels a cell) from the picture made small.

    The outline: columns of the left edge at two rows, columns of the right edge at these, rows of
    the far and the near arc in the sonar's column, logarithm of the squeeze.
    """
    height, width = lit.shape
    scale = max(1, math.ceil(max(height, width) / _SIDE))
    size = math.ceil(width / scale), math.ceil(height / max(1, math.ceil(height / _SIDE)))
    share = cv2.resize(lit.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    share = cv2.blur(share, (3, 3))
    some = share[share > 0.05]
    if some.size < 20:
        return None
    dense = (share > 0.4 * np.median(some)).astype(np.uint8)
    dense = cv2.morphologyEx(dense, cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8))
    count, labels, stats, _ = cv2.connectedComponentsWithStats(dense, connectivity=8)
    part = labels == 1 + np.argmax(stats[1:, cv2.CC_STAT_AREA]) if count > 1 else labels > 0
    if part.mean() < 0.03:
        return None
    rows = np.flatnonzero(part.any(axis=1))
    last_column = part.shape[1] - 1
    left, mirrored = (_edge(rows, mask.argmax(axis=1)) for mask in (part[rows], part[rows, ::-1]))
    if left is None or mirrored is None or left[0] + mirrored[0] <= 1e-3:
        return None
    right = np.array([-mirrored[0], last_column - mirrored[1]])
    apex_row = (right[1] - left[1]) / (left[0] - right[0])
    apex_column = int(np.clip(np.polyval(left, apex_row), 1, last_column - 1))
    ahead = np.flatnonzero(part[:, apex_column - 1 : apex_column + 2].any(axis=1))
    if not len(ahead):
        return None
    across = width / size[0]
    along = height / size[1]
    pair = np.array([rows[len(rows) // 4], rows[-1]], float)
    columns = [(np.polyval(line, pair) + 0.5) * across - 0.5 for line in (left, right)]
    arcs = (np.array([ahead[0], ahead[-1]]) + 0.5) * along - 0.5
    upper, lower = (pair + 0.5) * along - 0.5
    return np.concatenate([*columns, arcs, [0.0]]), (float(upper), float(lower)), float(scale)


def _edge(rows: npt.NDArray[np.intp], columns: npt.NDArray[np.intp]) -> Numbers | None:
    """(columns a row, column in row 0) of the line from the outermost column down."""
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
    return np.asarray(line)


def _sector(outline: Sequence[float], rows: tuple[float, float]) -> Sector | None:
    """The sector of an outline; None where its edges do not meet below.

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
    if not (far > near and 1 / _MOST_SQUEEZE < squeeze < _MOST_SQUEEZE):
        return None
    return apex_x, apex_y, far, near, -left / squeeze, -right / squeeze, squeeze


class _Likelihood:
    """How badly an outline tells lit from black, to be made small; a fit asks two thousand times.

    A lit pixel inside gains and a black one costs, by logarithms of likelihood ratios.
    """

    def __init__(self, lit: npt.NDArray[np.bool_], rows: tuple[float, float]) -> None:
        """rows: see `_first_guess`."""
        height, self._width = lit.shape
        # How many of the pixels above each row's upper border are lit, and the last row once more.
        above = np.zeros((height + 2, self._width), np.int32)
        np.cumsum(lit, axis=0, dtype=np.int32, out=above[1:-1])
        above[-1] = above[-2]
        self._above = above.ravel()
        self._height = height
        self._rows = rows
        self._pixels = lit.size
        self._lit = int(above[-1].sum())

    def learn(self, outline: Numbers) -> bool:
        """Take the shares of lit pixels inside and outside `outline`; False if it parts nothing."""
        sector = _sector(outline.tolist(), self._rows)
        if sector is None:
            return False
        area, lit = self.inside([sector], 1, False)[:, 0].tolist()
        inside = float(np.clip(lit / max(area, 1.0), 0.05, 0.97))
        outside = max(self._pixels - area, 1.0)
        outside = float(np.clip((self._lit - lit) / outside, 1e-3, 0.05))
        if inside <= outside:
            return False
        self._gain = math.log(inside / outside)
        self._price = math.log((1 - outside) / (1 - inside))
        return True

    def inside(self, sectors: Sequence[Sector], step: int, whole: bool) -> Numbers:
        """Pixels in each of N sectors, and lit ones, of every `step`-th column; (2, N).

        whole: a pixel counts if its centre is in the sector; else parts of pixels count as such,
        which is smoother and draws the outline outward.
        """
        columns = np.arange(step // 2, self._width, step)
        borders = np.empty((2, 2, len(sectors), len(columns)))
        rows, lit = borders
        # Pixel r reaches from r - 0.5 to r + 0.5.
        np.add(limits(np.array(sectors), columns.astype(np.float64)), 0.5, out=rows)
        if whole:
            rows[0] = np.ceil(rows[0] - 0.5)
            rows[1] = np.floor(rows[1] + 0.5)
        np.minimum(np.maximum(rows, 0.0, out=rows), self._height, out=rows)
        np.minimum(rows[0], rows[1], out=rows[0])  # nothing where last < first
        at = rows.astype(np.int64)
        part = rows - at
        at = at * self._width + columns
        above = self._above.take(at)
        lit[:] = part * (self._above.take(at + self._width) - above) + above
        # One after the other, so that the sums do not depend on how NumPy splits them.
        sums: Numbers = (borders[:, 1] - borders[:, 0]).cumsum(axis=-1)[..., -1]
        return sums

    def costs(self, outlines: Sequence[Sequence[float]], whole: bool = False) -> Numbers:
        """Minus the logarithms of their likelihoods, but for a constant."""
        sectors = [_sector(outline, self._rows) for outline in outlines]
        valid = [sector for sector in sectors if sector is not None]
        costs = np.full(len(sectors), _NONE)
        if valid:
            step = max(1, self._width // 400)
            area, lit = self.inside(valid, step, whole)
            valid_costs = (self._price * (area - lit) - self._gain * lit) * step
            costs[[sector is not None for sector in sectors]] = valid_costs
        return costs

    def improve(self, outline: Numbers, size_px: float, squeezed: bool) -> Numbers:
        """The likeliest outline nearby; `size_px`: of the first steps; squeezed: of any squeeze."""
        free = 7 if squeezed else 6
        steps = np.diag([size_px] * 6 + [0.05])[:free, :free]
        fixed = outline[free:].tolist()
        simplex = np.vstack([outline[:free], outline[:free] + steps])
        best = _lowest(lambda values: self.costs([values.tolist() + fixed])[0], simplex, 40 * free)
        return np.concatenate([best, outline[free:]])

    def polish(self, outline: Numbers) -> Numbers:
        """Each end of an edge and each arc moved by itself to where it fits best."""
        outline = outline.copy()
        # The arcs first, from further away: a short one has hardly any weight until here.
        for reach_px, parts in ((8.0, (5, 4)), (1.5, range(6)), (0.5, range(6))):
            moves = np.linspace(-reach_px, reach_px, 21)
            for at in parts:
                tried = np.repeat(outline[None], len(moves), axis=0)
                tried[:, at] += moves
                costs = self.costs(tried.tolist(), whole=True)
                # The middle of the places that are as good as the best.
                outline = tried[costs <= costs.min() + 1e-6].mean(axis=0)
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
        """Whether no corner is more than .05 away from the best, and none costs 1 more."""
        spread = self.costs[-1] - self.costs[0]
        distance = np.abs(self.corners[1:] - self.corners[0]).max()
        return bool(spread <= _LEAST_SPREAD and distance <= _LEAST_DISTANCE)

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
        """The worst corner, moved through the middle of the others and beyond by such a share."""
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


def limits(sectors: Numbers, x: Numbers) -> Numbers:
    """First and last row of each sector, (N, 7), in each column, (W,); last < first outside it.

    (2, N, W), fractions of a row.
    """
    apex_x, apex_y, _, _, *_, squeeze = by_name = sectors.T[..., None]
    across = (x - apex_x) / squeeze
    ahead: Numbers = np.sqrt(np.maximum(np.square(by_name[2:4]) - across * across, 0.0))
    # An edge lies ahead on its own side alone.
    ahead[1] = np.maximum(ahead[1], (across / by_name[4:6]).max(axis=0))
    return np.asarray(apex_y - ahead)


_WHITE = 200  # of 255
_LEAST_DEG = 3.0  # smallest angle between a side line and the rows of the image
_MOST_DEG = 75.0  # largest
_ALIKE_DEG = 1.0  # by which both angles may differ
_TRIED = 8  # of the longest lines
_ARC_SHARE = 0.35  # of an arc within the picture that must be white


def _find_drawn(grey: Bytes) -> FanGeometry | None:
    """The fan between two white lines as far as the outermost arc."""
    mask = (grey >= _WHITE).astype(np.uint8)
    # Echoes and panels are as wide as that, lines are not.
    lines = mask - cv2.morphologyEx(mask, cv2.MORPH_OPEN, np.ones((9, 9), np.uint8))
    height, width = lines.shape
    if lines.mean() > 0.05:  # where more is thin and bright, it is speckle
        return None
    # A fifth of the width or longer; there may be 12 pixels between the sonar and where one begins.
    segments = cv2.HoughLinesP(lines, 1, math.radians(0.25), 100, None, 0.2 * width, 12.0)
    sides: tuple[list[tuple[float, ...]], ...] = [], []
    for x1, y1, x2, y2 in () if segments is None else segments.reshape(-1, 4).astype(float):
        slope = math.degrees(math.atan2(y2 - y1, x2 - x1))  # x1 <= x2
        if _LEAST_DEG <= abs(slope) <= _MOST_DEG:
            sides[slope < 0].append((math.hypot(x2 - x1, y2 - y1), slope, x1, y1))
    longest = (sorted(side, reverse=True)[:_TRIED] for side in sides)
    for (_, down, x1, y1), (_, up, x2, y2) in product(*longest):
        # Where both meet is the sonar.
        fall = math.tan(math.radians(down))
        rise = math.tan(math.radians(up))
        x = (y2 - y1 + fall * x1 - rise * x2) / (fall - rise)
        y = y1 + fall * (x - x1)
        if abs(down + up) > _ALIKE_DEG or not (0 < x < width and height / 2 < y < height):
            continue
        half = math.pi / 2 - math.radians(down - up) / 2
        far = _farthest_arc(lines, x, y, half)
        if far is not None:
            return FanGeometry.fan(2 * half, apex_x_px=x, apex_y_px=y, near_px=0.0, far_px=far)
    return None


def _farthest_arc(lines: npt.NDArray[Any], x: float, y: float, half: float) -> float | None:
    """Radius of the outermost circle about the sonar that is drawn in the fan."""
    height, width = lines.shape
    bearings = np.linspace(-half, half, 720)[10:-10]
    radii = np.arange(height / 4, math.hypot(width, height))[:, None]
    lit, is_inside = _at(
        cv2.dilate(lines, np.ones((3, 3), np.uint8)),
        y - radii * np.cos(bearings),
        x + radii * np.sin(bearings),
    )
    count = is_inside.sum(axis=1)
    share = np.where(count >= 180, lit.sum(axis=1) / np.maximum(count, 1), 0)
    arcs = np.flatnonzero(share >= _ARC_SHARE)
    return float(radii[arcs[-1], 0]) if len(arcs) else None
