"""The lowest point of a function of a few parameters, by the simplex search of Nelder and Mead."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable

import numpy as np

from ....factory.common.array_types import Float64s

# Largest differences from the best corner in a simplex that has converged: of costs, and of
# parameters (pixels, or the logarithm of the squeeze).
_CONVERGED_COST = 1.0
_CONVERGED_DISTANCE = 0.05


def find_lowest_point(
    cost: Callable[[Float64s], float], corners: Float64s, max_evaluations: int
) -> Float64s:
    """The point of lowest cost near a simplex (N + 1, N), by about `max_evaluations`.

    SciPy sorts corners of equal cost in an order that depends on the processor, which moved 115 of
    309 outlines by up to 3 pixels, and takes .3 s to import.  Here equal costs keep their order.
    """
    simplex = _Simplex(cost, corners)
    while not simplex.has_converged and simplex.evaluations < max_evaluations:
        if not simplex.step(max_evaluations):
            break
    return np.asarray(simplex.corners[0])


class _Simplex:
    """The simplex of Nelder and Mead 1965, with the parameters of Gao and Han 2012.

    corners: (N + 1, N), the best first.  costs: of each.  evaluations: of the cost so far.
    """

    def __init__(self, cost: Callable[[Float64s], float], corners: Float64s) -> None:
        self._cost = cost
        size = corners.shape[1]
        self._size = size
        self._expansion = 1 + 2 / size
        self._contraction = 0.75 - 1 / (2 * size)
        self._shrinkage = 1 - 1 / size
        self.evaluations = 0
        self.corners = corners
        self.costs = [self._evaluate(corner) for corner in corners]
        self._sort()

    @property
    def has_converged(self) -> bool:
        """Whether all corners are close to the best one and cost about as much."""
        if self.costs[-1] - self.costs[0] > _CONVERGED_COST:
            return False
        distance = np.abs(self.corners[1:] - self.corners[0]).max()
        return bool(distance <= _CONVERGED_DISTANCE)

    def step(self, max_evaluations: int) -> bool:
        """Move the worst corner, or all but the best; False where no evaluations are left."""
        middle = np.add.reduce(self.corners[:-1]) / self._size
        reflected = self._opposite(middle, 1.0)
        reflected_cost = self._evaluate(reflected)
        if self.costs[0] <= reflected_cost < self.costs[-2]:
            self._replace_worst(reflected, reflected_cost)
            return True
        if self.evaluations >= max_evaluations:
            return False

        if reflected_cost < self.costs[0]:
            expanded = self._opposite(middle, self._expansion)
            expanded_cost = self._evaluate(expanded)
            if expanded_cost < reflected_cost:
                self._replace_worst(expanded, expanded_cost)
            else:
                self._replace_worst(reflected, reflected_cost)
            return True

        # Outside where reflecting gained something, else between the worst corner and the others.
        is_outside = reflected_cost < self.costs[-1]
        share = self._contraction if is_outside else -self._contraction
        contracted = self._opposite(middle, share)
        contracted_cost = self._evaluate(contracted)
        if contracted_cost <= reflected_cost and contracted_cost < self.costs[-1]:
            self._replace_worst(contracted, contracted_cost)
        else:
            self._shrink()
        return True

    def _opposite(self, middle: Float64s, share: float) -> Float64s:
        """The worst corner, moved along the line through the middle of the others.

        share: how far beyond the middle, as a part of its distance from there; negative: short of
        the middle.
        """
        return np.asarray((1 + share) * middle - share * self.corners[-1])

    def _evaluate(self, corner: Float64s) -> float:
        self.evaluations += 1
        return self._cost(corner)

    def _replace_worst(self, corner: Float64s, cost: float) -> None:
        """Put a corner in its place, behind those of equal cost; the worst one drops out."""
        place = bisect_right(self.costs, cost, hi=self._size)
        self.costs.insert(place, cost)
        self.costs.pop()
        self.corners[place + 1 :] = self.corners[place:-1]
        self.corners[place] = corner

    def _shrink(self) -> None:
        """Move all corners towards the best."""
        best = self.corners[0]
        self.corners[1:] = best + self._shrinkage * (self.corners[1:] - best)
        self.costs[1:] = [self._evaluate(corner) for corner in self.corners[1:]]
        self._sort()

    def _sort(self) -> None:
        by_cost = np.argsort(self.costs, kind="stable")
        self.corners = self.corners[by_cost]
        self.costs = [self.costs[index] for index in by_cost]
