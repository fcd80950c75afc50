"""The small detector: boxes, augmentation, targets, training that goes on, and its files."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from simnfnd import detect
from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.common.files import sha256_of
from simnfnd.models.detection import SHIPPED_NAME, find_detector
from simnfnd.models.detection import training as training_module
from simnfnd.models.detection.augmentation import vary
from simnfnd.models.detection.boxes import (
    grow_boxes,
    intersection_over_union,
    mirror_boxes,
    share_inside,
    suppress_duplicates,
)
from simnfnd.models.detection.clutter import add_repeats
from simnfnd.models.detection.detector import (
    STRIDE,
    Detections,
    _fuse,
    _weigh,
    decode,
    detect_at,
    detect_in,
    no_detections,
)
from simnfnd.models.detection.images import (
    SIDE_PX,
    LabelledImage,
    find_fan,
    reaches_far_end,
    scale_image,
)
from simnfnd.models.detection.network import DetectorNetwork, Outputs
from simnfnd.models.detection.normalise import normalise
from simnfnd.models.detection.objective import Targets, detection_loss, draw_targets
from simnfnd.models.detection.runtime import DetectorRuntime, RawOutputs
from simnfnd.models.detection.training import (
    CHECKPOINT_NAME,
    DETECTOR_NAME,
    BatchShare,
    Schedule,
    train_detector,
)
from simnfnd.models.detection.weights import (
    Calibration,
    DetectorFacts,
    calibrate_file,
    load_detector,
    save_detector,
)
from tests.small_detection import CLASSES, HEIGHT, WIDTH, working_images


def as_boxes(*corners: tuple[float, float, float, float]) -> np.ndarray:
    return np.array(corners, np.float32)


def test_overlap_of_boxes() -> None:
    first = as_boxes((0, 0, 4, 4), (10, 10, 12, 12))
    second = as_boxes((2, 0, 6, 4))
    np.testing.assert_allclose(intersection_over_union(first, second), [[8 / 24], [0.0]])
    np.testing.assert_allclose(share_inside(first, second), [[0.5], [0.0]])
    np.testing.assert_allclose(grow_boxes(first, 3, 12, 12)[1], [7, 7, 12, 12])


def test_duplicates_give_way_to_better_ones() -> None:
    boxes = as_boxes((0, 0, 10, 10), (0, 0, 10, 9), (20, 20, 30, 30))
    scores = np.array([0.3, 0.9, 0.5], np.float32)
    assert suppress_duplicates(boxes, scores, 0.5) == [1, 2]
    assert suppress_duplicates(boxes, scores, 0.95) == [1, 2, 0]


def test_input_does_not_depend_on_gain_and_little_on_gamma() -> None:
    rng = np.random.default_rng(0)
    image = rng.gamma(2, 0.1, (64, 48)).astype(np.float32)
    fan = np.ones(image.shape, bool)
    plain = normalise(image, fan)
    assert np.abs(plain).max() <= 1
    louder = normalise(image**0.7 * 3, fan)
    assert np.abs(plain[0] - louder[0]).mean() < 0.05
    assert np.abs(plain[0]).mean() > 0.2


def test_varied_boxes_stay_on_their_objects() -> None:
    rng = np.random.default_rng(1)
    for working in working_images(6):
        image, boxes, _ = vary(working, (HEIGHT, WIDTH), rng, with_clutter=False)
        for left, top, right, bottom in np.rint(boxes).astype(int):
            # Some wide gain may be drawn over an object, so the rim around it is what it exceeds.
            inside = image[0, top:bottom, left:right].mean()
            around = image[0, max(0, top - 6) : bottom + 6, max(0, left - 6) : right + 6].mean()
            assert inside > around


def test_same_draws_give_the_same_variation() -> None:
    (working,) = working_images(1)
    first, second = (
        vary(working, (HEIGHT, WIDTH), np.random.default_rng(5), with_clutter=True)
        for _ in range(2)
    )
    np.testing.assert_array_equal(first[0], second[0])
    other = vary(working, (HEIGHT, WIDTH), np.random.default_rng(6), with_clutter=True)
    assert not np.array_equal(first[0], other[0])


def test_repeats_are_fainter_and_farther_away() -> None:
    image = np.zeros((60, 20), np.float32)
    image[40:44, 5:12] = 1
    repeated = add_repeats(image, np.random.default_rng(0))
    np.testing.assert_allclose(repeated[40:44], image[40:44], atol=1e-4)
    assert repeated[44:].max() < 0.5  # blur alone
    farther = repeated[:36].max()
    assert 0.02 < farther < 0.7


def test_scaling_keeps_boxes_and_finds_the_fan() -> None:
    image = np.zeros((480, 320), np.uint8)
    image[40:400, 60:260] = 90
    image[100:400, 150:160] = 0  # a bearing without an echo
    source = LabelledImage("a", "a", image, as_boxes((60, 40, 160, 140)), np.zeros(1, np.int64))
    working = scale_image(source)
    assert working.labelled.image.shape == (SIDE_PX, round(SIDE_PX * 2 / 3))
    np.testing.assert_allclose(working.labelled.boxes * 480 / SIDE_PX, [[60, 40, 160, 140]])
    assert working.is_fan[SIDE_PX // 2, SIDE_PX * 77 // 240]
    assert not working.is_fan[5, 5]


def test_decoded_targets_are_the_boxes() -> None:
    (working,) = working_images(1)
    source = working.labelled
    heat, sides, _, label = draw_targets(source.boxes, source.labels, HEIGHT, WIDTH)
    classes = np.stack([label == number for number in range(2)]).astype(np.float32)
    found = decode(RawOutputs(heat, sides, classes), working)
    overlap = intersection_over_union(found.boxes, source.boxes)
    assert len(found.boxes) == len(source.boxes)
    assert (overlap.max(axis=0) > 0.99).all()
    np.testing.assert_array_equal(found.labels, source.labels[overlap.argmax(axis=1)])


def test_loss_is_least_for_the_targets() -> None:
    (working,) = working_images(1)
    source = working.labelled
    drawn = draw_targets(source.boxes, source.labels, HEIGHT, WIDTH)
    targets = Targets(*(torch.from_numpy(array)[None] for array in drawn))
    classes = torch.stack([targets.label == number for number in range(2)], 1) * 20.0
    logits = torch.where(targets.heat == 1, 12.0, -12.0)
    perfect = detection_loss(Outputs(logits, targets.sides, classes), targets)
    shifted = detection_loss(Outputs(logits, targets.sides * 1.5, classes), targets)
    confused = detection_loss(Outputs(logits, targets.sides, classes.flip(1)), targets)
    absent = detection_loss(Outputs(-logits, targets.sides, classes), targets)
    assert perfect < 1e-3
    assert min(shifted, confused, absent) > perfect + 0.1


def test_network_is_small() -> None:
    network = DetectorNetwork(10)
    assert sum(parameter.numel() for parameter in network.parameters()) <= 1_000_000
    outputs = network(torch.zeros(1, 3, HEIGHT, WIDTH))
    assert outputs.centre.shape == (1, 1, HEIGHT // STRIDE, WIDTH // STRIDE)


def train(folder: Path, steps: int, **changes: Any) -> Any:
    schedule = Schedule(steps, 4, 4e-3, changes.pop("seed", 0))
    sources = [BatchShare(working_images(8), 1.0, with_clutter=False)]
    return train_detector(folder, sources, CLASSES, schedule, {"about": "squares"}, **changes)


@pytest.mark.slow
def test_training_finds_what_it_learned(tmp_path: Path) -> None:
    detector = DetectorRuntime(train(tmp_path, 70).path)
    unseen = working_images(4, seed=1)
    hits = 0
    images = [working.labelled.image for working in unseen]
    for working, found in zip(unseen, detect_at(detector, images, HEIGHT), strict=True):
        boxes = found.boxes[: len(working.labelled.boxes)]
        overlap = intersection_over_union(working.labelled.boxes, boxes)
        hits += int((overlap.max(axis=1, initial=0) > 0.5).sum())
    assert hits >= 6  # of 8
    # The same objects at the detector's own size, which is larger than these images.
    named = [detect(image, detector=tmp_path / DETECTOR_NAME, threshold=0.1) for image in images]
    assert any(named)
    assert {item.class_name for items in named for item in items} <= set(CLASSES)


def test_killed_training_goes_on_with_the_same_bytes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    train(tmp_path / "whole", 4)
    monkeypatch.setattr(training_module, "_SAVE_EVERY_S", 0)
    take_step = training_module._Training._take_step

    def take_two_steps(self: Any) -> None:
        if self.step == 2:
            raise KeyboardInterrupt
        take_step(self)

    monkeypatch.setattr(training_module._Training, "_take_step", take_two_steps)
    with pytest.raises(KeyboardInterrupt):
        train(tmp_path / "killed", 4)
    monkeypatch.setattr(training_module._Training, "_take_step", take_step)
    assert (tmp_path / "killed" / CHECKPOINT_NAME).is_file()
    train(tmp_path / "killed", 4)
    whole, killed = ((tmp_path / name / DETECTOR_NAME).read_bytes() for name in ("whole", "killed"))
    assert whole == killed
    assert not (tmp_path / "killed" / CHECKPOINT_NAME).exists()


def test_other_recipe_is_refused(tmp_path: Path) -> None:
    train(tmp_path, 1)
    with pytest.raises(FactoryError):
        train(tmp_path, 1, seed=1)


@pytest.mark.parametrize("content", [b"", b"no detector", b"\x08\0\0\0\0\0\0\0{}      "])
def test_other_files_are_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "odd.safetensors"
    path.write_bytes(content)
    with pytest.raises(FactoryError):
        load_detector(path)


def test_onnxruntime_computes_what_torch_does() -> None:
    """Also of other classes than the graph was traced with, and of other sizes."""
    torch.manual_seed(1)
    rng = np.random.default_rng(0)
    path = find_detector(SHIPPED_NAME)
    network = load_detector(path).network
    inputs = rng.normal(size=(3, 3, 80, 48)).astype(np.float32)
    with torch.no_grad():
        expected = network(torch.from_numpy(inputs))
    for values, truth in zip(DetectorRuntime(path)(inputs), expected, strict=True):
        np.testing.assert_allclose(values, truth.numpy(), atol=1e-4)


def test_black_images_hold_nothing(tmp_path: Path) -> None:
    save_detector(tmp_path / "d", DetectorNetwork(2).eval(), DetectorFacts(CLASSES))
    image = np.zeros((HEIGHT, WIDTH), np.uint8)
    (found,) = detect_in(DetectorRuntime(tmp_path / "d"), [image])
    assert not len(found.boxes)
    assert not find_fan(image).any()


def test_a_calibration_changes_scores_and_no_order(tmp_path: Path) -> None:
    save_detector(tmp_path / "d", DetectorNetwork(2).eval(), DetectorFacts(CLASSES))
    calibrate_file(tmp_path / "d", Calibration(2.0, 1.0))
    facts = DetectorRuntime(tmp_path / "d").facts
    assert facts.classes == CLASSES
    assert facts.calibration is not None
    scores = facts.calibration(np.array([0.1, 0.5, 0.9], np.float32))
    np.testing.assert_allclose(scores[1], 1 / (1 + np.exp(-1)), rtol=1e-6)
    assert (np.diff(scores) > 0).all()


def test_views_are_fused() -> None:
    labels = np.array([1, 0])
    box = as_boxes((0, 0, 10, 10), (40, 40, 50, 50))
    first = Detections(box, np.array([0.8, 0.3], np.float32), labels)
    second = Detections(as_boxes((1, 1, 11, 11)), np.array([0.4], np.float32), np.array([0]))
    fused = _fuse([first, second])
    np.testing.assert_allclose(fused.boxes, [[1 / 3, 1 / 3, 31 / 3, 31 / 3], box[1]], rtol=1e-5)
    np.testing.assert_allclose(fused.scores, [(0.8 + 0.6) / 2, (0.3 + 0.15) / 2], rtol=1e-6)
    assert fused.labels.tolist() == [1, 0]
    # At the edge of an image a box may keep no area.
    edge = Detections(as_boxes((64, 3, 64, 9)), np.array([0.2], np.float32), np.array([0]))
    assert _fuse([edge]).boxes.tolist() == [[64, 3, 64, 9]]


def test_narrow_and_cut_off_detections_count_less() -> None:
    """The fan's far end is an arc: at its sides it lies lower than in the middle."""
    is_fan = np.ones((100, 60), bool)
    is_fan[:20, :20] = False
    corners = ((5, 20, 15, 40), (30, 21, 40, 40), (30, 0, 40, 40), (30, 50, 32, 90))
    boxes = np.array(corners, np.float32)
    assert reaches_far_end(boxes, is_fan).tolist() == [True, False, True, False]
    weighed = _weigh(Detections(boxes, np.full(4, 0.8, np.float32), np.arange(4)), is_fan)
    assert weighed.labels.tolist() == [1, 0, 2, 3]
    np.testing.assert_allclose(weighed.scores, [0.8, 0.48, 0.48, 0.2], rtol=1e-6)
    assert not len(_weigh(no_detections(), is_fan).scores)


