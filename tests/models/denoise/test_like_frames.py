"""References and targets are means of frames of one setting and level alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tifffile

from simnfnd.evaluation.judging.recorded import open_input
from simnfnd.evaluation.real.groups import search
from simnfnd.models.adapting.stretches import read_clips
from simnfnd.models.denoise.temporal.likeness import LikeFrames
from simnfnd.models.recordings.device_settings import RecordedSettings
from simnfnd.models.recordings.inputs import NONE, Geometries
from tests.models.denoise.test_changing_recordings import HIGH, LOW, in_turns, static

COUNT = 7


def places_of(frames: np.ndarray, settings: list[RecordedSettings], *, in_time: bool) -> object:
    like_frames = LikeFrames(compares_levels=in_time)
    for frame, stated in zip(frames, settings, strict=True):
        like_frames.add(frame, stated)
    assert bool(like_frames.note("a")) == (len(like_frames.places) > 1)
    return like_frames.places


def test_frames_of_one_kind() -> None:
    """Levels count where one scene is shown in time; drifts and other scenes are no kinds."""
    frames = static(1, count=4)
    untold = [RecordedSettings()] * 4
    in_turn = frames * np.array([1, 0.6, 1, 0.6], np.float32)[:, None, None]
    drift = frames * np.array([1, 0.98, 0.96, 0.94], np.float32)[:, None, None]
    other = np.concatenate([frames[:2], static(2, count=2)])
    assert places_of(frames, untold, in_time=True) == [[0, 1, 2, 3]]
    assert places_of(frames, [LOW, HIGH] * 2, in_time=False) == [[0, 2], [1, 3]]
    assert places_of(in_turn, untold, in_time=True) == [[0, 2], [1, 3]]
    assert places_of(in_turn, untold, in_time=False) == [[0, 1, 2, 3]]
    assert places_of(drift, untold, in_time=True) == [[0, 1, 2, 3]]
    assert places_of(other, untold, in_time=True) == [[0, 1, 2, 3]]


@pytest.mark.parametrize("kind", ["levels", "channels"])
def test_evaluate_real_and_adapt_keep_kinds_apart(tmp_path: Path, kind: str) -> None:
    first = static(1, count=COUNT)
    second = static(1, count=2 * COUNT)[COUNT:] * np.float32(0.6 if kind == "levels" else 0.99)
    stack = np.rint(in_turns(first, second) * 255).astype(np.uint8)
    path = tmp_path / ("a.npy" if kind == "levels" else "a.tif")
    if kind == "levels":
        np.save(path, stack)
    else:
        both = stack.reshape(COUNT, 2, *stack.shape[1:])
        tifffile.imwrite(path, both, imagej=True, metadata={"axes": "TCYX"})

    (stretch,), _ = open_input(path)
    searched = search((0, stretch, None))
    numbers = [sorted(shot.number for shot in group.shots) for group in searched.groups]
    assert numbers == [list(range(first, 2 * COUNT, 2)) for first in (0, 1)]
    assert any("kinds" in note for note in searched.notes)

    read = read_clips([path], tmp_path / "out", Geometries(NONE))
    assert [len(clip.shots) for clip in read.clips] == [COUNT, COUNT]
    assert len(read.notes) == 1
