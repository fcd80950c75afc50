"""From the detectors' answers to figures of each class, with intervals that resample tracks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...factory.common.array_types import Array, Float64s
from ...factory.common.seeds import stream
from ..metrics.statistics import FigureEstimate
from .detector import Responses
from .targets import TargetClass, Track

CURVE_ALARMS = (0.1, 0.2, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0, 3.0, 5.0, 7.0, 10.0)
"""False alarms per frame at which the curve of detections is taken."""
CURVE_RATES = tuple(np.linspace(0, 1, 41))
"""False-positive rates at which the ROC curve is taken."""

_BLOCK_FRAMES = 7  # false alarms are resampled in blocks as long as a window of denoising
_LEAST_TRACKS = 3  # of a class, for an interval of its AUC
_INTERVAL = (0.025, 0.975)


class ClassFigures(NamedTuple):
    """The figures of a class of targets, or their means over classes.

    auc: of a matched filter; 1: it always tells a target from none, .5: it guesses.
    contrast: part of the recorded contrast that is retained.
    detection: part of the sightings found at one false alarm per frame.
    detection_gain: detection minus that in the recorded frames.
    """

    auc: FigureEstimate
    contrast: FigureEstimate
    detection: FigureEstimate
    detection_gain: FigureEstimate


@dataclass(frozen=True)
class MethodFigures:
    """Means over recordings, then over classes.

    by_class, overall: see `ClassFigures`.  false_alarms: per frame without targets, at the
    threshold that gives one per frame in the recorded frames.  curve: part of the targets found at
    `CURVE_ALARMS`.  roc: true-positive rate of the matched filter at `CURVE_RATES`.
    """

    by_class: tuple[ClassFigures, ...]
    overall: ClassFigures
    false_alarms: FigureEstimate
    curve: tuple[float, ...]
    roc: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class Answers:
    """What the detectors answer on one recording: denoised by one method, and as recorded."""

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
    shape = (len(ClassFigures._fields), len(classes), len(recordings), 1 + resamples)
    draws = np.full(shape, np.nan)
    auc, contrast, detection, detection_gain = draws  # Views, filled below.
    for recording, answers in enumerate(recordings):
        for number, target in enumerate(classes):
            tracks = _tracks_of(answers, target)
            if not tracks:
                continue
            rng = stream(seed, "tracks", recording, number)
            weights = _draw_weights(len(tracks), resamples, rng)
            detected_share = _detection(answers.denoised, tracks, weights)
            recorded_share = _detection(answers.recorded, tracks, weights)
            auc[number, recording] = _auc(answers.denoised, tracks, weights)
            contrast[number, recording] = _contrast(answers, tracks, weights)
            detection[number, recording] = detected_share
            detection_gain[number, recording] = detected_share - recorded_share
    return MethodFigures(
        by_class=tuple(_class_figures(draws[:, number]) for number in range(len(classes))),
        overall=ClassFigures(*map(_overall, draws)),
        false_alarms=_false_alarms(recordings, resamples, seed),
        curve=_detection_curve(recordings, classes),
        roc=_roc_curve(recordings, classes),
    )


def threshold_of(responses: Responses, alarms_per_frame: float) -> float:
    """The change at or above which the twin without targets gives this many alarms per frame.

    It is the height of the lowest of these alarms; 0 where there are fewer alarms than that.
    """
    count = round(alarms_per_frame * responses.frame_count)
    if count < 1:
        return float("inf")
    if count > len(responses.alarm_change):
        return 0.0
    return float(np.partition(responses.alarm_change, -count)[-count])


def _class_figures(class_draws: Float64s) -> ClassFigures:
    """Means over recordings.  class_draws: (figures, recordings, draws) of one class."""
    return ClassFigures(*(_estimate(_mean(figure_draws)) for figure_draws in class_draws))


def _overall(class_draws: Float64s) -> FigureEstimate:
    """Mean over recordings, then over classes.  class_draws: (classes, recordings, draws)."""
    class_means = [_mean(recording_draws) for recording_draws in class_draws]
    return _estimate(_mean(np.stack(class_means)))


def _tracks_of(answers: Answers, target: TargetClass) -> list[int]:
    """Numbers of the tracks of a class that have sightings."""
    sighted = set(answers.denoised.track.tolist())
    return [
        number
        for number, track in enumerate(answers.tracks)
        if track.target == target and number in sighted
    ]


def _draw_weights(count: int, resamples: int, rng: np.random.Generator) -> Float64s:
    """(1 + resamples, count): how often each of `count` tracks or blocks is drawn.

    The first row is the original sample: each once.  The other rows are bootstrap resamples.
    """
    resampled = rng.multinomial(count, np.full(count, 1 / count), size=resamples).astype(float)
    if count == 1:  # a single track or block does not show how much they differ
        resampled[:] = np.nan
    return np.vstack([np.ones(count), resampled])


def count_wins(present: Float64s, absent: Float64s) -> float:
    """Number of pairs in which `present` is greater, ties counted half."""
    ordered = np.sort(absent)
    below = np.searchsorted(ordered, present, "left")
    below_or_equal = np.searchsorted(ordered, present, "right")
    return float((below + below_or_equal).sum() / 2)


def _auc(responses: Responses, tracks: Sequence[int], weights: Float64s) -> Float64s:
    """AUC per draw: within-track and between-track AUC, mixed in the original sample's proportions.

    Pairs within a track are easier.  A track that is drawn twice is not compared with its copy,
    and the fixed proportions keep such draws from having more easy pairs.

    weights: (draws, tracks).  NaN in draws of a single track, and in all resamples of fewer
    tracks than `_LEAST_TRACKS`.
    """
    present = [responses.present[responses.track == track] for track in tracks]
    absent = [responses.absent[responses.track == track] for track in tracks]
    wins = np.array([[count_wins(target, twin) for twin in absent] for target in present])
    sightings = np.array([len(target) for target in present], float)
    pairs = np.outer(sightings, sightings)
    within = _auc_within_tracks(wins, pairs, weights)
    if len(tracks) < _LEAST_TRACKS:
        within[1:] = np.nan
    if len(tracks) == 1:
        return within
    between = _auc_between_tracks(wins, pairs, weights)
    within_share = np.trace(pairs) / pairs.sum()
    return np.asarray(within_share * within + (1 - within_share) * between)


def _auc_within_tracks(wins: Float64s, pairs: Float64s, weights: Float64s) -> Float64s:
    """AUC per draw over pairs of a target and the twin of the same track.

    wins, pairs: (tracks, tracks), target's track by twin's.  weights: (draws, tracks).
    """
    return np.asarray((weights @ np.diag(wins)) / (weights @ np.diag(pairs)))


def _auc_between_tracks(wins: Float64s, pairs: Float64s, weights: Float64s) -> Float64s:
    """AUC per draw over pairs of a target and the twin of another track.

    Arguments as of `_auc_within_tracks`.  NaN in draws of a single track.
    """
    other_wins = wins - np.diag(np.diag(wins))
    other_pairs = pairs - np.diag(np.diag(pairs))
    win_count = np.einsum("di,ij,dj->d", weights, other_wins, weights)
    pair_count = np.einsum("di,ij,dj->d", weights, other_pairs, weights)
    return np.asarray(win_count / np.where(pair_count == 0, np.nan, pair_count))


def _contrast(answers: Answers, tracks: Sequence[int], weights: Float64s) -> Float64s:
    """Retained part of the recorded contrast, per draw.  weights: (draws, tracks)."""
    retained = weights @ _track_contrasts(answers.denoised, tracks)
    recorded = weights @ _track_contrasts(answers.recorded, tracks)
    return np.asarray(retained / np.where(recorded == 0, np.nan, recorded))


def _track_contrasts(responses: Responses, tracks: Sequence[int]) -> Float64s:
    """(tracks,) what the targets add to the matched filter, summed over each track."""
    return _sums(responses, responses.present - responses.absent, tracks)


def _detection(responses: Responses, tracks: Sequence[int], weights: Float64s) -> Float64s:
    """Share of the sightings found at one false alarm per frame, per draw."""
    # A target has to exceed the lowest alarm: a method that erases everything changes nothing, has
    # a threshold of 0, and must not find a target in a change of 0.
    is_found = responses.change > threshold_of(responses, 1.0)
    sightings = _sums(responses, np.ones(len(is_found)), tracks)
    detections = _sums(responses, is_found, tracks)
    return np.asarray((weights @ detections) / (weights @ sightings))


def _sums(responses: Responses, values: Array, tracks: Sequence[int]) -> Float64s:
    """(tracks,) sum over the sightings of each track."""
    by_track = np.bincount(responses.track, weights=values, minlength=max(tracks) + 1)
    return np.asarray(by_track[list(tracks)], np.float64)


def _false_alarms(recordings: Sequence[Answers], resamples: int, seed: int) -> FigureEstimate:
    """False alarms per frame, with an interval that resamples blocks of frames."""
    draws = []
    for number, answers in enumerate(recordings):
        responses = answers.denoised
        # The threshold is itself an alarm of the recorded frames, and counts as one of them:
        # so the recorded frames have exactly one per frame.
        is_alarm = responses.alarm_change >= threshold_of(answers.recorded, 1.0)
        alarm_blocks = responses.alarm_frame[is_alarm] // _BLOCK_FRAMES
        block_count = math.ceil(responses.frame_count / _BLOCK_FRAMES)
        alarms = np.bincount(alarm_blocks, minlength=block_count).astype(float)
        frames = np.full(block_count, float(_BLOCK_FRAMES))
        frames[-1] = responses.frame_count - _BLOCK_FRAMES * (block_count - 1)
        weights = _draw_weights(block_count, resamples, stream(seed, "blocks", number))
        draws.append((weights @ alarms) / (weights @ frames))
    return _estimate(_mean(np.stack(draws)))


def _detection_curve(
    recordings: Sequence[Answers], classes: Sequence[TargetClass]
) -> tuple[float, ...]:
    """Part of the sightings found at `CURVE_ALARMS`: mean over classes and recordings."""
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
    """True-positive rate at `CURVE_RATES`: mean over classes and recordings."""
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
            rates[-1] = 1.0  # where everything is called a target
            curves.append(rates)
    return tuple(np.mean(curves, axis=0).tolist())


def _mean(draws: Float64s) -> Float64s:
    """(draws,) mean of (N, draws) over those of the N whose original sample has a value."""
    has_value = ~np.isnan(draws[:, 0])
    if not has_value.any():
        return np.full(draws.shape[1], np.nan)
    return np.asarray(draws[has_value].mean(axis=0))


def _estimate(draws: Float64s) -> FigureEstimate:
    """Estimate from `draws[0]`, the original sample; the interval comes from the resamples."""
    value = draws[0]
    resampled = draws[1:]
    finite = resampled[np.isfinite(resampled)]
    if np.isnan(value) or not len(finite):
        return FigureEstimate(float(value), np.nan, np.nan)
    low, high = np.quantile(finite, _INTERVAL)
    return FigureEstimate(float(value), float(low), float(high))