def test_margin_of_the_file_moves_the_sides(tmp_path: Path) -> None:
    torch.manual_seed(0)
    network = DetectorNetwork(2).eval()
    assert network.heads.bias is not None
    network.heads.bias.data[0] = 3.0  # everything is an object
    (working,) = working_images(1)
    found = []
    for margin in (0.0, -0.01):
        save_detector(tmp_path / "d", network, DetectorFacts(CLASSES, {"margin": margin}))
        detector = DetectorRuntime(tmp_path / "d")
        found.append(detect_in(detector, [working.labelled.image])[0].boxes)
    shift = np.array([1, 1, -1, -1]) * 0.01 * HEIGHT
    is_inside = (found[0][:, :2] > 0).all(1) & (found[0][:, 2:] < [WIDTH, HEIGHT]).all(1)
    assert is_inside.any()
    np.testing.assert_allclose(found[1][is_inside], (found[0] + shift)[is_inside], rtol=1e-5)


def test_the_detector_that_ships_is_that_of_its_card() -> None:
    path = find_detector(SHIPPED_NAME)
    assert path.stat().st_size <= 3_000_000
    card = path.with_suffix(".md").read_text(encoding="utf-8")
    assert sha256_of(path) in card
    trained = load_detector(path)
    count = sum(parameter.numel() for parameter in trained.network.parameters())
    assert f"{count:,}" in card
    command = next(line for line in card.splitlines() if line.startswith("simnfnd evaluate"))
    keys = dict(word.split("=", 1) for word in shlex.split(command) if "=" in word)
    assert trained.facts.training["schedule"]["steps"] == int(keys["steps"])
    assert trained.facts.margin == float(keys.get("margin", 0))
    assert keys["classes"] == f"[{','.join(trained.facts.classes)}]"
    assert all(name in card for name in trained.facts.classes)


def test_mirrored_twice_is_the_same() -> None:
    boxes = as_boxes((1, 2, 5, 9))
    np.testing.assert_array_equal(mirror_boxes(boxes, 20), [[15, 2, 19, 9]])
    np.testing.assert_array_equal(mirror_boxes(mirror_boxes(boxes, 20), 20), boxes)
