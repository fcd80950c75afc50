"""What a detector sees of targets in a sequence: contrast at known places, and changes in time.

The matched filter knows where a target is and answers how much information is left.  The change
detector does not: it subtracts the mean of frames far away in time, smooths, divides by the usual
change of each place, and takes peaks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt
from scipy.ndimage import maximum_filter

from ..metrics.fidelity import Mask
from ..metrics.measure import Grey
from .targets import Frames, Track, blurred, ellipse

Values = npt.NDArray[np.float64]

_GAP_PX = 3.0
_RING_PX = 10.0
"""Inner and outer edge of the ring around a target, added to its semi-axes."""
_REACH_PX = 14  # beyond the longer semi-axis, of the crop that a target is measured in
_NEAR = 7  # frames nearer in time have no part in the mean that is subtracted
_SMOOTH_PX = 2.0
_USUAL_PX = 8.0  # sigma of the blur of the usual change
_LEAST_USUAL = 1 / 3  # of the median of the usual change
_TINY = 1e-4
_PEAK_PX = 9  # side of the window that a peak leads
_MOTION_STD = 5.0  # a greater change in the recording itself is real motion
_MOTION_PX = 31  # side of the neighbourhood of real motion
_FOUND_PX = 4  # a peak so near a target, along rows and columns, is its detection


@dataclass(frozen=True, eq=False)
class Responses:
    """What the detectors answer on a sequence with targets and on its twin without.

    track: (S,) number of the track of each sighting.
    present, absent: (S,) matched filter with the target, and without its contrast.
    change: (S,) greatest change around a target, in its usual standard deviations.
    alarm_frame, alarm_change: (A,) frame and height of the peaks in the twin, real motion excluded.
    frame_count: frames of the twin.
    """

    track: npt.NDArray[np.int64]
    present: Values
    absent: Values
    change: Values
    alarm_frame: npt.NDArray[np.int64]
    alarm_change: Values
    frame_count: int


def responses_of(
    with_targets: Frames,
    without: Frames,
    tracks: Sequence[Track],
    insonified: Mask,
    motion: Mask,
    judged: range,
) -> Responses:
    """The answers on a denoised sequence and its denoised twin, (N, H, W) each.

    motion: (N, H, W) as `real_motion` finds it in the recorded twin.  judged: numbers of the
    frames whose sightings count.
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
        for number, y, x in track.sightings:
            if number not in judged:
                continue
            track_numbers.append(track_number)
            present.append(matched_filter(with_targets[number], track, y, x))
            absent.append(matched_filter(without[number], track, y, x))
            top = max(0, int(y) - _FOUND_PX)
            left = max(0, int(x) - _FOUND_PX)
            around = change[number, top : int(y) + _FOUND_PX + 1, left : int(x) + _FOUND_PX + 1]
            target_changes.append(float(around.max()))
    return Responses(
        np.array(track_numbers, np.int64),
        np.array(present),
        np.array(absent),
        np.array(target_changes),
        alarm_frame,
        alarm_change,
        len(without),
    )


def matched_filter(image: Grey, track: Track, y: float, x: float) -> float:
    """Mean inside a target minus the mean of the ring around it."""
    along, across = track.target.semi_axes_px
    reach = int(np.ceil(max(along, across))) + _REACH_PX
    top = max(0, int(y) - reach)
    left = max(0, int(x) - reach)
    crop = image[top : top + 2 * reach + 1, left : left + 2 * reach + 1]
    inside, gap, outer = (
        ellipse(crop.shape, y - top, x - left, track.angle_rad, (along + more, across + more))
        for more in (0.0, _GAP_PX, _RING_PX)
    )
    ring = (outer > 0.5) & (gap < 0.1)
    return float((crop * inside).sum() / inside.sum() - crop[ring].mean())


def changes(frames: Frames, insonified: Mask) -> Frames:
    """(N, H, W): each frame minus the mean of the frames far from it in time, smoothed."""
    count = len(frames)
    total = frames.sum(axis=0, dtype=np.float64)
    result = np.empty(frames.shape, np.float32)
    for number, frame in enumerate(frames):
        near = frames[max(0, number - _NEAR) : number + _NEAR + 1]
        distant = (total - near.sum(axis=0, dtype=np.float64)) / (count - len(near))
        result[number] = blurred(frame - distant, _SMOOTH_PX) * insonified
    return result


def usual_change(change: Frames, insonified: Mask) -> Grey:
    """(H, W): robust standard deviation of the change in time, smoothed, with a floor."""
    deviation = np.float32(1.4826) * np.median(np.abs(change), axis=0)
    usual = np.sqrt(blurred(deviation**2, _USUAL_PX))
    floor = np.median(usual[insonified]) * _LEAST_USUAL
    return np.asarray(np.maximum(usual, floor) + _TINY, np.float32)


def real_motion(recorded: Frames, insonified: Mask) -> Mask:
    """(N, H, W) bool: neighbourhoods of what really moves in a recording."""
    change = changes(recorded, insonified)
    usual = usual_change(change, insonified)
    neighbourhood = np.ones((_MOTION_PX, _MOTION_PX), np.uint8)
    moving = (np.abs(change) > _MOTION_STD * usual).astype(np.uint8)
    return np.stack([cv2.dilate(frame, neighbourhood) > 0 for frame in moving])


def _alarms(change: Frames, insonified: Mask, motion: Mask) -> tuple[npt.NDArray[np.int64], Values]:
    """Frame and height of every peak of the change that is not real motion."""
    numbers: list[npt.NDArray[np.int64]] = []
    heights: list[Values] = []
    for number, frame in enumerate(change):
        is_peak = (maximum_filter(frame, _PEAK_PX) == frame) & insonified & ~motion[number]
        height = frame[is_peak & (frame > 0)].astype(np.float64)
        numbers.append(np.full(len(height), number, np.int64))
        heights.append(height)
    return np.concatenate(numbers), np.concatenate(heights)
