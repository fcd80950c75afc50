"""The outline of a fan that best tells lit pixels from black ones.

A pixel is lit with one probability inside the sector and with another outside; the outline with the
greatest likelihood wins.  So holes (shadows, noise that reaches zero) and specks (ringing of JPEG
or MPEG, text) cost little each.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

Numbers = npt.NDArray[np.float64]

_SIDE = 160  # the picture is made about this large for the first guess
_LEAST_AREA = 0.03  # of the picture
_PLAINLY = 30.0  # logarithm of a likelihood ratio
_MOST_SQUEEZE = 2.0


def fit_sector(lit: npt.NDArray[np.bool_]) -> Numbers | None:
    """The sector that best separates lit from black pixels, None where there is none.

    lit: (H, W).  The numbers are those of `_sector`.
    """
    guess = _first_guess(lit)
    if guess is None:
        return None
    outline, rows, cell = guess
    above = lit_above(lit)
    coarse = _objective(above, outline, rows)
    if coarse is None:
        return None
    outline = coarse.improve(outline, cell, squeezed=False)
    # Now that the shares inside and outside are known better.
    objective = _objective(above, outline, rows)
    if objective is None:
        return None
    outline = objective.improve(outline, 1.0, squeezed=False)
    squeezed = objective.improve(outline, 0.5, squeezed=True)
    # Pixels are square unless the arcs say plainly that they are not.
    if objective.cost(squeezed) < objective.cost(outline) - _PLAINLY:
        outline = squeezed
    outline = objective.polish(outline)
    return _sector(outline, rows)


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
    if count < 2:
        return None
    part = labels == 1 + np.argmax(stats[1:, cv2.CC_STAT_AREA])
    if part.mean() < _LEAST_AREA:
        return None
    rows = np.flatnonzero(part.any(axis=1))
    first = part[rows].argmax(axis=1)
    last = part.shape[1] - 1 - part[rows, ::-1].argmax(axis=1)
    left, right = _edge(rows, first), _edge(rows, part.shape[1] - 1 - last)
    if left is None or right is None:
        return None
    right = np.array([-right[0], part.shape[1] - 1 - right[1]])
    if left[0] - right[0] <= 1e-3:
        return None
    apex_row = (right[1] - left[1]) / (left[0] - right[0])
    apex_column = int(np.clip(np.polyval(left, apex_row), 1, part.shape[1] - 2))
    ahead = np.flatnonzero(part[:, apex_column - 1 : apex_column + 2].any(axis=1))
    if not len(ahead):
        return None
    across, along = width / size[0], height / size[1]
    pair = np.array([rows[len(rows) // 4], rows[-1]], float)
    columns = [(np.polyval(line, pair) + 0.5) * across - 0.5 for line in (left, right)]
    arcs = (np.array([ahead[0], ahead[-1]]) + 0.5) * along - 0.5
    upper, lower = (pair + 0.5) * along - 0.5
    return np.concatenate([*columns, arcs, [0.0]]), (float(upper), float(lower)), float(scale)


def _edge(rows: npt.NDArray[np.intp], columns: npt.NDArray[np.intp]) -> Numbers | None:
    """(columns a row, column in row 0) of the line from the outermost column down."""
    corner = int(np.flatnonzero(columns <= columns.min()).max())
    y, x = rows[corner + 1 : -1].astype(float), columns[corner + 1 : -1].astype(float)
    if len(y) < 6:
        return None
    weights = np.ones(len(y))
    for _ in range(4):
        line = np.polyfit(y, x, 1, w=weights)
        off = np.abs(np.polyval(line, y) - x)
        weights = 1 / (1 + (off / max(0.7, 1.5 * float(np.median(off)))) ** 2)
    return np.asarray(line)


def _sector(outline: Numbers, rows: tuple[float, float]) -> Numbers | None:
    """apex_x, apex_y, far_px, near_px, tangents of the edges' bearings, squeeze."""
    upper, lower = rows
    left = (outline[1] - outline[0]) / (lower - upper)
    right = (outline[3] - outline[2]) / (lower - upper)
    if not (left > 1e-3 and right < -1e-3):
        return None
    apex_y = upper + (outline[2] - outline[0]) / (left - right)
    apex_x = outline[0] + left * (apex_y - upper)
    squeeze = math.exp(outline[6])
    far, near = apex_y - outline[4], max(apex_y - outline[5], 0.0)
    if not (far > near and 1 / _MOST_SQUEEZE < squeeze < _MOST_SQUEEZE):
        return None
    return np.array([apex_x, apex_y, far, near, -left / squeeze, -right / squeeze, squeeze])


