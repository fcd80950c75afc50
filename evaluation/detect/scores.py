"""From the answers of detectors to figures of each class, with intervals that draw tracks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ...factory.seeds import stream
from .detector import Responses
from .targets import TargetClass, Track

Values = npt.NDArray[np.float64]

CURVE_ALARMS = (0.1, 0.2, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0, 3.0, 5.0, 7.0, 10.0)
"""False alarms per frame at which the curve of detections is taken."""
CURVE_RATES = tuple(np.linspace(0, 1, 41))
"""False-positive rates at which the ROC curve is taken."""

_BLOCK_FRAMES = 7  # frames of a block that is drawn for false alarms: a window of denoising
_LEAST_TRACKS = 3  # of a class, for an interval of its AUC
_INTERVAL = (0.025, 0.975)


class Estimate(NamedTuple):
    """A figure with its 95 % bootstrap interval; NaN where there is nothing to measure."""

    value: float
    low: float
    high: float


class ClassFigures(NamedTuple):
    """auc: 1: a matched filter always tells target from none, .5: never.

    contrast: part of the recorded contrast that is retained.  detection: part of the targets found
    at one false alarm per frame.  detection_gain: how much more that is than in recorded frames.
    """

    auc: Estimate
    contrast: Estimate
    detection: Estimate
    detection_gain: Estimate


@dataclass(frozen=True)
class MethodFigures:
    """Means over recordings, then over classes.

    by_class, overall: see `ClassFigures`.  false_alarms: per frame without targets, at the
    threshold that gives one per frame in the recorded frames.  curve: part of the targets found at
    `CURVE_ALARMS`.  roc: true-positive rate of the matched filter at `CURVE_RATES`.
    """

    by_class: tuple[ClassFigures, ...]
    overall: ClassFigures
    false_alarms: Estimate
    curve: tuple[float, ...]
    roc: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class Answers:
    """Of one method on one recording, beside those on the recorded frames."""

    tracks: Sequence[Track]
    denoised: Responses
    recorded: Responses


def figures_of(
    recordings: Sequence[Answers],
    classes: Sequence[TargetClass],
    *,
    resamples: int,
    seed: int,
) -> MethodFigures:
    """The figures of a method.  Methods on the same recordings get the same draws of tracks."""
    shape = (len(ClassFigures._fields), len(classes), len(recordings), resamples + 1)
    auc, contrast, detection, gain = draws = np.full(shape, np.nan)
    for recording, answers in enumerate(recordings):
        for number, target in enumerate(classes):
            tracks = _tracks_of(answers, target)
            if not len(tracks):
                continue
            weights = _draws(len(tracks), resamples, stream(seed, "tracks", recording, number))
            auc[number, recording] = _auc(answers.denoised, tracks, weights)
            contrast[number, recording] = _contrast(answers, tracks, weights)
            detection[number, recording] = _detection(answers.denoised, tracks, weights)
            before = _detection(answers.recorded, tracks, weights)
            gain[number, recording] = detection[number, recording] - before
    by_class = tuple(
        ClassFigures(*(_estimate(_mean(figure[number])) for figure in draws))
        for number in range(len(classes))
    )
    overall = ClassFigures(
        *(_estimate(_mean(np.stack([_mean(values) for values in figure]))) for figure in draws)
    )
    return MethodFigures(
        by_class,
        overall,
        _false_alarms(recordings, resamples, seed),
        _detection_curve(recordings, classes),
        _roc_curve(recordings, classes),
    )


def threshold_of(responses: Responses, alarms_per_frame: float) -> float:
    """The change above which the twin without targets gives so many alarms per frame."""
    count = round(alarms_per_frame * responses.frame_count)
    if count < 1 or count > len(responses.alarm_change):
        return 0.0 if count > 0 else float("inf")
    return float(np.partition(responses.alarm_change, -count)[-count])


def auc_of(present: Values, absent: Values) -> float:
    """Area under the ROC curve: how often a value of the first exceeds one of the second."""
    return float(_wins(present, absent) / (len(present) * len(absent)))


def _tracks_of(answers: Answers, target: TargetClass) -> list[int]:
    """Numbers of the tracks of a class that have sightings."""
    sighted = set(answers.denoised.track.tolist())
    return [n for n, track in enumerate(answers.tracks) if track.target == target and n in sighted]


def _draws(count: int, resamples: int, rng: np.random.Generator) -> Values:
    """(1 + resamples, count): how often each track is drawn; in the first row once each."""
    drawn = rng.multinomial(count, np.full(count, 1 / count), size=resamples).astype(float)
    if count == 1:  # nothing is known of how tracks differ
        drawn[:] = np.nan
    return np.vstack([np.ones(count), drawn])


def _wins(present: Values, absent: Values) -> float:
    """Pairs in which the first is greater, ties counted half."""
    ordered = np.sort(absent)
    below = np.searchsorted(ordered, present, "left")
    upto = np.searchsorted(ordered, present, "right")
    return float((below + upto).sum() / 2)


def _auc(responses: Responses, tracks: Sequence[int], weights: Values) -> Values:
    """Of each draw.

    Pairs within a track, which are easier, keep their share in every draw: a track that is drawn
    twice is not compared with its copy.  NaN where one track alone is drawn, and in all draws of
    fewer tracks than `_LEAST_TRACKS`.
    """
    present = [responses.present[responses.track == track] for track in tracks]
    absent = [responses.absent[responses.track == track] for track in tracks]
    wins = np.array([[_wins(own, background) for background in absent] for own in present])
    sightings = np.array([len(own) for own in present], float)
    pairs = np.outer(sightings, sightings)
    within = (weights @ np.diag(wins)) / (weights @ np.diag(pairs))
    if len(tracks) < _LEAST_TRACKS:
        within[1:] = np.nan
    if len(tracks) == 1:
        return np.asarray(within)
    share_within = np.trace(pairs) / pairs.sum()
    between_wins = wins - np.diag(np.diag(wins))
    between_pairs = pairs - np.diag(np.diag(pairs))
    won = np.einsum("di,ij,dj->d", weights, between_wins, weights)
    compared = np.einsum("di,ij,dj->d", weights, between_pairs, weights)
    between = won / np.where(compared == 0, np.nan, compared)
    return np.asarray(share_within * within + (1 - share_within) * between)


def _contrast(answers: Answers, tracks: Sequence[int], weights: Values) -> Values:
    """Of each draw."""
    sums = []
    for responses in (answers.denoised, answers.recorded):
        gain = responses.present - responses.absent
        sums.append(_sums(responses, gain, tracks))
    retained, recorded = (weights @ total for total in sums)
    return np.asarray(retained / np.where(recorded == 0, np.nan, recorded))


def _detection(responses: Responses, tracks: Sequence[int], weights: Values) -> Values:
    """Of each draw: the share of its sightings found at one false alarm per frame."""
    is_found = responses.change > threshold_of(responses, 1.0)
    sightings = _sums(responses, np.ones(len(is_found)), tracks)
    return np.asarray((weights @ _sums(responses, is_found, tracks)) / (weights @ sightings))


def _sums(responses: Responses, values: npt.NDArray[np.generic], tracks: Sequence[int]) -> Values:
    """(tracks,) sum over the sightings of each track."""
    whole = np.bincount(responses.track, weights=values, minlength=max(tracks) + 1)
    return np.asarray(whole[list(tracks)], np.float64)


def _false_alarms(recordings: Sequence[Answers], resamples: int, seed: int) -> Estimate:
    """Per frame, with an interval that draws blocks of frames."""
    draws = []
    for number, answers in enumerate(recordings):
        threshold = threshold_of(answers.recorded, 1.0)
        responses = answers.denoised
        is_alarm = responses.alarm_change >= threshold
        blocks = responses.alarm_frame[is_alarm] // _BLOCK_FRAMES
        count = -(-responses.frame_count // _BLOCK_FRAMES)
        alarms = np.bincount(blocks, minlength=count).astype(float)
        frames = np.full(count, float(_BLOCK_FRAMES))
        frames[-1] = responses.frame_count - _BLOCK_FRAMES * (count - 1)
        weights = _draws(count, resamples, stream(seed, "blocks", number))
        draws.append((weights @ alarms) / (weights @ frames))
    return _estimate(_mean(np.stack(draws)))


def _detection_curve(
    recordings: Sequence[Answers], classes: Sequence[TargetClass]
) -> tuple[float, ...]:
    rates = []
    for answers in recordings:
        thresholds = [threshold_of(answers.denoised, alarms) for alarms in CURVE_ALARMS]
        for target in classes:
            of_class = np.isin(answers.denoised.track, _tracks_of(answers, target))
            change = answers.denoised.change[of_class]
            if len(change):
                rates.append([(change > threshold).mean() for threshold in thresholds])
    return tuple(np.mean(rates, axis=0).tolist())


def _roc_curve(recordings: Sequence[Answers], classes: Sequence[TargetClass]) -> tuple[float, ...]:
    curves = []
    for answers in recordings:
        for target in classes:
            of_class = np.isin(answers.denoised.track, _tracks_of(answers, target))
            if not of_class.any():
                continue
            absent = np.sort(answers.denoised.absent[of_class])
            thresholds = np.quantile(absent, 1 - np.array(CURVE_RATES))
            present = answers.denoised.present[of_class]
            rates = (present[None] > thresholds[:, None]).mean(axis=1)
            rates[-1] = 1.0
            curves.append(rates)
    return tuple(np.mean(curves, axis=0).tolist())


def _mean(draws: Values) -> Values:
    """Over the first axis, without rows that have no value and no draw."""
    known = ~np.isnan(draws[:, 0])
    if not known.any():
        return np.full(draws.shape[1], np.nan)
    return np.asarray(draws[known].mean(axis=0))


def _estimate(draws: Values) -> Estimate:
    """Of the first draw, which is no draw, and the others."""
    value = draws[0]
    resampled = draws[1:]
    known = resampled[np.isfinite(resampled)]
    if np.isnan(value) or not len(known):
        return Estimate(float(value), np.nan, np.nan)
    low, high = np.quantile(known, _INTERVAL)
    return Estimate(float(value), float(low), float(high))
