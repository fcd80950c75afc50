"""Frames of recordings as training data: data.folder may be a recording, or hold some."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np

from simnfnd.evaluation.recorded import open_input
from simnfnd.factory.noise.registry import NoiseSettings
from simnfnd.models.data.images import OldDataSource, list_images, read_sample, smallest_side
from simnfnd.models.data.pairs import open_data
from tests.models.data.data_settings import composed
from tests.models.recordings.array_files import write_array
from tests.models.recordings.recording_files import pings
from tests.project_files import ROOT

LAMPREY = ROOT / "examples" / "didson" / "lamprey.avi"


def test_frames_stand_beside_pictures(tmp_path: Path) -> None:
    shutil.copy(LAMPREY, tmp_path / "dive.avi")
    cv2.imwrite(str(tmp_path / "one.png"), np.full((300, 500), 90, np.uint8))
    found = list_images(tmp_path)
    assert [sample.frame for sample in found] == [*(f"dive.avi#{n}" for n in range(8)), "one.png"]
    assert found[0].scene == "dive.avi"
    side, smallest = smallest_side(found)
    assert (side, smallest.frame) == (300, "one.png")
    frames = [read_sample(found[number])[0] for number in (7, 0, 8)]
    assert [frame.shape for frame in frames] == [(774, 400), (774, 400), (300, 500)]
    assert 0 <= frames[0].min() < frames[0].max() <= 1
    np.testing.assert_array_equal(frames[1], read_sample(list_images(LAMPREY)[0])[0])


def test_arrays_are_recordings_for_training_and_for_evaluate_real(tmp_path: Path) -> None:
    pictures = pings(9, 30, 40)
    path = write_array(tmp_path / "a.npz", pictures)
    found = list_images(path)
    assert [sample.frame for sample in found] == [f"a.npz#{n}" for n in range(9)]
    picture, _ = read_sample(found[5])
    np.testing.assert_allclose(picture, pictures[5] / 255, atol=1e-6)
    words = ("data=olddata", f"data.folder='{path}'", "data.patch=16")
    assert len(open_data(composed(*words)[0]).validation) > 0
    stretches, _ = open_input(str(path))
    assert [len(stretch.shots) for stretch in stretches] == [9]


def test_old_data_takes_frames() -> None:
    samples = list_images(LAMPREY)[:2]
    source = OldDataSource(samples, "polar", NoiseSettings(), weaker=0.0, seed=0)
    sample = source.sample(1, None)
    assert sample.clean is not None
    assert sample.noisy.shape == sample.clean.shape == (774, 400)
