"""`simnfnd evaluate transfer`: COCO files, figures, folds, arms, and the command on small data."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from simnfnd.command import main
from simnfnd.evaluation.commands import _transfer_words
from simnfnd.evaluation.transfer.arms import folds_of, thin_groups
from simnfnd.evaluation.transfer.blobs import detect_blobs
from simnfnd.evaluation.transfer.coco import RealImage, read_coco
from simnfnd.evaluation.transfer.scores import (
    Matches,
    average_precision,
    countable,
    figures_of,
    group_draws,
    match,
    recall_at,
    threshold_at,
)
from simnfnd.evaluation.transfer.sheet import detection_sheet, match_greedily
from simnfnd.evaluation.transfer.simulated import (
    LabelRules,
    read_simulated,
)
from simnfnd.factory.common.errors import FactoryError
from simnfnd.models.detection.boxes import no_boxes
from simnfnd.models.detection.detector import Detections
from simnfnd.models.detection.images import LabelledImage
from simnfnd.models.detection.training import DETECTOR_NAME
from simnfnd.models.detection.weights import read_facts
from tests.small_detection import (
    HEIGHT,
    WIDTH,
    coco_content,
    working_images,
    write_coco,
    write_labelled_dataset,
)

SMALL = (
    "steps=2",
    "real_steps=1",
    "batch=2",
    "folds=2",
    "bootstrap=20",
    "shares=[1]",
    "examples=2",
)


def test_reads_boxes_classes_and_groups(tmp_path: Path) -> None:
    content = coco_content()
    wanted = content["annotations"][0]["bbox"]
    content["annotations"].append({"id": 90, "image_id": 1, "category_id": 5, "bbox": [0, 0, 9, 9]})
    folder = write_coco(tmp_path / "tank", content)
    real = read_coco(folder, ignore=["Wall"], names={"Tire": "Tyre"})
    assert real.classes == ("Tyre", "Bottle")
    assert real.has_groups
    assert [image.labelled.group for image in real.images] == list("00112233")
    left, top, right, bottom = real.images[0].labelled.boxes[0].tolist()
    assert [left, top, right - left, bottom - top] == wanted
    assert real.images[0].ignored.tolist() == [[0, 0, 9, 9]]


def test_images_of_ten_bits_and_of_a_colour_map_are_read_as_they_look(tmp_path: Path) -> None:
    folder = write_coco(tmp_path / "tank", coco_content())
    plain = read_coco(folder)
    for number, path in enumerate(sorted((folder / "images").iterdir())):
        grey = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        assert grey is not None
        painted = cv2.applyColorMap(grey, cv2.COLORMAP_VIRIDIS)
        cv2.imwrite(str(path), painted if number % 2 else grey.astype(np.uint16) * 4)
    for before, after in zip(plain.images, read_coco(folder).images, strict=True):
        apart = before.labelled.image.astype(int) - after.labelled.image
        assert np.abs(apart).max() <= 3


@pytest.mark.parametrize("mark", ["iscrowd", "ignore"])
def test_crowds_are_no_objects_and_hide_none(tmp_path: Path, mark: str) -> None:
    read = read_coco(write_coco(tmp_path / "plain", coco_content()))
    content = coco_content()
    for image in content["images"]:
        content["annotations"].append(
            {"id": 90 + image["id"], "image_id": image["id"], "category_id": 1,
             "bbox": [0, 0, WIDTH, HEIGHT], mark: 1}
        )  # fmt: skip
    crowded = read_coco(write_coco(tmp_path / "crowded", content))
    for plain, image in zip(read.images, crowded.images, strict=True):
        assert image.labelled.boxes.tolist() == plain.labelled.boxes.tolist()
    detections = noisy_detections(list(crowded.images))
    matches, precision = match(crowded.images, detections, None, 0.5)
    without, lower = match(read.images, detections, None, 0.5)
    assert matches.object_counts.tolist() == without.object_counts.tolist()
    assert matches.is_hit.sum() == without.is_hit.sum()
    assert len(matches.is_hit) < len(without.is_hit)  # no false alarm in the crowd
    assert precision > lower


def _change(path: str, value: Any) -> Callable[[dict[str, Any]], None]:
    """Sets one entry of a file of annotations, for example `annotations.0.bbox`."""

    def apply(content: dict[str, Any]) -> None:
        place: Any = content
        *steps, last = path.split(".")
        for step in steps:
            place = place[int(step)] if step.isdigit() else place[step]
        place[last] = value

    return apply


@pytest.mark.parametrize(
    "change",
    [
        _change("images", {}),
        _change("images", []),
        _change("categories", None),
        _change("annotations", [3]),
        _change("images.0.file_name", "absent.png"),
        _change("images.0.file_name", "../outside.png"),
        _change("annotations.0.bbox", [10**400, 2, 3, 4]),
        _change("images.0.width", 12),
        _change("images.0.id", 2),
        _change("categories.0.name", ""),
        _change("categories.0.id", 2),
        _change("annotations.0.image_id", 77),
        _change("annotations.0.category_id", 77),
        _change("annotations.0.bbox", [1, 2, 3]),
        _change("annotations.0.bbox", [1, 2, 0, 4]),
        _change("annotations.0.bbox", [1, 2, "3", 4]),
        _change("annotations.0.bbox", [WIDTH + 1, 2, 3, 4]),
    ],
)
def test_bad_files_get_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], change: Callable[[dict[str, Any]], None]
) -> None:
    content = coco_content()
    pixels = [entry.pop("pixels") for entry in content["images"]]
    images = [
        {**entry, "pixels": array} for entry, array in zip(content["images"], pixels, strict=True)
    ]
    folder = write_coco(tmp_path / "tank", {**content, "images": images})
    cv2.imwrite(str(tmp_path / "outside.png"), pixels[0])  # readable, and nobody's business
    change(content)
    (folder / "annotations.json").write_text(json.dumps(content))
    with pytest.raises(FactoryError) as caught:
        read_coco(folder)
    assert "\n" not in str(caught.value)
    assert str(folder) in str(caught.value)


def test_damaged_files_and_absent_classes_are_refused(tmp_path: Path) -> None:
    folder = write_coco(tmp_path / "tank", coco_content())
    with pytest.raises(FactoryError, match=r"^ignore: "):
        read_coco(folder, ignore=["Cat"])
    with pytest.raises(FactoryError, match=r"^class_names: "):
        read_coco(folder, names={"Cat": "Tire"})
    with pytest.raises(FactoryError, match=r"^annotations=other.json: "):
        read_coco(folder, annotations="other.json")
    (folder / "images" / "0001.png").write_bytes(b"no image")
    with pytest.raises(FactoryError, match=r"0001.png: "):
        read_coco(folder)
    (folder / "annotations.json").write_text("{")
    with pytest.raises(FactoryError):
        read_coco(folder)
    with pytest.raises(FactoryError):
        read_coco(tmp_path / "absent")


def real_images(count: int, seed: int = 0) -> list[RealImage]:
    return [RealImage(w.labelled, no_boxes()) for w in working_images(count, seed)]


def noisy_detections(images: list[RealImage], seed: int = 0) -> list[Detections]:
    """Shifted boxes and false ones with random scores."""
    rng = np.random.default_rng(seed)
    found = []
    for image in images:
        shifted = image.labelled.boxes + rng.uniform(-3.5, 3.5, image.labelled.boxes.shape)
        false = rng.uniform(0, 40, (2, 4)) + np.array([0, 0, 50, 50])
        boxes = np.concatenate([shifted, false]).astype(np.float32)
        scores = rng.random(len(boxes)).astype(np.float32)
        labels = rng.integers(0, 2, len(boxes))
        order = np.argsort(-scores)
        found.append(Detections(boxes[order], scores[order], labels[order]))
    return found


@pytest.mark.parametrize("iou", [0.3, 0.5])
def test_average_precision_is_that_of_pycocotools(iou: float) -> None:
    for seed in range(4):
        images = real_images(6, seed)
        found = noisy_detections(images, seed)
        for label in (None, 0, 1):
            matches, precision = match(images, found, label, iou)
            assert average_precision(matches) == pytest.approx(precision, abs=1e-12)
            twice = np.full(len(images), 2)
            assert average_precision(matches, twice) == pytest.approx(precision, abs=1e-12)


def test_weights_are_copies_of_images() -> None:
    images = real_images(3)
    found = noisy_detections(images)
    matches, _ = match(images, found, None, 0.5)
    copies, precision = match([*images, images[1]], [*found, found[1]], None, 0.5)
    weights = np.array([1, 2, 1])
    assert average_precision(matches, weights) == pytest.approx(precision, abs=1e-12)
    assert recall_at(matches, [0.5], weights) == pytest.approx(recall_at(copies, [0.5]))


def test_recall_at_a_rate_of_false_alarms() -> None:
    matches = Matches(
        image=np.array([0, 0, 1, 1, 1]),
        score=np.array([0.9, 0.8, 0.7, 0.6, 0.5]),
        is_hit=np.array([True, False, True, False, True]),
        object_counts=np.array([2, 2]),
    )
    assert recall_at(matches, [0, 0.5, 1, 9]) == [0.25, 0.5, 0.75, 0.75]
    assert threshold_at(matches, 0.5) == pytest.approx(0.6)
    perfect = Matches(np.array([0]), np.array([1.0]), np.array([True]), np.array([1, 0]))
    assert average_precision(perfect) == 1


def test_perfect_detections_have_perfect_figures() -> None:
    images = real_images(4)
    found = [
        Detections(image.labelled.boxes, np.ones(2, np.float32), image.labelled.labels)
        for image in images
    ]
    draws = group_draws([image.labelled.group for image in images], 30, 0)
    figures, _ = figures_of(images, found, None, draws)
    assert figures.ap50 == figures.ap30 == figures.recall == (1, 1, 1)
    assert figures.object_count == 8


def test_draws_keep_groups_whole() -> None:
    groups = ["a", "b", "a", "c", "b"]
    draws = group_draws(groups, 50, 0)
    assert (draws[:, 0] == draws[:, 2]).all()
    assert (draws[:, 1] == draws[:, 4]).all()
    distinct = draws[:, [0, 1, 3]]
    assert (distinct.sum(axis=1) == 3).all()
    assert len(np.unique(distinct, axis=0)) > 5


def test_detections_on_ignored_boxes_do_not_count() -> None:
    boxes = np.array([[0, 0, 10, 10], [8, 0, 20, 10], [40, 40, 50, 50]], np.float32)
    found = Detections(boxes, np.array([0.9, 0.8, 0.7], np.float32), np.zeros(3, np.int64))
    left = countable(found, np.array([[0, 0, 13, 30]], np.float32))
    assert left.scores.tolist() == pytest.approx([0.8, 0.7])


def test_folds_and_shares_keep_groups() -> None:
    groups = [str(number // 5) for number in range(50)]
    folds = folds_of(groups, 3)
    assert sorted(number for fold in folds for number in fold) == list(range(50))
    for fold in folds:
        assert {groups[number] for number in fold}.isdisjoint(
            groups[number] for other in folds if other is not fold for number in other
        )
    learned = thin_groups(folds[0], groups, 0.2)
    assert len(learned) == round(0.2 * len(folds[0]))
    assert {groups[number] for number in learned} == {groups[number] for number in folds[0]}


def test_blobs_are_found() -> None:
    image = np.full((HEIGHT, WIDTH), 60, np.uint8)
    cv2.circle(image, (30, 50), 9, (220,), -1)
    (working,) = working_images(1)
    labelled = LabelledImage("blob", "blob", image, no_boxes(), np.zeros(0, np.int64))
    (found,) = detect_blobs([type(working)(labelled, 1.0, working.is_fan)])
    left, top, right, bottom = found.boxes[0]
    assert (left + right) / 2 == pytest.approx(30.5, abs=2)
    assert (top + bottom) / 2 == pytest.approx(50.5, abs=2)
    assert 14 < right - left < 40


def test_simulated_objects_are_the_masks(tmp_path: Path) -> None:
    dataset = write_labelled_dataset(tmp_path)
    learned, held_out = read_simulated(dataset, ("Bottle", "Tire"), LabelRules())
    assert (len(learned), len(held_out)) == (8, 2)
    for working in learned:
        sides = (working.labelled.boxes[:, 2:] - working.labelled.boxes[:, :2]) / working.scale
        wanted = np.array([[8, 24], [16, 16]])[working.labelled.labels]
        np.testing.assert_allclose(sides, wanted, rtol=1e-5)
    padded, _ = read_simulated(dataset, ("Tire",), LabelRules(padding=1 / HEIGHT))
    assert {label for working in padded for label in working.labelled.labels} == {0}
    widths = [b[2] - b[0] for w in padded for b in w.labelled.boxes / w.scale if b[0] and b[2] < 64]
    np.testing.assert_allclose(widths, 18, rtol=1e-5)
    with pytest.raises(FactoryError):
        read_simulated(dataset, ("Hook",), LabelRules())


def test_rules_choose_what_is_taught(tmp_path: Path) -> None:
    dataset = write_labelled_dataset(tmp_path, test=0)
    learned, _ = read_simulated(dataset, ("Bottle", "Tire"), LabelRules(min_side=12 / HEIGHT))
    # Bottles are 8 pixels wide, tyres 16.
    assert {label for working in learned for label in working.labelled.labels} == {1}
    with pytest.raises(FactoryError):
        read_simulated(dataset, ("Bottle",), LabelRules(with_shadow=("Bottle",)))


def test_exports_are_read_as_they_are(tmp_path: Path) -> None:
    dataset = write_labelled_dataset(tmp_path / "simulated")
    out = tmp_path / "coco"
    assert main(["export", str(dataset), "--to", "coco", "--out", str(out)]) == 0
    real = read_coco(out, annotations="annotations/instances_test.json")
    _, held_out = read_simulated(dataset, real.classes, LabelRules())
    assert len(real.images) == len(held_out) == 2
    for image, working in zip(real.images, held_out, strict=True):
        own = working.labelled.boxes / working.scale
        order = np.lexsort(own.T)
        np.testing.assert_allclose(
            image.labelled.boxes[np.lexsort(image.labelled.boxes.T)], own[order], atol=1e-3
        )


def test_greedy_matches_take_an_object_once() -> None:
    truth = np.array([[0, 0, 10, 10]], np.float32)
    shown = np.array([[0, 0, 10, 9], [0, 0, 10, 10]], np.float32)
    assert match_greedily(shown, truth) == [(0, 0)]


def test_sheet_shows_each_kind_of_box() -> None:
    image = np.zeros((120, 80), np.uint8)
    boxes = np.array([[10, 10, 30, 30], [40, 60, 60, 80]], np.float32)
    labelled = LabelledImage("a", "1", image, boxes, np.zeros(2, np.int64))
    real = RealImage(labelled, np.array([[0, 90, 70, 110]], np.float32))
    shown = np.array([[10, 10, 30, 31], [60, 10, 75, 40], [5, 5, 9, 9]], np.float32)
    found = Detections(shown, np.array([0.9, 0.8, 0.1], np.float32), np.zeros(3, np.int64))
    content = detection_sheet([real], [found], 0.5, 4)
    sheet = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR).astype(int)
    blue, green, red = np.moveaxis(sheet, -1, 0)
    assert ((green > red + 80) & (green > blue + 80)).any()  # found
    assert ((red > green + 80) & (red > blue + 80)).any()  # missed
    assert ((red > blue + 80) & (green > blue + 80)).any()  # false alarm


def test_words_become_keys(tmp_path: Path) -> None:
    assert _transfer_words(["a", "b", "--quick", "seed=1"]) == [
        "seed=1", "quick=true", "dataset='a'", "real='b'",
    ]  # fmt: skip
    assert "detector=simnfnd" in _transfer_words(["b"])
    assert "detector=simnfnd" not in _transfer_words(["b", "detector=own"])
    with pytest.raises(FactoryError):
        _transfer_words(["a", "b", "c"])


@pytest.mark.slow
def test_command_trains_judges_and_goes_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    dataset = write_labelled_dataset(tmp_path / "simulated")
    real = write_coco(tmp_path / "tank", coco_content())
    out = tmp_path / "out"
    words = ["evaluate", "transfer", str(dataset), str(real), f"out={out}", *SMALL]
    words += ["ignore=[Wall]"]
    assert main(words) == 0
    facts = json.loads((out / "transfer.json").read_text())
    labels = [row["label"] for row in facts["rows"]]
    assert len(labels) == 4
    assert all(0 <= row["ap50"]["value"] <= 1 for row in facts["rows"])
    assert facts["classes"] == ["Tire", "Bottle"]
    assert (out / "sheet.png").is_file()
    assert "curves.svg" in (out / "transfer.md").read_text()
    detector = out / "simulation" / DETECTOR_NAME
    written = detector.stat().st_mtime_ns

    # Trainings that are done are not done again, and give the same figures.
    assert main(words) == 0
    assert detector.stat().st_mtime_ns == written
    assert json.loads((out / "transfer.json").read_text()) == facts

    judged = tmp_path / "judged"
    given = [f"detector={detector}", "arms=[simulation]", f"out={judged}", "bootstrap=20"]
    assert main(["evaluate", "transfer", str(real), *given, "ignore=[Wall]"]) == 0
    (row,) = json.loads((judged / "transfer.json").read_text())["rows"]
    alone = facts["rows"][labels.index("simulation alone")]
    assert row["ap50"]["value"] == alone["ap50"]["value"]
    capsys.readouterr()


def test_a_detector_is_trained_without_real_images(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    dataset = write_labelled_dataset(tmp_path / "simulated")
    out = tmp_path / "out"
    words = [f"dataset={dataset}", "classes=[Tire,Bottle]", f"out={out}", "steps=1", "batch=2"]
    assert main(["evaluate", "transfer", *words]) == 0
    assert read_facts(out / "simulation" / DETECTOR_NAME).classes == ("Tire", "Bottle")
    assert main(["evaluate", "transfer", *words[:1], "classes=[Cat]"]) == 2
    capsys.readouterr()


@pytest.mark.parametrize(
    "words",
    [
        ["folds=9"],
        ["detector=absent.safetensors"],
        ["class_names={Tire: Cat, Bottle: Dog}"],
        ["arms=[]"],
        ["shares=[2]"],
        ["seed=1"],
    ],
)
def test_mistakes_get_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str]
) -> None:
    dataset = write_labelled_dataset(tmp_path / "simulated", train=2, test=0)
    real = write_coco(tmp_path / "tank", coco_content())
    given = ["evaluate", "transfer", str(dataset), str(real), f"out={tmp_path / 'out'}", *words]
    if words == ["seed=1"]:
        given = ["evaluate", "transfer", f"real={real}", f"out={tmp_path / 'out'}", *words]
    assert main(given) == 2
    message = capsys.readouterr().err.strip().splitlines()
    assert len(message) == 1
    assert "Traceback" not in message[0]
