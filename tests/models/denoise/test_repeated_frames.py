"""Frames that a video holds several times, fans that change, and pixels around a fan."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from simnfnd import denoise
from simnfnd import open_recording as open_shown
from simnfnd.factory.common.array_types import Array, Float32s
from simnfnd.factory.dataset.fan_geometry import FanGeometry
from simnfnd.models.adapting.stretches import read_clips
from simnfnd.models.denoise.images import Denoising
from simnfnd.models.recordings import open_recording
from simnfnd.models.recordings.fan_tracking import FanTracker
from simnfnd.models.recordings.inputs import Geometries, find_items
from simnfnd.models.recordings.repeats import CopyFinder, RepeatFinder
from tests.models.recordings.fan_images import fan, preset
from tests.models.recordings.video_files import encode


@lru_cache(maxsize=1)
def _pings() -> list[Array]:
    sonar = preset("didson_hf", 160, 240)
    still, _ = fan(sonar, 0.3, False)
    speckles = [fan(sonar, 0.3, False, seed=number)[0] for number in range(12)]
    return [((still.astype(np.uint16) + speckle) // 2).astype(np.uint8) for speckle in speckles]


def pings(count: int) -> list[Array]:
    """One scene with a speckle of its own in each frame, in a fan."""
    return _pings()[:count]


def geometry_of(grey: Array) -> FanGeometry:
    actual = FanTracker().geometry(grey)
    assert actual is not None
    return actual


def half(grey: Float32s, geometry: object = None) -> Float32s:
    return grey / 2


@pytest.mark.parametrize(
    ("name", "codec", "stored", "options"),
    [
        ("a.avi", "ffv1", "gray", {}),
        ("a.mp4", "libx264", "yuv420p", {"crf": "23"}),
        ("a.avi", "mpeg4", "yuv420p", {"b": "4000000"}),
    ],
)
def test_copies_in_a_video_are_told_from_pings(
    tmp_path: Path, name: str, codec: str, stored: str, options: dict[str, str]
) -> None:
    repeated = [frame for frame in pings(6) for _ in range(3)]
    path = encode(tmp_path / name, repeated, codec=codec, stored=stored, options=options, rate=24)
    finder = RepeatFinder()
    with open_recording(path) as recording:
        actual = [finder.is_repeat(frame.samples.astype(np.float32) / 255) for frame in recording]
    expected = [number % 3 > 0 for number in range(18)]
    wrong = sum(a != b for a, b in zip(actual, expected, strict=True))
    assert wrong <= (0 if codec == "ffv1" else 2), "a rate control that settles costs a copy"
    assert not any(actual[::3]), "a new ping is never taken for a copy"


def test_a_recording_with_copies_is_denoised_as_at_its_own_rate() -> None:
    once = np.stack(pings(9))
    thrice = np.repeat(once, 3, axis=0)
    np.testing.assert_array_equal(denoise(thrice), np.repeat(denoise(once), 3, axis=0))


def test_copies_are_counted_apart() -> None:
    denoising = Denoising(half)
    frames = [frame for frame in pings(5) for _ in range(2)]
    shots = (denoising.shot(n, frame, lambda _: None, number=n) for n, frame in enumerate(frames))
    facts = [done.facts for done in denoising.sequence(shots)]
    assert [each.is_copy for each in facts] == [0, 1] * 5
    assert min(each.fused for each in facts) > 1


def test_what_runs_over_a_copy_stays(tmp_path: Path) -> None:
    """A clock beside the fan goes on while the ping stays."""
    frames = []
    for number in range(12):
        screen: Any = np.pad(pings(12)[number // 3], ((30, 4), (60, 60)))
        cv2.putText(screen, f"12:30:{number:02d}", (4, 20), 0, 0.5, (200,), 1, cv2.LINE_AA)
        frames.append(screen)
    geometry = geometry_of(frames[0])
    outside = geometry.maps(0, 0, *frames[0].shape)["sector"] <= 0
    results = denoise(np.stack(frames), geometry=geometry)
    for result, frame in zip(results, frames, strict=True):
        np.testing.assert_array_equal(result[outside], frame[outside])
        assert (result[~outside] != frame[~outside]).mean() > 0.5


def test_references_hold_no_copy(tmp_path: Path) -> None:
    finder = CopyFinder()
    frames = [frame.astype(np.float32) / 255 for frame in pings(4)]
    order = [0, 0, 1, 2, 1, 3, 3, 0]
    copies = [finder.is_copy(frames[number]) for number in order]
    assert copies == [False, True, False, False, True, False, True, True]


def test_adapt_learns_from_no_copy(tmp_path: Path) -> None:
    path = encode(tmp_path / "a.avi", [frame for frame in pings(8) for _ in range(2)])
    actual = read_clips([path], tmp_path / "out", Geometries("none"))
    assert [len(clip.shots) for clip in actual.clips] == [8]
    assert actual.copies == 8


# --- fans that change -----------------------------------------------------------------------------


def shrunk(frame: Array) -> Array:
    """The same fan at 70 % of its size on a page of the same size."""
    height, width = frame.shape
    small = cv2.resize(frame, None, fx=0.7, fy=0.7, interpolation=cv2.INTER_NEAREST)
    page = np.zeros_like(frame)
    left = (width - small.shape[1]) // 2
    page[height - small.shape[0] :, left : left + small.shape[1]] = small
    return page


def title(frame: Array) -> Array:
    page = np.zeros_like(frame)
    cv2.putText(page, "Dive 7", (10, 90), 0, 1.0, (230,), 2)
    return page


def test_the_fan_is_followed(tmp_path: Path) -> None:
    """A title, black frames, a small fan, then a large one, and dark frames in between."""
    frames = pings(12)
    small = [shrunk(frame) for frame in frames]
    black = np.zeros_like(frames[0])
    dark = [*small[:1], black, *small[1:3]]
    shown = [title(black)] * 3 + [black] * 2 + dark + frames[3:9] + [title(black)] + frames[9:]
    expected = [None] * 5 + ["small"] * 4 + ["large"] * 6 + [None] + ["large"] * 3
    path = encode(tmp_path / "a.avi", shown)
    fans = {"small": geometry_of(small[0]), "large": geometry_of(frames[3])}
    tracker = FanTracker()
    for number, (frame, name) in enumerate(zip(shown, expected, strict=True)):
        actual = tracker.geometry(frame)
        assert (actual is None) == (name is None), number
        if actual is not None and name is not None:
            assert actual.far_px == pytest.approx(fans[name].far_px, abs=2), number
    assert tracker.searched < 14, "most frames are not searched"
    with open_shown(path) as recording:
        for shot, name in zip(recording, expected, strict=True):
            assert (shot.geometry is None) == (name is None)
            if shot.geometry is not None and name is not None:
                assert shot.geometry.far_px == pytest.approx(fans[name].far_px, abs=2)


def test_the_fan_of_still_frames_is_one_object() -> None:
    tracker = FanTracker()
    actual = {id(tracker.geometry(frame)) for frame in pings(8)}
    assert len(actual) == 1
    assert tracker.searched == 1


def test_a_video_without_a_fan_is_not_searched_all_the_time() -> None:
    tracker = FanTracker()
    rng = np.random.default_rng(0)
    noise = rng.integers(0, 256, (60, 96, 96), dtype=np.uint8)
    assert all(tracker.geometry(frame) is None for frame in noise)
    assert tracker.searched <= 8


def test_a_folder_of_images_keeps_a_fan_each(tmp_path: Path) -> None:
    frames = pings(2)
    for number, frame in enumerate((shrunk(frames[0]), frames[1])):
        assert cv2.imwrite(str(tmp_path / f"{number}.png"), frame)
    geometries = Geometries("find")
    items = find_items([tmp_path], tmp_path / "out")
    small, large = (
        geometries.of(item, cv2.imread(str(item.source), cv2.IMREAD_UNCHANGED)) for item in items
    )
    assert small is not None
    assert large is not None
    assert large.far_px > 1.3 * small.far_px
