"""What detectors find of targets in a sequence: contrast at known places, and changes in time.

The matched filter knows where a target is and measures how much of its contrast is left.  The
change detector does not: it subtracts the mean of frames distant in time, smooths, divides by the
usual change of each place, and takes peaks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.ndimage import maximum_filter

from ...factory.common.array_types import Bools, Float64s, Int64s
from ..metrics.measure import Grey
from .targets import Frames, Track, blurred, ellipse

_GAP_PX = 3.0
_RING_PX = 10.0
"""Inner and outer edge of the ring around a target, added to its semi-axes."""
_REACH_PX = 14  # margin around the longer semi-axis, of the crop that a target is measured in
_NEAR_FRAMES = 7  # frames this near in time are left out of the mean that is subtracted
_SMOOTH_PX = 2.0  # sigma of the blur of the change
_USUAL_PX = 8.0  # sigma of the blur of the usual change
_USUAL_FLOOR = 1 / 3  # least usual change, as a share of its median
_TINY = 1e-4
_PEAK_PX = 9  # side of the window in which a peak is the maximum
_MOTION_STD = 5.0  # a greater change in the recording itself is real motion
_MOTION_PX = 31  # side of the neighbourhood of real motion
_FOUND_PX = 4  # a change this near a target, along rows and columns, counts as its detection


@dataclass(frozen=True, eq=False)
class Responses:
    """What the detectors answer on a sequence with targets and on its twin without.

    track: (S,) number of the track of each sighting.
    present, absent: (S,) matched filter at the target, and at the same place in the twin.
    change: (S,) greatest change around a target, in standard deviations of the usual change.
    alarm_frame, alarm_change: (A,) frame and height (> 0) of each peak in the twin; real motion is
    excluded.
    frame_count: frames of the twin.
    """

    track: Int64s
    present: Float64s
    absent: Float64s
    change: Float64s
    alarm_frame: Int64s
    alarm_change: Float64s
    frame_count: int


def responses_of(
    with_targets: Frames,
    without: Frames,
    tracks: Sequence[Track],
    insonified: Bools,
    motion: Bools,
    judged: range,
) -> Responses:
    """The answers on a denoised sequence and its denoised twin, (N, H, W) each.

    insonified: (H, W) bool.  motion: (N, H, W) as `real_motion` finds it in the recorded twin.
    judged: numbers of the frames whose sightings count.
    """
    twin_change = changes(without, insonified)
    usual = usual_change(twin_change, insonified)
    alarm_frame, alarm_change = _alarms(twin_change / usual, insonified, motion)
    change = changes(with_targets, insonified) / usual
    track_numbers: list[int] = []
    present: list[float] = []
    absent: list[float] = []
    target_changes: list[float] = []
    for track_number, track in enumerate(tracks):
        for frame_number, y, x in track.sightings:
            if frame_number not in judged:
                continue
            track_numbers.append(track_number)
            present.append(matched_filter(with_targets[frame_number], track, y, x))
            absent.append(matched_filter(without[frame_number], track, y, x))
            target_changes.append(_greatest_change(change[frame_number], y, x))
    return Responses(
        track=np.array(track_numbers, np.int64),
        present=np.array(present),
        absent=np.array(absent),
        change=np.array(target_changes),
        alarm_frame=alarm_frame,
        alarm_change=alarm_change,
        frame_count=len(without),
    )


def matched_filter(image: Grey, track: Track, y: float, x: float) -> float:
    """Mean inside a target minus the mean of the ring around it."""
    along, across = track.target.semi_axes_px
    reach = int(np.ceil(max(along, across))) + _REACH_PX
    top = max(0, int(y) - reach)
    left = max(0, int(x) - reach)
    crop = image[top : top + 2 * reach + 1, left : left + 2 * reach + 1]
    inside, gap, outer = (
        ellipse(crop.shape, y - top, x - left, track.angle_rad, (along + margin, across + margin))
        for margin in (0.0, _GAP_PX, _RING_PX)
    )
    ring = (outer > 0.5) & (gap < 0.1)
    return float((crop * inside).sum() / inside.sum() - crop[ring].mean())


def changes(frames: Frames, insonified: Bools) -> Frames:
    """(N, H, W): each frame minus the mean of the frames distant in time, smoothed."""
    count = len(frames)
    total = frames.sum(axis=0, dtype=np.float64)
    result = np.empty(frames.shape, np.float32)
    for number, frame in enumerate(frames):
        near = frames[max(0, number - _NEAR_FRAMES) : number + _NEAR_FRAMES + 1]
        distant = (total - near.sum(axis=0, dtype=np.float64)) / (count - len(near))
        result[number] = blurred(frame - distant, _SMOOTH_PX) * insonified
    return result


def usual_change(change: Frames, insonified: Bools) -> Grey:
    """(H, W): robust standard deviation of the change in time, smoothed, with a floor."""
    # 1.4826: standard deviation of a normal distribution by its median absolute value.
    deviation = np.float32(1.4826) * np.median(np.abs(change), axis=0)
    usual = np.sqrt(blurred(deviation**2, _USUAL_PX))
    floor = np.median(usual[insonified]) * _USUAL_FLOOR
    return np.asarray(np.maximum(usual, floor) + _TINY, np.float32)


def real_motion(recorded: Frames, insonified: Bools) -> Bools:
    """(N, H, W) bool: neighbourhoods of everything that moves in the recording itself."""
    change = changes(recorded, insonified)
    usual = usual_change(change, insonified)
    neighbourhood = np.ones((_MOTION_PX, _MOTION_PX), np.uint8)
    moving = (np.abs(change) > _MOTION_STD * usual).astype(np.uint8)
    return np.stack([cv2.dilate(frame, neighbourhood) > 0 for frame in moving])


def _greatest_change(change: Grey, y: float, x: float) -> float:
    """Greatest change of a frame around a target."""
    top = max(0, int(y) - _FOUND_PX)
    left = max(0, int(x) - _FOUND_PX)
    around = change[top : int(y) + _FOUND_PX + 1, left : int(x) + _FOUND_PX + 1]
    return float(around.max())


def _alarms(change: Frames, insonified: Bools, motion: Bools) -> tuple[Int64s, Float64s]:
    """Frame and height of every peak of the change that is not real motion."""
    numbers: list[Int64s] = []
    heights: list[Float64s] = []
    for number, frame in enumerate(change):
        is_peak = (maximum_filter(frame, _PEAK_PX) == frame) & (frame > 0)
        frame_heights = frame[is_peak & insonified & ~motion[number]].astype(np.float64)
        numbers.append(np.full(len(frame_heights), number, np.int64))
        heights.append(frame_heights)
    return np.concatenate(numbers), np.concatenate(heights)