def _objective(
    above: npt.NDArray[np.int32], outline: Numbers, rows: tuple[float, float]
) -> _Objective | None:
    """With the shares of lit pixels inside and outside `outline`; None if it parts nothing."""
    sector = _sector(outline, rows)
    if sector is None:
        return None
    lit, area = lit_inside(above, sector, 1, False)
    outside = above.size - above.shape[1] - area
    inside_share = float(np.clip(lit / max(area, 1.0), 0.05, 0.97))
    outside_share = float(np.clip((above[-1].sum() - lit) / max(outside, 1.0), 1e-3, 0.05))
    if inside_share <= outside_share:
        return None
    gain = math.log(inside_share / outside_share)
    price = math.log((1 - outside_share) / (1 - inside_share))
    return _Objective(above, rows, gain, price)


@dataclass(frozen=True)
class _Objective:
    """How badly an outline tells lit from black, to be made small.

    above: see `lit_above`.  rows: see `_first_guess`.
    gain, price: of a lit and of a black pixel inside, logarithms of likelihood ratios.
    """

    above: npt.NDArray[np.int32]
    rows: tuple[float, float]
    gain: float
    price: float

    def cost(self, outline: Numbers, whole: bool = False) -> float:
        """Minus the logarithm of the likelihood, but for a constant."""
        sector = _sector(outline, self.rows)
        if sector is None:
            return 1e15
        step = max(1, self.above.shape[1] // 400)
        lit, area = lit_inside(self.above, sector, step, whole)
        return float(self.price * (area - lit) - self.gain * lit) * step

    def improve(self, outline: Numbers, size_px: float, squeezed: bool) -> Numbers:
        """The likeliest outline nearby; `size_px`: of the first steps; squeezed: of any squeeze."""
        free = 7 if squeezed else 6
        steps = np.diag([size_px] * 6 + [0.05])[:free, :free]

        def cost(values: Numbers) -> float:
            return self.cost(np.concatenate([values, outline[free:]]))

        simplex = np.vstack([outline[:free], outline[:free] + steps])
        best = _lowest(cost, simplex, most=40 * free)
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
                costs = np.array([self.cost(one, whole=True) for one in tried])
                # The middle of the places that are as good as the best.
                outline = tried[costs <= costs.min() + 1e-6].mean(axis=0)
        return outline


def _lowest(cost: Callable[[Numbers], float], simplex: Numbers, most: int) -> Numbers:
    """Where the cost is lowest near a simplex (N + 1, N), by at most `most` looks at it.

    Nelder and Mead 1965 with the parameters of Gao and Han 2012; it stops where no corner is more
    than .05 away and 1 above.  SciPy has it, too, and takes a third of a second to import.
    """
    size = simplex.shape[1]
    expand, contract, shrink = 1 + 2 / size, 0.75 - 1 / (2 * size), 1 - 1 / size
    corners = simplex.copy()
    costs = np.full(len(corners), np.inf)
    looks = 0

    def look(at: Numbers) -> float:
        nonlocal looks
        if looks >= most:
            raise StopIteration
        looks += 1
        return cost(at)

    def order() -> None:
        by = np.argsort(costs)
        corners[:], costs[:] = corners[by], costs[by]

    try:
        for number, corner in enumerate(corners):
            costs[number] = look(corner)
        order()
        while True:
            wide = np.abs(corners[1:] - corners[0]).max() > 0.05
            if not wide and np.abs(costs[1:] - costs[0]).max() <= 1.0:
                break
            middle, worst = corners[:-1].mean(axis=0), corners[-1]
            tried = 2 * middle - worst
            found = look(tried)
            if found < costs[0]:
                further = (1 + expand) * middle - expand * worst
                there = look(further)
                if there < found:
                    tried, found = further, there
            elif found >= costs[-2]:
                outside = found < costs[-1]
                limit = found if outside else costs[-1]
                part = contract if outside else -contract
                tried = (1 + part) * middle - part * worst
                found = look(tried)
                if found > limit or (not outside and found == limit):
                    for number in range(1, len(corners)):
                        corners[number] = corners[0] + shrink * (corners[number] - corners[0])
                        costs[number] = look(corners[number])
                    order()
                    continue
            corners[-1], costs[-1] = tried, found
            order()
    except StopIteration:
        order()
    return np.asarray(corners[0])


def column_limits(fan: Numbers, x: Numbers) -> tuple[Numbers, Numbers]:
    """First and last row of the sector in each column; last < first where it has none.

    fan: apex_x, apex_y, far_px, near_px, tangents of the left and the right edge's bearings, and
        pixels along x for one along y.
    x: (W,) columns.  Returns (W,) fractions of a row, twice.
    """
    apex_x, apex_y, far, near, left, right, squeeze = fan
    across = (x - apex_x) / squeeze
    ahead_far = np.sqrt(np.maximum(far * far - across * across, 0.0))
    ahead_near = np.sqrt(np.maximum(near * near - across * across, 0.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        edge = np.where(across < 0, across / left, across / right)
    return apex_y - ahead_far, apex_y - np.maximum(edge, ahead_near)


def lit_above(lit: npt.NDArray[np.bool_]) -> npt.NDArray[np.int32]:
    """(H + 1, W) int32: how many of the pixels above each row's upper border are lit."""
    count = np.zeros((lit.shape[0] + 1, lit.shape[1]), np.int32)
    np.cumsum(lit, axis=0, dtype=np.int32, out=count[1:])
    return count


def lit_inside(
    above: npt.NDArray[np.int32], fan: Numbers, step: int, whole: bool
) -> tuple[float, float]:
    """(lit pixels, pixels) in the sector, of every `step`-th column.

    above: see `lit_above`.  fan: see `column_limits`.  whole: a pixel counts if its centre is in
    the sector; else parts of pixels count as such, which is smoother and draws the outline outward.
    """
    height = above.shape[0] - 1
    columns = np.arange(step // 2, above.shape[1], step)
    # Pixel r reaches from r - 0.5 to r + 0.5.
    first, last = (limit + 0.5 for limit in column_limits(fan, columns.astype(np.float64)))
    if whole:
        first, last = np.ceil(first - 0.5), np.floor(last + 0.5)
    first, last = np.clip(first, 0.0, height), np.clip(last, 0.0, height)
    apex_x, far, squeeze = fan[0], fan[2], fan[6]
    across = (columns - apex_x) / squeeze
    shown = (last > first) & (across * across < far * far)
    if not shown.any():
        return 0.0, 0.0
    columns, first, last = columns[shown], first[shown], last[shown]
    terms = np.empty((len(columns), 4))
    for at, (rows, sign) in enumerate(((last, 1.0), (first, -1.0))):
        row = rows.astype(np.int64)
        here, below = above[row, columns], above[np.minimum(row + 1, height), columns]
        terms[:, 2 * at] = sign * here
        terms[:, 2 * at + 1] = sign * (rows - row) * (below - here)
    # One after the other, so that the sums do not depend on how NumPy splits them.
    return float(np.cumsum(terms)[-1]), float(np.cumsum(last - first)[-1])
