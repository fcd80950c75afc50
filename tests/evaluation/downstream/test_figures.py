"""Boxes, counts and figures against values made by hand."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from simnfnd.evaluation.downstream.boxes import boxes_of, hits, overlap, scored_boxes
from simnfnd.evaluation.downstream.counts import Counts, counts_of
from simnfnd.evaluation.downstream.figures import (
    AP_CLASSES,
    AP_OBJECTS,
    MIOU,
    OBJECTS,
    Draws,
    average_precision,
    drawn_figures,
    interval,
)
from simnfnd.evaluation.downstream.pictures import LEAST_CLASSES, WALL

Array = npt.NDArray[Any]


def certain(picture: Array) -> Array:
    """(classes, H, W) probabilities of a network that is sure of these classes."""
    classes = np.arange(LEAST_CLASSES)[:, None, None]
    return np.where(picture == classes, 0.89, 0.01).astype(np.float32)


def test_boxes_are_around_patches() -> None:
    mask = np.zeros((12, 12), np.bool_)
    mask[1:3, 1:4] = True
    mask[3, 4] = True  # by its corner
    mask[8:10, 6:8] = True
    mask[11, 0:3] = True  # three pixels are no object
    assert boxes_of(mask) == [(1, 1, 5, 4), (6, 8, 8, 10)]
    score = np.full(mask.shape, 0.5, np.float32)
    score[8:10, 6:8] = 0.75
    assert scored_boxes(mask, score) == [(0.75, (6, 8, 8, 10)), (0.5, (1, 1, 5, 4))]


def test_a_hit_overlaps_by_half_and_takes_what_it_hits() -> None:
    assert overlap((0, 0, 4, 4), (2, 0, 6, 4)) == pytest.approx(8 / 24)
    assert overlap((0, 0, 4, 4), (4, 0, 8, 4)) == 0
    there = [(0, 0, 4, 4), (10, 10, 14, 14)]
    found = [(0.9, (0, 0, 4, 3)), (0.8, (0, 0, 4, 4)), (0.7, (11, 11, 15, 15))]
    # The second comes late; the third has 9 of 23 pixels.
    assert hits(found, there) == [True, False, False]
    assert hits(found, []) == [False] * 3


def test_counts_of_a_picture() -> None:
    truth = np.zeros((8, 8), np.int64)
    truth[0:2, 0:2] = 1
    truth[6:8, :] = WALL
    found = truth.copy()
    found[0:2, 2] = 1  # two pixels too many
    found[4:6, 4:6] = 3  # a chain that is not there
    found[6:8, 0:4] = 3  # and one on the wall, which does not count against objects
    counts = counts_of(certain(found), truth)
    assert (counts.truth[0], counts.truth[1], counts.truth[WALL]) == (44, 4, 16)
    assert (counts.found[0], counts.found[1], counts.found[3]) == (38, 6, 12)
    assert (counts.hit[0], counts.hit[1], counts.hit[3], counts.hit[WALL]) == (38, 4, 0, 8)
    assert counts.objects == [4, 4, 10]
    assert [hit for _, hit in counts.boxes[0]] == [True, False]
    assert [hit for _, hit in counts.boxes[1]] == [True]
    assert [hit for _, hit in counts.boxes[3]] == [False]
    assert (counts.there[0], counts.there[1], counts.there[3], counts.there[WALL]) == (1, 1, 0, 1)
    assert Counts.from_json(json.loads(json.dumps(counts.to_json()))) == counts


def test_any_object_may_be_likelier_than_ground_though_no_class_is() -> None:
    likely = np.zeros((LEAST_CLASSES, 4, 4), np.float32)
    likely[0], likely[1], likely[2] = 0.4, 0.3, 0.3
    counts = counts_of(likely, np.ones((4, 4), np.int64))
    assert counts.found[0] == 16
    assert counts.objects == [16, 16, 16]
    ((score, hit),) = counts.boxes[0]
    assert hit
    assert score == pytest.approx(0.6)


def test_average_precision() -> None:
    score, hit = np.array([0.7, 0.9, 0.8]), np.array([1.0, 1.0, 0.0])
    weights = np.array([[1.0, 1, 1], [1, 0, 1], [1, 1, 0], [1, 1, 1]])
    found = average_precision(score, hit, np.array([2.0, 1, 2, 0]), weights)
    # Precision 1, 1/2, 2/3, made falling 1, 2/3, 2/3; without the first 0, 1/2; without the miss 1.
    np.testing.assert_allclose(found, [(1 + 2 / 3) / 2, 0.5, 1.0, np.nan])


def two_pictures() -> list[Counts]:
    """One whose bottle is found by half, one whose chain is not."""
    bottle, chain = np.zeros((8, 8), np.int64), np.zeros((8, 8), np.int64)
    bottle[0:4, 0:4], chain[0:2, 0:2] = 1, 3
    half = np.where(np.arange(8) < 2, bottle, 0)
    return [counts_of(certain(half), bottle), counts_of(certain(np.zeros_like(chain)), chain)]


def test_figures_of_draws() -> None:
    draws = Draws(
        np.array([0, 1]),
        np.array([[1.0, 1], [2, 0], [0, 2]]),
        np.array([[1.0, 1], [2, 0], [0, 2]]),
    )
    first = two_pictures()
    second = [counts_of(certain(np.zeros((8, 8), int)), np.zeros((8, 8), np.int64)), first[1]]
    both = [first, [first[0], first[1]]]
    found = drawn_figures(both, [0, 1, 3], draws)
    ground = [(48 + 60) / (64 + 56), 48 / 56, 60 / 64]
    np.testing.assert_allclose(found["iou_0"][0], ground)
    np.testing.assert_allclose(found["iou_1"][0], [0.5, 0.5, np.nan])
    np.testing.assert_allclose(found["iou_3"][0], [0, np.nan, 0])
    expected = [(ground[0] + 0.5) / 3, (ground[1] + 0.5) / 2, ground[2] / 2]
    np.testing.assert_allclose(found[MIOU][0], expected)
    np.testing.assert_allclose(found[OBJECTS][0], [8 / 20, 8 / 16, 0])
    np.testing.assert_allclose(found[AP_OBJECTS][0], [0.5, 1, 0])
    np.testing.assert_allclose(found[AP_CLASSES][0], [0.5, 1, 0])
    # Seeds count as often as they are drawn; the second finds no bottle in the first picture.
    differ = drawn_figures([first, [second[0], first[1]]], [0, 1, 3], draws)
    np.testing.assert_allclose(differ[OBJECTS][1], [8 / 20, 0])
    assert differ[OBJECTS][0][0] == pytest.approx((8 / 20 + 0) / 2)


def test_intervals() -> None:
    values = np.concatenate([[5.0], np.arange(1001) / 100, [np.nan]])
    found = interval(values, np.array([4.0, 6.0]))
    assert (found.value, found.seeds) == (5, (4, 6))
    assert [found.low, found.high] == pytest.approx([0.25, 9.75])
    assert np.isnan(interval(np.full(5, np.nan), np.array([np.nan])).value)


def test_draws_hold_whole_components_and_repeat() -> None:
    component = np.array([0, 0, 1, 2])
    draws = Draws.of(component, 3, 100, 7)
    assert draws.weights.shape == (101, 3)
    np.testing.assert_array_equal(draws.weights[0], 1)
    np.testing.assert_array_equal(draws.weights.sum(axis=1), 3)
    np.testing.assert_array_equal(draws.seeds.sum(axis=1), 3)
    np.testing.assert_array_equal(Draws.of(component, 3, 100, 7).weights, draws.weights)
    assert (Draws.of(component, 3, 100, 8).weights != draws.weights).any()
