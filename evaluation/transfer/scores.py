"""How well detections match real boxes: average precision, recall at a false-alarm rate, intervals.

Average precision is pycocotools'.  The bootstrap draws groups of images, because images of one
group show nearly the same scene; it counts pycocotools' own matches anew for each draw.
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ...factory.common.array_types import Bools, Float32s, Float64s, Int64s
from ...factory.common.seeds import stream
from ...models.detection.boxes import Boxes, intersection_over_union, share_inside
from ...models.detection.detector import Detections
from ..metrics.statistics import FigureEstimate
from .coco import RealImage

IOU_STRICT = 0.5
IOU_LOOSE = 0.3
_IGNORED_IOU = 0.3
_IGNORED_SHARE = 0.5
"""Detections that overlap a box of an ignored class by more do not count."""
_MOST_DETECTIONS = 100
_FEWEST_SAMPLES = 20
"""Finite samples of a bootstrap from which an interval is drawn; with fewer there is none."""
_RECALLS = np.linspace(0, 1, 101)
CURVE_ALARMS = tuple(float(value) for value in np.geomspace(0.05, 10, 41))
"""False alarms per image at which the curve of recall is sampled."""


class Figures(NamedTuple):
    """The figures of one class or of all objects.

    recall: at one false alarm per image, with an overlap of IOU_STRICT.
    object_count: number of true objects.
    """

    ap50: FigureEstimate
    ap30: FigureEstimate
    recall: FigureEstimate
    object_count: int


@dataclass(frozen=True, eq=False)
class Matches:
    """Detections of a set of images against truth, at one least overlap.

    image: (N,) number of each detection's image.  score, is_hit: (N,).
    object_counts: (I,) true objects in each image.
    """

    image: Int64s
    score: Float64s
    is_hit: Bools
    object_counts: Int64s


def countable(detections: Detections, ignored: Boxes) -> Detections:
    """The detections that count: not those on a box of an ignored class."""
    if not len(ignored) or not len(detections.boxes):
        return detections
    is_on = (intersection_over_union(detections.boxes, ignored) >= _IGNORED_IOU) | (
        share_inside(detections.boxes, ignored) > _IGNORED_SHARE
    )
    counts = ~is_on.any(axis=1)
    return Detections(
        detections.boxes[counts], detections.scores[counts], detections.labels[counts]
    )


def match(
    images: Sequence[RealImage], detections: Sequence[Detections], label: int | None, iou: float
) -> tuple[Matches, float]:
    """Pycocotools' matches and its average precision at one overlap.

    label: the class that is judged; None: all objects as one class.
    detections: for each image those that count.
    """
    evaluation = _evaluate(images, detections, label, iou)
    count = len(images)
    numbers: list[Int64s] = []
    scores: list[Float64s] = []
    hits: list[Bools] = []
    objects = np.zeros(count, np.int64)
    for entry in evaluation.evalImgs:
        if entry is None:
            continue
        number = entry["image_id"]
        objects[number] = np.count_nonzero(np.asarray(entry["gtIgnore"]) == 0)
        counts = np.asarray(entry["dtIgnore"][0]) == 0
        scores.append(np.array(entry["dtScores"], np.float64)[counts])
        hits.append(np.asarray(entry["dtMatches"][0])[counts] > 0)
        numbers.append(np.full(np.count_nonzero(counts), number, np.int64))
    matches = Matches(
        np.concatenate(numbers) if numbers else np.zeros(0, np.int64),
        np.concatenate(scores) if scores else np.zeros(0),
        np.concatenate(hits) if hits else np.zeros(0, bool),
        objects,
    )
    precision = evaluation.eval["precision"]
    present = precision[precision > -1]
    return matches, float(present.mean()) if present.size else float("nan")


def _evaluate(
    images: Sequence[RealImage], detections: Sequence[Detections], label: int | None, iou: float
) -> Any:
    """A COCOeval that has matched and accumulated; image ids are positions."""
    from pycocotools.coco import COCO
    from pycocotools.cocoeval import COCOeval

    truths: list[dict[str, Any]] = []
    results: list[dict[str, Any]] = []
    for number, (real, own_detections) in enumerate(zip(images, detections, strict=True)):
        labelled = real.labelled
        of_class = slice(None) if label is None else labelled.labels == label
        for box in labelled.boxes[of_class]:
            truths.append({"id": len(truths) + 1, **_entry(number, box), "iscrowd": 0})
        in_class = slice(None) if label is None else real.crowd_labels == label
        for box in real.crowds[in_class]:
            truths.append({"id": len(truths) + 1, **_entry(number, box), "iscrowd": 1})
        is_wanted = slice(None) if label is None else own_detections.labels == label
        for box, score in zip(
            own_detections.boxes[is_wanted], own_detections.scores[is_wanted], strict=True
        ):
            entry = _entry(number, box)
            results.append({"id": len(results) + 1, **entry, "score": float(score)})
    listed = [{"id": number} for number in range(len(images))]
    categories = [{"id": 1, "name": "object"}]
    # pycocotools prints what it does.
    with contextlib.redirect_stdout(io.StringIO()):
        truth = _index(COCO(), listed, categories, truths)
        result = _index(COCO(), listed, categories, results)
        evaluation = COCOeval(truth, result, "bbox")
        evaluation.params.iouThrs = np.array([iou])
        evaluation.params.maxDets = [_MOST_DETECTIONS]
        evaluation.params.areaRng = [[0, 1e10]]
        evaluation.params.areaRngLbl = ["all"]
        evaluation.evaluate()
        evaluation.accumulate()
    return evaluation


def _index(coco: Any, images: Any, categories: Any, annotations: Any) -> Any:
    coco.dataset = {"images": images, "categories": categories, "annotations": annotations}
    coco.createIndex()
    return coco


def _entry(number: int, box: Float32s) -> dict[str, Any]:
    left, top, right, bottom = map(float, box)
    width = right - left
    height = bottom - top
    bbox = [left, top, width, height]
    return {"image_id": number, "category_id": 1, "bbox": bbox, "area": width * height}


def average_precision(matches: Matches, weights: Int64s | None = None) -> float:
    """Average precision as pycocotools defines it, at 101 recalls; NaN without objects.

    weights: (I,) how often each image counts; None: once.
    """
    order = np.argsort(-matches.score, kind="mergesort")
    counts = _counts(matches, weights)
    object_count = float((counts * matches.object_counts).sum())
    if not object_count:
        return float("nan")
    weight = counts[matches.image[order]]
    is_hit = matches.is_hit[order]
    hits = np.cumsum(weight * is_hit)
    alarms = np.cumsum(weight * ~is_hit)
    recall = hits / object_count
    precision = hits / np.maximum(hits + alarms, np.spacing(1))
    precision = np.maximum.accumulate(precision[::-1])[::-1]
    if not len(precision):
        return 0.0
    places = np.searchsorted(recall, _RECALLS, side="left")
    is_reached = places < len(precision)
    at_recalls = precision[np.minimum(places, len(precision) - 1)]
    return float(np.where(is_reached, at_recalls, 0).mean())


def recall_at(
    matches: Matches,
    alarms_per_image: Sequence[float],
    weights: Int64s | None = None,
) -> list[float]:
    """The part of the objects that is found with this many false alarms per image, or fewer."""
    counts = _counts(matches, weights)
    object_count = float((counts * matches.object_counts).sum())
    if not object_count:
        return [float("nan")] * len(alarms_per_image)
    order = np.argsort(-matches.score, kind="mergesort")
    weight = counts[matches.image[order]]
    is_hit = matches.is_hit[order]
    hits = np.concatenate([[0], np.cumsum(weight * is_hit)])
    alarms = np.concatenate([[0], np.cumsum(weight * ~is_hit)])
    limits = np.array(alarms_per_image) * counts.sum()
    places = np.searchsorted(alarms, limits + 1e-9, side="right") - 1
    return [float(value) for value in hits[places] / object_count]


def _counts(matches: Matches, weights: Int64s | None) -> Int64s:
    return np.ones(len(matches.object_counts), np.int64) if weights is None else weights


def threshold_at(matches: Matches, alarms_per_image: float) -> float:
    """The least score at which there are no more false alarms per image than that."""
    alarms = np.sort(matches.score[~matches.is_hit])[::-1]
    allowed = int(alarms_per_image * len(matches.object_counts))
    return float(alarms[allowed]) if allowed < len(alarms) else 0.0


def group_draws(groups: Sequence[str], draws: int, seed: int) -> Int64s:
    """(draws, images): how often each image counts when whole groups are drawn with replacement."""
    names, group_of = np.unique(np.array(groups), return_inverse=True)
    rng = stream(seed, "transfer", "bootstrap")
    picked = rng.integers(len(names), size=(draws, len(names)))
    counts = np.stack([np.bincount(row, minlength=len(names)) for row in picked])
    return np.asarray(counts[:, group_of], np.int64)


def figures_of(
    images: Sequence[RealImage],
    detections: Sequence[Detections],
    label: int | None,
    draws: Int64s,
) -> tuple[Figures, Matches]:
    """All figures of one class, or of all objects, and the matches at IOU_STRICT."""
    strict, ap50 = match(images, detections, label, IOU_STRICT)
    loose, ap30 = match(images, detections, label, IOU_LOOSE)
    (recall,) = recall_at(strict, [1.0])
    samples_50 = [average_precision(strict, weights) for weights in draws]
    samples_30 = [average_precision(loose, weights) for weights in draws]
    samples_recall = [recall_at(strict, [1.0], weights)[0] for weights in draws]
    figures = Figures(
        _estimate(ap50, samples_50),
        _estimate(ap30, samples_30),
        _estimate(recall, samples_recall),
        int(strict.object_counts.sum()),
    )
    return figures, strict


def difference(first: Matches, second: Matches, draws: Int64s) -> FigureEstimate:
    """AP50 of the first minus that of the second, paired over draws of groups."""
    samples = [
        average_precision(first, weights) - average_precision(second, weights) for weights in draws
    ]
    return _estimate(average_precision(first) - average_precision(second), samples)


def _estimate(value: float, samples: Sequence[float]) -> FigureEstimate:
    """The value with its 95 % interval by samples of a bootstrap; NaN limits if they are few."""
    finite = np.array(samples)[np.isfinite(samples)]
    if finite.size < _FEWEST_SAMPLES:
        return FigureEstimate(value, float("nan"), float("nan"))
    low, high = np.quantile(finite, [0.025, 0.975])
    return FigureEstimate(value, float(low), float(high))
