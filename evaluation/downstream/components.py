"""Components of similarity: pictures that show nearly the same scene, and chains of them.

The pictures of a shuffled recording have near copies all over the folder.  A split that keeps every
component whole tests on none of them.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
import numpy.typing as npt

from ..filters.base import Gray

# Pixels: speckle lies below, the fan's outline and brightness above.
_FINE, _BROAD, _STEP = 4, 24, 8
_REACH = 2  # steps that a scene may have moved, either way
_LIT = 0.05


def similarity(images: Sequence[Gray]) -> npt.NDArray[np.float32]:
    """(N, N): the highest correlation of two pictures at any shift of up to 16 pixels.

    images: of one size.  What is compared lies between fine grain (a Gaussian of 4 pixels) and
    broad light (one of 24), inside the lit outline alone.  1 on the diagonal.
    """
    bands = np.stack([_band(image) for image in images])
    padded = np.pad(bands, ((0, 0), (_REACH, _REACH), (_REACH, _REACH)))
    height, width = bands.shape[1:]
    first = _normal(bands)
    best = np.full((len(images), len(images)), -1, np.float32)
    for down in range(2 * _REACH + 1):
        for right in range(2 * _REACH + 1):
            moved = padded[:, down : down + height, right : right + width]
            np.maximum(best, first @ _normal(moved).T, out=best)
    best = np.maximum(best, best.T)
    np.fill_diagonal(best, 1)
    return best


def components(alike: npt.NDArray[np.bool_]) -> npt.NDArray[np.int64]:
    """(N,) number of the component of each picture; (N, N) says which pairs are alike.

    The largest is 0, among equals the one with the earliest picture.
    """
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import connected_components

    _, found = connected_components(csr_matrix(alike), directed=False)
    _, first, sizes = np.unique(found, return_index=True, return_counts=True)
    rank = np.empty(len(sizes), np.int64)
    rank[np.lexsort((first, -sizes))] = np.arange(len(sizes))
    return np.asarray(rank[found])


def _band(image: Gray) -> npt.NDArray[np.float32]:
    lit = cv2.morphologyEx((image > 0).astype(np.float32), cv2.MORPH_CLOSE, np.ones((9, 9)))

    def smooth(sigma: float) -> npt.NDArray[np.float32]:
        share = np.maximum(cv2.GaussianBlur(lit, (0, 0), sigma), _LIT)
        return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma) / share, np.float32)

    return np.asarray(((smooth(_FINE) - smooth(_BROAD)) * lit)[::_STEP, ::_STEP])


def _normal(bands: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    flat = bands.reshape(len(bands), -1)
    flat = flat - flat.mean(axis=1, keepdims=True)
    return np.asarray(flat / np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-9))
