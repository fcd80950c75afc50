"""`simnfnd adapt`: static stretches are found, and weights learn from it without any truth."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from simnfnd.factory.common.array_types import Float32s
from simnfnd.factory.common.errors import FactoryError
from simnfnd.models.adapting.adapting import Lesson, psnr_after_levels
from simnfnd.models.adapting.command import main
from simnfnd.models.adapting.stretches import find_lessons, read_clips
from simnfnd.models.denoise.denoiser import Denoiser
from simnfnd.models.networks import build_network
from simnfnd.models.networks.weights import load_weights, save_weights
from simnfnd.models.recordings.inputs import NONE, Geometries
from tests.models.adapt.scenes import noisy, scene, write
from tests.project_files import ROOT

DATA = ROOT.parent / "shared/data"
CONFIG = {"kind": "nafnet", "width": 8, "encoder": [1], "middle": 1, "decoder": [1]}


@pytest.fixture
def weights(tmp_path: Path) -> Path:
    """A network that leaves images as they are until it learns something."""
    torch.manual_seed(0)
    network = build_network(CONFIG)
    with torch.no_grad():
        for name, value in network.named_parameters():
            if name.startswith("outro"):
                value.zero_()
    path = tmp_path / "start.safetensors"
    save_weights(path, network, CONFIG, {"steps": 0})
    return path


def write_static_scenes(folder: Path, scenes: int = 2, frames: int = 6) -> list[Float32s]:
    truth = [scene(number) for number in range(scenes)]
    for number, scene_ in enumerate(truth):
        for frame in range(frames):
            write(folder / f"{number}" / f"f{frame}.png", noisy(scene_, 100 * number + frame))
    return truth


def clips_of(folder: Path) -> list:
    return read_clips([folder], folder / "out", Geometries(NONE)).clips


@pytest.mark.slow
def test_weights_learn_from_frames_without_truth(
    tmp_path: Path, weights: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    truth = write_static_scenes(tmp_path / "in")
    arguments = [str(tmp_path / "in"), "--weights", str(weights), "--steps", "24"]
    arguments += ["--learning-rate", "1e-3"]
    outs = [tmp_path / name for name in ("a.safetensors", "b.safetensors")]
    for out in outs:
        assert main([*arguments, "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert "2 static stretch(es) in 12 frames: 6 frames to learn from, 6 held out" in said
    assert "PSNR after levels: noisy" in said
    assert outs[0].read_bytes() == outs[1].read_bytes(), "the same steps and seed, other weights"
    fresh = noisy(truth[1], 999)  # of the scene that nothing was learned from
    denoised = Denoiser(outs[0], "cpu")(fresh)
    assert psnr_after_levels(denoised, truth[1]) > psnr_after_levels(fresh, truth[1]) + 0.5
    facts = load_weights(outs[0]).training
    assert (facts["adapted.frames"], facts["steps"], facts["seed"]) == (6, 24, 0)
    assert facts["start.training"] == {"steps": 0}
    assert facts["validation"]["after"] > facts["validation"]["before"]
    assert str(tmp_path) not in str(facts)


def test_weights_that_are_no_better_are_not_written(
    tmp_path: Path, weights: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for frame in range(5):  # with hardly any noise
        write(tmp_path / "in" / f"{frame}.png", noisy(scene(0), frame, 0.01))
    out = tmp_path / "out.safetensors"
    arguments = ["--weights", str(weights), "--steps", "2"]
    assert main([str(tmp_path / "in"), "--out", str(out), *arguments]) == 1
    assert "nothing written" in capsys.readouterr().out
    assert not out.exists()


def test_without_a_scene_at_rest_one_line_says_so(tmp_path: Path, weights: Path) -> None:
    for frame in range(6):
        write(tmp_path / "in" / f"{frame}.png", noisy(scene(frame), frame))
    out = tmp_path / "out.safetensors"
    arguments = ["--weights", str(weights), "--steps", "2"]
    with pytest.raises(FactoryError, match="6 frames"):
        main([str(tmp_path / "in"), "--out", str(out), *arguments])
    assert not out.exists()


def test_no_frame_held_out_is_learned_from(tmp_path: Path) -> None:
    write_static_scenes(tmp_path / "one", 1, 10)
    lessons = find_lessons(clips_of(tmp_path / "one"))
    assert lessons is not None
    assert lessons.same
    assert [len(still.frames) for still in (*lessons.learning, *lessons.held)] == [8, 2]
    learned = {frame.tobytes() for frame in lessons.learning[0].frames}
    assert not learned & {frame.tobytes() for frame in lessons.held[0].frames}
    mean = np.mean([frame for frame in lessons.learning[0].frames[1:]], axis=0)
    inner = np.s_[8:-8, 8:-8]
    assert np.abs(lessons.learning[0].targets[0] - mean)[inner].max() < 0.1
    assert np.abs(lessons.learning[0].targets[0] - mean)[inner].mean() < 0.01


def test_the_frames_that_judge_have_no_part_in_the_choice(tmp_path: Path) -> None:
    write_static_scenes(tmp_path / "two", 2, 8)
    lessons = find_lessons(clips_of(tmp_path / "two"))
    assert lessons is not None
    lesson = Lesson(lessons, 0, ())
    assert lesson.is_judged_apart
    choosing = {sample.noisy.tobytes() for sample in lesson.choosing}
    judging = {sample.noisy.tobytes() for sample in lesson.judging}
    assert choosing
    assert judging
    assert not choosing & judging
    alone = replace(lessons.held[0], frames=lessons.held[0].frames[:1])
    assert not Lesson(replace(lessons, held=[alone]), 0, ()).is_judged_apart


def test_moving_objects_are_no_target(tmp_path: Path) -> None:
    truth = scene(0)
    for frame in range(8):
        image = noisy(truth, frame, 0.03)
        image[24:34, 7 * frame + 2 : 7 * frame + 12] = 1
        write(tmp_path / f"{frame}.png", image)
    lessons = find_lessons(clips_of(tmp_path))
    assert lessons is not None
    unknown = np.isnan(lessons.learning[0].targets[0])
    assert unknown[25:33, 6:56].mean() > 0.9
    assert unknown[50:60, 8:-8].mean() < 0.05


def test_stretches_are_found_in_a_shuffled_folder(tmp_path: Path) -> None:
    truth = [scene(number) for number in range(9)]
    # Two scenes are static, among others, and no two of their frames follow each other.
    order = [0, 2, 1, 3, 0, 4, 1, 5, 0, 6, 1, 7, 0, 8, 1] * 2
    for frame, number in enumerate(order):
        write(tmp_path / f"{frame:03d}.png", noisy(truth[number], frame))
    lessons = find_lessons(clips_of(tmp_path))
    assert lessons is not None
    assert not lessons.same
    stills = [*lessons.learning, *lessons.held]
    closest = [
        int(np.argmin([np.abs(np.mean(still.frames, axis=0) - image).mean() for image in truth]))
        for still in stills
    ]
    assert set(closest) >= {0, 1}


@pytest.mark.parametrize(
    ("files", "words", "said"),
    [
        ([], [], "no image, shard, video or recording"),
        (["a0.png"], [], "no scene is static in 1 frames"),
        (["a.png", "b.png"], ["--steps", "0"], "--steps 0"),
        (["a.png", "b.png"], ["--learning-rate", "2"], "--learning-rate 2"),
        (["a.png", "b.png"], ["--out", "here"], r"must end in \.safetensors"),
        (["a.png", "b.png"], ["--weights", "nowhere"], "nowhere"),
        (["train/a.h5"], [], "belongs to a dataset"),
    ],
)
def test_bad_input_is_one_line(
    tmp_path: Path, files: list[str], words: list[str], said: str
) -> None:
    folder = tmp_path / "in"
    folder.mkdir()
    for number, name in enumerate(files):
        if name.endswith(".h5"):
            (folder / name).parent.mkdir()
            (folder / name).write_bytes(b"")
        else:
            write(folder / name, noisy(scene(number), number))
    out = ["--out", str(tmp_path / "out.safetensors")]
    with pytest.raises(FactoryError, match=said) as caught:
        main([str(folder), *out, *words])
    assert "\n" not in str(caught.value)


def test_damaged_images_are_left_out(
    tmp_path: Path, weights: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_static_scenes(tmp_path / "in", 1, 6)
    (tmp_path / "in" / "0" / "f3.png").write_bytes(b"no image")
    out = tmp_path / "out.safetensors"
    arguments = ["--weights", str(weights), "--steps", "12", "--learning-rate", "1e-3"]
    assert main([str(tmp_path / "in"), "--out", str(out), *arguments]) == 0
    caught = capsys.readouterr()
    assert "f3.png" in caught.err
    assert "in 5 of 6 frames" in caught.out


@pytest.mark.slow
@pytest.mark.skipif(not DATA.is_dir(), reason="needs the sample recordings")
def test_sample_recordings_are_static(tmp_path: Path) -> None:
    with_ping = read_clips([DATA / "aris-sdk/sample.aris"], tmp_path, Geometries(NONE))
    lessons = find_lessons(with_ping.clips)
    assert lessons is not None
    assert [len(stretch.frames) for stretch in (*lessons.learning, *lessons.held)] == [5, 1]
    video = DATA / "didson/lamprey1.avi"
    part = read_clips([video], tmp_path, Geometries(NONE), most=16)
    assert (part.frames, sum(len(clip.shots) for clip in part.clips)) == (150, 16)
    lessons = find_lessons(part.clips)
    assert lessons is not None
    assert [len(stretch.frames) for stretch in (*lessons.learning, *lessons.held)] == [13, 3]
