"""Masks as polygons along the edges of their pixels, as COCO and YOLO state the shape of objects.

A pixel (column c, row r) covers c to c + 1 and r to r + 1.  Neither format knows holes, and YOLO
knows one ring an object: rings are joined by slits, lines that are walked there and back and
enclose nothing.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

Ring = npt.NDArray[np.int64]
"""(corners, 2) columns and rows of corners of pixels; the last is joined to the first."""


def outlines(mask: npt.NDArray[np.bool_]) -> list[Ring]:
    """(H, W) -> one ring for each part whose pixels touch, also at corners; holes by slits.

    Filled by the even-odd rule, the rings give the mask back without a pixel lost.
    """
    # Of pixels of twice the number, the outer ones say which side of their pixel lies outside.
    double = np.repeat(np.repeat(mask.astype(np.uint8), 2, axis=0), 2, axis=1)
    found, tree = cv2.findContours(double, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    rings = [_corners(contour[:, 0].astype(np.int64)) for contour in found]
    return [
        joined([ring, *(rings[hole] for hole in range(len(rings)) if tree[0, hole, 3] == part)])
        for part, ring in enumerate(rings)
        if tree[0, part, 3] < 0
    ]


def joined(rings: Sequence[Ring]) -> Ring:
    """One ring that walks along all, from each to the next one at their nearest corners."""
    whole = rings[0]
    for ring in rings[1:]:
        apart, nearest = cKDTree(whole).query(ring)
        there = int(np.argmin(apart))
        here = int(nearest[there])
        around = np.roll(ring, -there, axis=0)
        whole = np.concatenate([whole[: here + 1], around, around[:1], whole[here:]])
    return whole


def _corners(contour: Ring) -> Ring:
    """Outer pixels at twice the number -> corners of pixels, of straight lines the ends alone."""
    corners = (contour + 1) // 2
    corners = corners[np.any(corners != np.roll(corners, 1, axis=0), axis=1)]
    step = corners - np.roll(corners, 1, axis=0)
    ahead = np.roll(step, -1, axis=0)
    turns = step[:, 0] * ahead[:, 1] != step[:, 1] * ahead[:, 0]
    back = np.any(step * ahead < 0, axis=1)
    return np.asarray(corners[turns | back])
