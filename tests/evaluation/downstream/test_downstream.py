"""`simnfnd evaluate downstream` on small pictures."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from simnfnd.command import main
from simnfnd.evaluation.downstream import trainings
from simnfnd.evaluation.downstream.network import probabilities, trained
from simnfnd.evaluation.downstream.pictures import inputs_of, targets_of
from tests.factory.export import export_dataset

Array = npt.NDArray[Any]
SMALL = ("steps=2", "batch=2", "shrink=1", "seeds=2", "folds=2", "bootstrap=100", "models=[]")


def pictures(root: Path, count: int, shape: tuple[int, int] = (20, 16)) -> Path:
    """Pictures of different scenes with a block of class 1 or 3 each, and their masks."""
    (root / "Masks").mkdir(parents=True)
    for number in range(count):
        rng = np.random.default_rng(number)
        mask = np.zeros(shape, np.uint8)
        row, column = (int(rng.integers(1, size - 7)) for size in shape)
        mask[row : row + 6, column : column + 6] = (1, 3)[number % 2]
        bright = np.where(mask > 0, 200, 50) + rng.integers(0, 40, shape)
        cv2.imwrite(str(root / f"{number:02d}.png"), bright.astype(np.uint8))
        cv2.imwrite(str(root / "Masks" / f"{number:02d}.png"), mask)
    return root


def downstream(*words: str) -> int:
    return main(["evaluate", "downstream", *words])


def test_the_tables_and_a_second_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, out = pictures(tmp_path / "real", 8), tmp_path / "out"
    simulated = export_dataset.write(tmp_path / "sim", labels=True)
    words = [str(folder), f"out={out}", f"sim={simulated}", "labels=[100,25]", "alike=0.9999"]
    words += ["baselines=[gaussian]", *SMALL]
    assert downstream(*words) == 0
    said = capsys.readouterr().out
    assert "8 pictures in 8 components of similarity" in said
    content = json.loads((out / "downstream.json").read_text(encoding="utf-8"))
    rows = {(one["method"], one["labels_percent"]): one for one in content["rows"]}
    assert set(rows) == {(m, p) for m in ("raw", "gaussian") for p in (100, 25, None)}
    assert [rows["raw", p]["learned"] for p in (100, 25, None)] == [4, 1, 12]
    for one in rows.values():
        for name in ("miou", "object_iou"):
            figure = one["figures"][name]
            low, high = figure["interval"]
            assert 0 <= low <= figure["value"] <= high <= 1
            assert len(figure["seeds"]) == 2
            assert figure["value"] == pytest.approx(np.mean(figure["seeds"]))
    (raw, smooth) = (rows[m, 100]["figures"]["miou"]["value"] for m in ("raw", "gaussian"))
    less = content["less_noisy"][0]
    assert (less["method"], less["labels_percent"]) == ("gaussian", 100)
    assert less["figures"]["miou"]["value"] == pytest.approx(smooth - raw)
    assert {one["name"] for one in content["classes"]} == {"Background", "Bottle", "Chain"}
    page = (out / "downstream.md").read_text(encoding="utf-8")
    assert said.split("\n\n")[1] in page
    assert "the factory's 12" in page

    # Nothing is trained twice; a line that was cut off is.
    lines = (out / trainings.DONE_NAME).read_bytes().splitlines(keepends=True)
    assert len(lines) == 2 * (2 * 2 * 2 + 2)
    (out / trainings.DONE_NAME).write_bytes(b"".join(lines[:-1]) + lines[-1][:40])
    did: list[trainings.Training] = []
    run = trainings.run

    def noted(training: trainings.Training, *given: Any) -> Any:
        did.append(training)
        return run(training, *given)

    monkeypatch.setattr(trainings, "run", noted)
    assert downstream(*words) == 0
    assert [(one.method, one.percent, one.seed) for one in did] == [("gaussian", None, 1)]
    assert json.loads((out / "downstream.json").read_text(encoding="utf-8")) == content
    # Other steps are another training.
    assert downstream(*words, "steps=1", "seeds=1") == 0
    assert len(did) == 1 + 2 * (2 * 2 + 1)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ((), "real: give pictures with masks"),
        (("{root}/none",), "no such folder"),
        (("{root}/bare",), "0.png has no mask of its name in Masks/"),
        (("{root}/odd",), "00.png: class 200; classes are 0 to 20"),
        (("{root}/mixed",), "01.png is 18x20, "),
        (("{root}/good", "folds=5"), "folds=5: the pictures fall into 4 components"),
        (("{root}/good", "folds=1"), "folds"),
        (("{root}/good", "labels=[0]"), "labels"),
        (("{root}/good", "sim={root}/none"), "sim={root}/none: no dataset there"),
        (("{root}/good", "sim={root}/bare_sim"), "segmentation"),
        (("{root}/large", "sim={root}/sim"), "its pictures are 16x20, the real ones 24x32"),
        (("{root}/good", "baselines=[wiener]"), "baselines: no 'wiener'"),
        (("{root}/good", "models=[{root}/none]"), "models: "),
    ],
)
def test_bad_input_is_one_line(
    words: tuple[str, ...], told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pictures(tmp_path / "good", 4)
    pictures(tmp_path / "large", 2, (32, 24))
    (pictures(tmp_path / "bare", 1) / "Masks" / "00.png").unlink()
    odd = pictures(tmp_path / "odd", 1) / "Masks" / "00.png"
    cv2.imwrite(str(odd), np.full((20, 16), 200, np.uint8))
    mixed = pictures(tmp_path / "mixed", 2)
    for path in (mixed / "01.png", mixed / "Masks" / "01.png"):
        cv2.imwrite(str(path), np.full((20, 18), 1, np.uint8))
    export_dataset.write(tmp_path / "bare_sim")
    export_dataset.write(tmp_path / "sim", labels=True)
    filled = [word.format(root=tmp_path) for word in words]
    own = [word for word in SMALL if word.split("=")[0] not in " ".join(words)]
    assert downstream(*own, *filled, f"out={tmp_path / 'out'}", "alike=0.9999") == 2
    error = capsys.readouterr().err
    assert told.format(root=tmp_path) in error
    assert error.count("\n") == 1
    assert "Traceback" not in error


def test_the_network_learns_what_the_picture_shows_and_repeats() -> None:
    """Blocks that are visible are found in pictures it has not seen; any seed starts elsewhere."""
    rng = np.random.default_rng(1)
    images, masks = [], []
    for _ in range(16):
        mask = np.zeros((44, 52), np.uint8)
        row, column = rng.integers(2, 28, 2)
        mask[row : row + 14, column : column + 16] = 1
        images.append(np.where(mask > 0, 0.9, 0.2).astype(np.float32))
        masks.append(mask)
    inputs, targets = inputs_of(images, 1), targets_of(masks, 1, 2)
    how: dict[str, Any] = {"classes": 2, "batch": 4, "device": "cpu"}
    network = trained(inputs[:12], targets[:12], steps=30, seed=3, **how)
    for image, target in zip(inputs[12:], targets[12:], strict=True):
        likely = probabilities(network, image)
        np.testing.assert_allclose(likely.sum(axis=0), 1, rtol=1e-5)
        found = likely[1] > 0.5
        assert (found & (target > 0)).sum() > 0.7 * (found | (target > 0)).sum()

    def short(seed: int) -> Array:
        network = trained(inputs, targets, steps=2, seed=seed, **how)
        return probabilities(network, inputs[0])

    np.testing.assert_array_equal(short(3), short(3))
    assert (short(3) != short(4)).any()


def test_networks_see_no_brightness() -> None:
    image = np.random.default_rng(0).random((9, 12), np.float32)
    image[:, :2] = 0
    small = inputs_of([image, image / 4], 1)
    np.testing.assert_allclose(small[0], small[1], rtol=1e-5)
    np.testing.assert_array_equal(small[0, :, :2], -1)
    assert inputs_of([image], 2).shape == (1, 4, 6)
    assert inputs_of([np.zeros((4, 4), np.float32)], 1).tolist() == [[[-1] * 4] * 4]
    mask = np.full((9, 12), 15, np.uint8)
    mask[:, 6:] = 3
    np.testing.assert_array_equal(np.unique(targets_of([mask], 3, 12)), [0, 3])
