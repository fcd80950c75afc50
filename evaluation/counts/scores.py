"""IDF1 and HOTA of tracks, and errors of counts.

Identities: Ristani et al. 2016, "Performance measures and a data set for multi-target,
multi-camera tracking".  HOTA: Luiten et al. 2021.  Both agree with TrackEval, which needs a newer
NumPy than Blender has.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from ...factory.common.array_types import Float64s
from ...models.detection.boxes import Boxes, intersection_over_union

_LEVELS = tuple(np.arange(0.05, 0.99, 0.05).tolist())  # overlaps over which HOTA is a mean
_SAME_IOU = 0.5  # overlap from which on IDF1 calls boxes the same


class TrackedFrame(NamedTuple):
    """The objects of a frame: (N,) numbers of their tracks and (N, 4) boxes."""

    numbers: tuple[int, ...]
    boxes: Boxes


class TrackScores(NamedTuple):
    """How well tracks agree, each 0 to 1."""

    idf1: float
    hota: float


def score_tracks(truth: Sequence[TrackedFrame], found: Sequence[TrackedFrame]) -> TrackScores:
    """IDF1 and HOTA of one recording, frame by frame; NaN where both are empty."""
    overlaps = [
        np.asarray(intersection_over_union(true.boxes, seen.boxes), np.float64)
        for true, seen in zip(truth, found, strict=True)
    ]
    true_count = Counter(number for frame in truth for number in frame.numbers)
    found_count = Counter(number for frame in found for number in frame.numbers)
    if not true_count and not found_count:
        return TrackScores(float("nan"), float("nan"))
    if not true_count or not found_count:
        return TrackScores(0.0, 0.0)
    pairs = _Pairs(truth, found, overlaps, true_count, found_count)
    return TrackScores(pairs.idf1(), float(np.mean([pairs.hota(level) for level in _LEVELS])))


class _Pairs:
    """True and found tracks as rows and columns."""

    def __init__(
        self,
        truth: Sequence[TrackedFrame],
        found: Sequence[TrackedFrame],
        overlaps: Sequence[Float64s],
        true_count: Mapping[int, int],
        found_count: Mapping[int, int],
    ) -> None:
        row_of = {number: row for row, number in enumerate(true_count)}
        column_of = {number: column for column, number in enumerate(found_count)}
        self._shape = len(row_of), len(column_of)
        self._true_count = np.array(list(true_count.values()), np.float64)
        self._found_count = np.array(list(found_count.values()), np.float64)
        self._frames = [
            (
                np.array([row_of[number] for number in true.numbers], int),
                np.array([column_of[number] for number in seen.numbers], int),
                overlap,
            )
            for true, seen, overlap in zip(truth, found, overlaps, strict=True)
        ]

    def idf1(self) -> float:
        """Twice the frames that the best pairing of tracks shares over all true and found ones."""
        shared = np.zeros(self._shape)
        for rows, columns, overlap in self._frames:
            shared[np.ix_(rows, columns)] += overlap >= _SAME_IOU
        best = shared[linear_sum_assignment(-shared)].sum()
        return float(2 * best / (self._true_count.sum() + self._found_count.sum()))

    def hota(self, level: float) -> float:
        """Square root of detection accuracy times association accuracy at one overlap."""
        alignment = self._alignment()
        matches = np.zeros(self._shape)
        for rows, columns, overlap in self._frames:
            score = alignment[np.ix_(rows, columns)] * overlap
            own, other = linear_sum_assignment(-score)
            is_match = overlap[own, other] >= level - np.finfo(float).eps
            np.add.at(matches, (rows[own[is_match]], columns[other[is_match]]), 1)
        hits = matches.sum()
        missed = self._true_count.sum() - hits
        false = self._found_count.sum() - hits
        union = self._true_count[:, None] + self._found_count[None] - matches
        association = (matches * matches / np.maximum(union, 1)).sum() / max(hits, 1)
        return float(np.sqrt(hits / (hits + missed + false) * association))

    def _alignment(self) -> Float64s:
        """Overlap that two tracks share over all frames, as a Jaccard index."""
        shared = np.zeros(self._shape)
        for rows, columns, overlap in self._frames:
            total = overlap.sum(axis=0)[None] + overlap.sum(axis=1)[:, None] - overlap
            share = np.divide(overlap, total, out=np.zeros_like(overlap), where=total > 0)
            shared[np.ix_(rows, columns)] += share
        union = self._true_count[:, None] + self._found_count[None] - shared
        return np.asarray(shared / np.maximum(union, 1e-9))


def count_error(true: Mapping[str, int], found: Mapping[str, int]) -> int:
    """Sum over the directions of the difference between counted and true."""
    return sum(abs(found.get(key, 0) - true.get(key, 0)) for key in {*true, *found})
