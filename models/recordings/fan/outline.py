"""The outline of a fan that best tells lit pixels from black ones.

A pixel is lit with one probability inside the sector and with another outside; the outline with the
greatest likelihood wins.  So holes (shadows, noise that reaches zero) and specks (ringing of JPEG
or MPEG, text) cost little each.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

Numbers = npt.NDArray[np.float64]
Sector = tuple[float, float, float, float, float, float, float]
"""apex_x, apex_y, far_px, near_px, tangents of the left and the right edge's bearings, and pixels
along x for one along y."""

_SIDE = 160  # the picture is made about this large for the first guess
_LEAST_AREA = 0.03  # of the picture
_PLAINLY = 30.0  # logarithm of a likelihood ratio
_MOST_SQUEEZE = 2.0
_NONE = 1e15  # cost of an outline that is no sector


def fit_sector(lit: npt.NDArray[np.bool_]) -> Sector | None:
    """The sector that best separates lit from black pixels, (H, W); None where there is none."""
    guess = _first_guess(lit)
    if guess is None:
        return None
    outline, rows, cell = guess
    counts = _Counts(lit)
    coarse = _objective(counts, outline, rows)
    if coarse is None:
        return None
    outline = coarse.improve(outline, cell, squeezed=False)
    # Now that the shares inside and outside are known better.
    objective = _objective(counts, outline, rows)
    if objective is None:
        return None
    outline = objective.improve(outline, 1.0, squeezed=False)
    squeezed = objective.improve(outline, 0.5, squeezed=True)
    # Pixels are square unless the arcs say plainly that they are not.
    changed, square = objective.costs([squeezed.tolist(), outline.tolist()])
    if changed < square - _PLAINLY:
        outline = squeezed
    return _sector(objective.polish(outline).tolist(), rows)


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
    far, near = apex_y - outline[4], max(apex_y - outline[5], 0.0)
    if not (far > near and 1 / _MOST_SQUEEZE < squeeze < _MOST_SQUEEZE):
        return None
    return apex_x, apex_y, far, near, -left / squeeze, -right / squeeze, squeeze


def _objective(counts: _Counts, outline: Numbers, rows: tuple[float, float]) -> _Objective | None:
    """With the shares of lit pixels inside and outside `outline`; None if it parts nothing."""
    sector = _sector(outline.tolist(), rows)
    if sector is None:
        return None
    area, lit = counts.inside([sector], 1, False)[:, 0].tolist()
    inside_share = float(np.clip(lit / max(area, 1.0), 0.05, 0.97))
    outside = max(counts.pixels - area, 1.0)
    outside_share = float(np.clip((counts.lit - lit) / outside, 1e-3, 0.05))
    if inside_share <= outside_share:
        return None
    gain = math.log(inside_share / outside_share)
    price = math.log((1 - outside_share) / (1 - inside_share))
    return _Objective(counts, rows, gain, price)


@dataclass(frozen=True)
class _Objective:
    """How badly an outline tells lit from black, to be made small.

    rows: see `_first_guess`.
    gain, price: of a lit and of a black pixel inside, logarithms of likelihood ratios.
    """

    counts: _Counts
    rows: tuple[float, float]
    gain: float
    price: float

    def costs(self, outlines: Sequence[Sequence[float]], whole: bool = False) -> Numbers:
        """Minus the logarithms of their likelihoods, but for a constant."""
        sectors = [_sector(outline, self.rows) for outline in outlines]
        there = [sector for sector in sectors if sector is not None]
        costs = np.full(len(sectors), _NONE)
        if there:
            step = max(1, self.counts.width // 400)
            area, lit = self.counts.inside(there, step, whole)
            found = (self.price * (area - lit) - self.gain * lit) * step
            costs[[sector is not None for sector in sectors]] = found
        return costs

    def improve(self, outline: Numbers, size_px: float, squeezed: bool) -> Numbers:
        """The likeliest outline nearby; `size_px`: of the first steps; squeezed: of any squeeze."""
        free = 7 if squeezed else 6
        steps = np.diag([size_px] * 6 + [0.05])[:free, :free]
        fixed = outline[free:].tolist()
        simplex = np.vstack([outline[:free], outline[:free] + steps])

        def cost(values: Numbers) -> float:
            return float(self.costs([values.tolist() + fixed])[0])

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
                costs = self.costs(tried.tolist(), whole=True)
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
    costs = [cost(corner) for corner in simplex]
    looks = len(costs)
    by = np.argsort(costs, kind="stable")
    corners, costs = simplex[by], [costs[place] for place in by]
    while looks < most:
        if costs[-1] - costs[0] <= 1.0 and np.abs(corners[1:] - corners[0]).max() <= 0.05:
            break
        middle, worst = np.add.reduce(corners[:-1]) / size, corners[-1]
        tried = 2 * middle - worst
        found = cost(tried)
        looks += 1
        if costs[0] <= found < costs[-2]:
            pass
        elif looks >= most:
            break
        elif found < costs[0]:
            further = (1 + expand) * middle - expand * worst
            there = cost(further)
            looks += 1
            if there < found:
                tried, found = further, there
        else:
            outside = found < costs[-1]
            limit = found if outside else costs[-1]
            part = contract if outside else -contract
            tried = (1 + part) * middle - part * worst
            found = cost(tried)
            looks += 1
            if found > limit or (not outside and found == limit):
                for number in range(1, min(len(corners), most - looks + 1)):
                    corners[number] = corners[0] + shrink * (corners[number] - corners[0])
                    costs[number] = cost(corners[number])
                looks += size
                by = np.argsort(costs, kind="stable")
                corners, costs = corners[by], [costs[place] for place in by]
                continue
        place = bisect_right(costs, found, hi=size)
        corners[place + 1 :] = corners[place:-1].copy()
        corners[place] = tried
        costs[place:] = [found, *costs[place:-1]]
    return np.asarray(corners[0])


def limits(sectors: Numbers, x: Numbers) -> Numbers:
    """First and last row of each sector, (N, 7), in each column, (W,); last < first outside it.

    (2, N, W), fractions of a row.
    """
    apex_x, apex_y, _, _, *_, squeeze = by_name = sectors.T[..., None]
    across = (x - apex_x) / squeeze
    reach = np.square(by_name[2:4]) - across * across
    ahead: Numbers = np.sqrt(np.maximum(reach, 0.0, out=reach), out=reach)
    # An edge lies ahead on its own side alone.
    edges = across / by_name[4:6]
    np.maximum(ahead[1], np.maximum(edges[0], edges[1]), out=ahead[1])
    return np.subtract(apex_y, ahead, out=ahead)


class _Counts:
    """How many pixels of a picture are lit in a sector, quickly: a fit asks two thousand times.

    pixels, lit: of the whole picture.
    """

    def __init__(self, lit: npt.NDArray[np.bool_]) -> None:
        height, self.width = lit.shape
        # How many of the pixels above each row's upper border are lit, and the last row once more.
        above = np.zeros((height + 2, self.width), np.int32)
        np.cumsum(lit, axis=0, dtype=np.int32, out=above[1:-1])
        above[-1] = above[-2]
        self._above, self._height = above.ravel(), height
        self.pixels, self.lit = lit.size, int(above[-1].sum())

    def inside(self, sectors: Sequence[Sector], step: int, whole: bool) -> Numbers:
        """Pixels in each of N sectors, and lit ones, of every `step`-th column; (2, N).

        whole: a pixel counts if its centre is in the sector; else parts of pixels count as such,
        which is smoother and draws the outline outward.
        """
        columns = np.arange(step // 2, self.width, step)
        found = np.empty((2, 2, len(sectors), len(columns)))
        rows, lit = found
        # Pixel r reaches from r - 0.5 to r + 0.5.
        np.add(limits(np.array(sectors), columns.astype(np.float64)), 0.5, out=rows)
        if whole:
            rows[0], rows[1] = np.ceil(rows[0] - 0.5), np.floor(rows[1] + 0.5)
        np.maximum(rows, 0.0, out=rows)
        np.minimum(rows, self._height, out=rows)
        np.minimum(rows[0], rows[1], out=rows[0])  # nothing where last < first
        at = rows.astype(np.int64)
        part = rows - at
        at *= self.width
        at += columns
        here = self._above.take(at)
        at += self.width
        np.multiply(part, self._above.take(at) - here, out=lit)
        lit += here
        # One after the other, so that the sums do not depend on how NumPy splits them.
        sums: Numbers = (found[:, 1] - found[:, 0]).cumsum(axis=-1)[..., -1]
        return sums
