"""Recordings of a dataset, denoised in time, read like those of sonars, and played."""

from __future__ import annotations

from pathlib import Path

import cv2
import h5py
import numpy as np
import pytest

from simnfnd.evaluation.judging.recorded import open_input
from simnfnd.factory.common.errors import FactoryError
from simnfnd.models.denoise import shards
from simnfnd.models.denoise.options import main
from simnfnd.models.pretrained.learned_files import LearnedFile, known_as
from simnfnd.models.recordings import is_recording, open_recording
from tests.models.denoise.untrained import untrained_sonarnet
from tests.recorded_dataset import FRAMES, SCENES, recorded_pair, write_recordings


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    """In three shards, so that each recording lies in two."""
    return write_recordings(tmp_path / "dataset", shard_size=6)


@pytest.fixture
def weights(tmp_path: Path) -> Path:
    return untrained_sonarnet(tmp_path)


def denoised(source: Path, out: Path, weights: Path, *words: str) -> dict[str, bytes]:
    """`scene/frame` -> bytes of its denoised image."""
    assert main([str(source), "--out", str(out), "--weights", str(weights), *words]) == 0
    return images_below(out)


def images_below(out: Path) -> dict[str, bytes]:
    contents = {}
    for path in sorted(out.rglob("*.h5")):
        with h5py.File(path) as file:
            for row, image in zip(file["meta"][()], file["denoised"][()], strict=True):
                contents[f"{row['scene'].decode()}/{row['frame'].decode()}"] = image.tobytes()
    return contents


def test_a_recording_is_denoised_in_time_across_its_shards(
    dataset: Path, tmp_path: Path, weights: Path
) -> None:
    whole = write_recordings(tmp_path / "whole")
    expected = denoised(whole, tmp_path / "expected", weights)
    assert len(expected) == len(SCENES) * FRAMES
    assert denoised(dataset, tmp_path / "out", weights) == expected
    alone = denoised(dataset, tmp_path / "alone", weights, "--frames", "1")
    assert not [name for name in expected if alone[name] == expected[name]]


def test_a_stopped_run_ends_with_the_same_images(
    dataset: Path, tmp_path: Path, weights: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    expected = denoised(dataset, tmp_path / "expected", weights)
    write = shards._write
    out = tmp_path / "out"

    def stop_after_the_first(shard: shards._Shard, job: object) -> None:
        if list(out.rglob("*.h5")):
            raise KeyboardInterrupt
        write(shard, job)  # type: ignore[arg-type]

    with monkeypatch.context() as patch:
        patch.setattr(shards, "_write", stop_after_the_first)
        with pytest.raises(KeyboardInterrupt):
            denoised(dataset, out, weights)
    (finished,) = out.rglob("*.h5")
    written = finished.stat().st_mtime_ns
    assert denoised(dataset, out, weights) == expected
    assert finished.stat().st_mtime_ns == written


def test_a_damaged_frame_costs_the_shards_of_its_recording(
    dataset: Path, tmp_path: Path, weights: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = dataset / "train/shard-00002.h5"
    with h5py.File(path) as file:
        place = file["noisy"].id.get_chunk_info(1).byte_offset
    content = bytearray(path.read_bytes())
    content[place + 40] ^= 8
    path.write_bytes(content)
    out = tmp_path / "out"
    assert main([str(dataset), "--out", str(out), "--weights", str(weights)]) == 1
    assert "shard-00002.h5" in capsys.readouterr().err
    assert [file.name for file in out.rglob("*.h5")] == ["shard-00000.h5"]


def test_one_recording_is_read_like_that_of_a_sonar(
    dataset: Path, tmp_path: Path, weights: Path
) -> None:
    assert is_recording(dataset / "sea/1")
    with open_recording(dataset / "sea/1") as recording:
        frames = list(recording)
    assert [frame.time_s for frame in frames] == [number / 4 for number in range(FRAMES)]
    for number, frame in enumerate(frames):
        np.testing.assert_array_equal(frame.samples, recorded_pair("1", number).noisy)
    out = tmp_path / "out"
    assert main([str(dataset / "sea/1"), "--out", str(out), "--weights", str(weights)]) == 0
    images = sorted((out / "1").glob("*.png"))
    assert len(images) == FRAMES
    image = cv2.imread(str(images[0]), cv2.IMREAD_UNCHANGED)
    assert image is not None
    assert image.shape == frames[0].samples.shape


@pytest.mark.parametrize("name", ["", "sea/7", "trian/shard-00000.h5"])
def test_what_is_no_recording_of_the_dataset_is_told(dataset: Path, name: str) -> None:
    with pytest.raises(FactoryError, match="sea/0"):
        open_recording(dataset / name)


def test_manifests_of_other_programs_are_no_datasets(tmp_path: Path) -> None:
    (tmp_path / "manifest.json").write_text('{"name": "a page"}')
    with pytest.raises(FactoryError, match="no such file"):
        open_recording(tmp_path / "dive.avi")


@pytest.mark.parametrize(("name", "recordings"), [("", ["sea/0", "sea/1"]), ("sea/1", ["1"])])
def test_evaluation_takes_recordings_of_a_dataset_and_not_its_preview(
    dataset: Path, name: str, recordings: list[str]
) -> None:
    cv2.imwrite(str(dataset / "preview.png"), np.zeros((8, 8), np.uint8))
    stretches, _ = open_input(dataset / name)
    assert [stretch.name for stretch in stretches] == recordings
    for stretch in stretches:
        assert len(stretch.shots) == FRAMES
    image, _ = stretches[-1].shots[3].read()
    stored = np.rint(image * 255).astype(np.uint8)
    np.testing.assert_array_equal(stored, recorded_pair("1", 3).noisy)
    assert known_as(stretches[0].shots[0].path, [LearnedFile("1", 1, "")]) is None
