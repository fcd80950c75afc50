"""Tuning on validation pairs and the leaderboard, from a dataset folder to the files."""

from __future__ import annotations

import csv
import json
import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from evaluation import leaderboard, leaderboard_files, measure, tuning
from evaluation.baselines import REGISTRY
from evaluation.baselines.base import Baseline
from evaluation.levels import fit_levels
from evaluation.metrics import psnr
from evaluation.pictures import input_of, items_of, picture
from evaluation.statistics import estimate
from evaluation.tuning import BaselineSettings
from factory.errors import FactoryError
from factory.sample import Pair
from factory.settings import build
from tests.small_dataset import add_shard, fan_images, write_dataset
from tests.test_evaluation import ROOT, evaluation, settings_for


def own_settings(file: Path, *names: str, **changes: Any) -> BaselineSettings:
    values = {
        "baselines": list(names),
        "texture": False,
        "tuning": {"file": str(file), "validation": 0.3, "pairs": 3},
    }
    return build(BaselineSettings, {**values, **changes})


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two variants a frame, four train scenes of four frames; `limit` keeps the tests short."""
    return write_dataset(tmp_path_factory.mktemp("data"), train=32, test=6, size=48, noise=0.15)


def test_validation_is_what_training_holds_out(dataset: Path) -> None:
    from models.data import hold_out, read_table

    own = own_settings(Path("unused"), tuning={"file": None, "validation": 0.3, "pairs": 99})
    items = tuning.validation_items(settings_for(dataset), own.tuning)
    kept, held = hold_out(read_table(dataset, "train").samples, 0.3, 0)
    assert {item.place for item in items} == {(str(s.path), s.row) for s in held}
    assert not {item.scene for item in items} & {sample.scene.split("/")[1] for sample in kept}
    assert all(item.shard.startswith("train/") for item in items)
    few = tuning.validation_items(settings_for(dataset), own_settings(Path("x")).tuning)
    assert len(few) == 3


def test_tuning_finds_the_best_of_the_grid(dataset: Path, tmp_path: Path) -> None:
    file = tmp_path / "deep" / "tuned.json"
    own = own_settings(file, "gaussian", "identity")
    lines = tuning.tune(settings_for(dataset), own)
    content = json.loads(file.read_text(encoding="utf-8"))
    assert set(content["baselines"]) == {"identity", "gaussian"}
    items = tuning.validation_items(settings_for(dataset), own.tuning)
    assert content["validation"] == [f"{item.shard}#{item.place[1]}" for item in items]

    # By hand: every sigma on every pair.
    baseline, plain, corrected = REGISTRY["gaussian"], {}, {}
    for point in baseline.points():
        pairs = [
            (baseline(input_of(item, False), point), picture(item.place).clean) for item in items
        ]
        levels = fit_levels(pairs)
        key = float(point["sigma_px"])
        plain[key] = np.mean([psnr(c, i, data_range=1.0) for i, c in pairs])
        corrected[key] = np.mean([psnr(c, levels(i), data_range=1.0) for i, c in pairs])
    entry = content["baselines"]["gaussian"]
    assert entry["tuned"]["psnr"] == pytest.approx(max(plain.values()))
    assert entry["tuned"]["parameters"]["sigma_px"] == max(plain, key=lambda key: plain[key])
    assert entry["tuned_levels"]["psnr_levels"] == pytest.approx(max(corrected.values()))
    assert entry["default"]["psnr"] == pytest.approx(plain[1.0])
    assert corrected[1.0] > plain[1.0] + 1, "the haze of the test images is an offset"
    assert any(line.startswith("gaussian: ") and "tuned (sigma_px=" in line for line in lines)


def test_tuned_results_are_kept_until_something_changes(
    dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "tuned.json"
    tuning.tune(settings_for(dataset), own_settings(file, "median"))
    before = file.read_bytes()
    measured: list[tuning._Task] = []
    honest = tuning._measure_point

    def counted(task: Any) -> Any:
        measured.append(task)
        return honest(task)

    monkeypatch.setattr(tuning, "_measure_point", counted)
    again = tuning.tune(settings_for(dataset), own_settings(file, "median"))
    assert not measured
    assert again[0].startswith("median: ")
    tuning.tune(settings_for(dataset), own_settings(file, "grey_opening"))
    assert {task.baseline for task in measured} == {"grey_opening"}
    measured.clear()
    # Another grid, other pairs: another result.
    median = REGISTRY["median"]
    finer = Baseline("median", median.function, median.default, {"size": (3, 5)}, "here")
    monkeypatch.setitem(REGISTRY, "median", finer)
    tuning.tune(settings_for(dataset), own_settings(file, "median"))
    assert len(measured) == 2
    monkeypatch.undo()
    tuning.tune(settings_for(dataset), own_settings(file, "median", "grey_opening"))
    content = json.loads(file.read_text(encoding="utf-8"))["baselines"]
    assert content["median"] == json.loads(before)["baselines"]["median"], "same bytes again"


def test_tuning_never_opens_the_test_split(tmp_path: Path) -> None:
    dataset = write_dataset(tmp_path / "data", train=16, test=4, size=48)
    for path in (dataset / "test").glob("*.h5"):
        path.write_bytes(b"nothing to read here")
    tuning.tune(settings_for(dataset), own_settings(tmp_path / "t.json", "median"))


def test_an_optimum_at_the_edge_is_said(
    dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gaussian = REGISTRY["gaussian"]
    narrow = Baseline("gaussian", gaussian.function, gaussian.default, {"sigma_px": (0.3, 0.4)}, "")
    monkeypatch.setitem(REGISTRY, "gaussian", narrow)
    lines = tuning.tune(settings_for(dataset), own_settings(tmp_path / "t.json", "gaussian"))
    assert "warning: the optimum is at the edge of the grid in sigma_px" in lines[0]


def break_a_method(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(image: Any) -> Any:
        if image.mean() > 0:
            raise ZeroDivisionError("no such\nluck")
        return image

    monkeypatch.setitem(REGISTRY, "broken", Baseline("broken", broken, {}, {}, "here"))


def test_a_method_that_crashes_loses_its_row_alone(
    dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    break_a_method(monkeypatch)
    own = own_settings(tmp_path / "t.json", "broken", "median")
    lines = tuning.tune(settings_for(dataset), own)
    assert lines[0] == "broken: lost (ZeroDivisionError: no such luck)"
    assert lines[1].startswith("median: ")
    methods, untuned = leaderboard.methods_of(settings_for(dataset), own)
    assert untuned == ["broken"]
    items, rows = leaderboard.leaderboard(settings_for(dataset), methods, texture=False)
    by_label = {row.method.label: row for row in rows}
    assert by_label["broken"].lost == "ZeroDivisionError: no such luck"
    assert by_label["median"].lost is None
    (tmp_path / "summary.md").write_text("# Report\n", encoding="utf-8")
    leaderboard_files.write(tmp_path, items, rows)
    text = (tmp_path / "summary.md").read_text(encoding="utf-8")
    assert text.startswith("# Report\n")
    assert "| broken | lost: ZeroDivisionError: no such luck |" in text
    with (tmp_path / "leaderboard.csv").open(encoding="utf-8") as file:
        table = list(csv.DictReader(file))
    assert table[-1]["method"] == "broken"
    assert table[-1]["psnr"] in ("", None)


def test_rows_are_what_the_methods_give(dataset: Path, tmp_path: Path) -> None:
    own = own_settings(tmp_path / "t.json", "median", "recursive", "identity")
    settings = settings_for(dataset)
    tuning.tune(settings, own)
    methods, untuned = leaderboard.methods_of(settings, own)
    assert untuned == []
    forms = ["", " + levels", " tuned", " tuned + levels"]
    assert [m.label for m in methods] == [
        *(f"median{form}" for form in forms),
        *(f"recursive{form}" for form in forms),
        "identity",
        "identity + levels",
    ]
    items, rows = leaderboard.leaderboard(settings, methods, texture=True)
    by_label = {row.method.label: row for row in rows}
    assert rows[0].method.label == "identity"
    # The noisy row is the one of the table above it.
    origin = measure.measure(settings)
    for name in measure.METRICS:
        np.testing.assert_allclose(
            rows[0].values[name], [getattr(s.quality, name) for s in origin], rtol=1e-5
        )
    # One pair by hand.
    number = 4
    pair, row = picture(items[number].place), by_label["median tuned + levels"]
    assert row.method.levels is not None
    image = row.method.levels(REGISTRY["median"](pair.noisy, row.method.parameters))
    assert row.values["psnr"][number] == pytest.approx(psnr(pair.clean, image, data_range=1.0))
    fan = psnr(pair.clean, image, data_range=1.0, mask=pair.sector)
    assert row.values["psnr_fan"][number] == pytest.approx(fan)
    gains = row.values["psnr"] - rows[0].values["psnr"]
    groups = [item.group for item in items]
    assert row.gains["psnr"] == estimate(gains, groups, resamples=200, seed=0)
    assert row.gains["psnr"].low > 0, "taking the haze off must help"
    assert rows[0].means["ms_ssim"].count == 0, "48 pixels are too few for five scales"
    assert rows[0].means["ratio_mean"].mean == pytest.approx(1)
    assert row.means["edge_preservation"].count == len(items)
    assert "| edges |" in leaderboard_files.texture_table(rows)


def test_processes_do_not_change_the_figures(dataset: Path, tmp_path: Path) -> None:
    own = own_settings(tmp_path / "t.json", "median", "lee")
    methods, _ = leaderboard.methods_of(settings_for(dataset), own)
    alone, together = (
        leaderboard.leaderboard(settings_for(dataset, workers=n), methods, texture=False)[1]
        for n in (1, 2)
    )
    for one, other in zip(alone, together, strict=True):
        assert one.means == other.means
    # Tuned in two processes, the file has the same bytes.
    for workers in (1, 2):
        own = own_settings(tmp_path / f"{workers}.json", "median", "grey_opening")
        tuning.tune(settings_for(dataset, workers=workers), own)
    assert (tmp_path / "1.json").read_bytes() == (tmp_path / "2.json").read_bytes()


def test_several_looks_beat_one(tmp_path: Path) -> None:
    """Four variants of two frames, each with noise of its own over one clean image."""
    rng = np.random.default_rng(0)
    for split, scenes in (("train", 2), ("test", 1)):
        pairs = []
        for scene in range(scenes):
            _, clean, shadow = fan_images(48, rng)
            for variant in range(4):
                noisy = np.clip(clean * rng.gamma(6, 1 / 6, clean.shape), 0, 1)
                record: dict[str, float | int | str] = {
                    "location": "here",
                    "scene": f"{split}-{scene}",
                    "frame": "0",
                    "variant": variant,
                }
                pairs.append(Pair(noisy.astype(np.float32), clean, shadow, record))
        add_shard(tmp_path, f"{split}/shard-00000.h5", pairs)
    own = own_settings(tmp_path / "t.json", "recursive")
    settings = settings_for(tmp_path)
    tuning.tune(settings, own)
    methods, _ = leaderboard.methods_of(settings, own)
    items, rows = leaderboard.leaderboard(settings, methods, texture=False)
    by_label = {row.method.label: row for row in rows}
    assert by_label["recursive tuned"].method.parameters == {"memory": 1.0}, "nothing moves"
    gains = by_label["recursive tuned"].values["psnr"] - rows[0].values["psnr"]
    # Four looks have a quarter of the variance: 6 dB, less what the logarithm's mean is off.
    assert 4 < gains.mean() < 6.1
    assert [item.looks[-1] for item in items] == [item.place for item in items]


def test_several_looks_need_several_variants(tmp_path: Path) -> None:
    dataset = write_dataset(tmp_path / "data", train=16, test=3, size=48)
    assert [len(item.looks) for item in items_of(dataset, "test")] == [2, 2, 1]
    assert all(item.looks[-1] == item.place for item in items_of(dataset, "test"))
    own = own_settings(tmp_path / "t.json", "recursive")
    methods, _ = leaderboard.methods_of(settings_for(dataset), own)
    _, rows = leaderboard.leaderboard(settings_for(dataset), methods, texture=False)
    assert rows[1].lost == "needs several noise variants a frame"
    assert math.isnan(rows[1].milliseconds)


def test_commands(dataset: Path, tmp_path: Path) -> None:
    own: tuple[str, ...] = ("baselines=[median,gaussian]", f"tuning.file={tmp_path / 't.json'}")
    own += ("tuning.pairs=2", "workers=1")
    tuned = evaluation("tune", f"dataset={dataset}", *own, cwd=tmp_path)
    assert tuned.returncode == 0, tuned.stderr
    assert "gaussian: " in tuned.stdout
    done = evaluation(f"dataset={dataset}", f"out={tmp_path / 'out'}", *own, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "| median tuned + levels (size=" in done.stdout
    assert "17.76 / 0.69 / 0.19" in done.stdout
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"baselines.csv", "leaderboard.csv", "metrics.csv", "summary.md"} <= names
    with (tmp_path / "out" / "baselines.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 9 * 6
    assert {path.name for path in tmp_path.iterdir()} == {"t.json", "out"}, "Hydra left litter"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("tune",), "dataset: give the folder"),
        (("baselines=[wiener]",), "baselines: no 'wiener'"),
        (("tune", "tuning.pairs=0"), "tuning.pairs: "),
        (("tune", "tuning.speed=1"), "Could not override 'tuning.speed'"),
    ],
)
def test_bad_input_is_one_line(arguments: tuple[str, ...], words: str, tmp_path: Path) -> None:
    folder = () if "give the folder" in words else ("dataset=nowhere",)
    done: subprocess.CompletedProcess[str] = evaluation(*arguments, *folder, cwd=tmp_path)
    assert done.returncode == 2
    assert words in done.stderr
    assert done.stderr.count("\n") == 1


def test_bad_files_are_named(dataset: Path, tmp_path: Path) -> None:
    file = tmp_path / "t.json"
    for text in ("{", "[]", '{"schema": "other"}', '{"schema": "simnfnd-tuned/1"}'):
        file.write_text(text, encoding="utf-8")
        with pytest.raises(FactoryError, match=r"tuning\.file=.*not a file that"):
            tuning.load_tuned(file)
    (tmp_path / "taken").write_text("", encoding="utf-8")
    with pytest.raises(FactoryError, match=r"tuning\.file: cannot write.*taken"):
        tuning.tune(settings_for(dataset), own_settings(tmp_path / "taken" / "t.json", "identity"))
    with pytest.raises(FactoryError, match=r"out=.*cannot write"):
        leaderboard_files.write(tmp_path / "taken" / "x", [], [])


def test_damage_is_not_blamed_on_a_method(tmp_path: Path) -> None:
    dataset = write_dataset(tmp_path / "data", train=0, test=2, size=48, dtype="float32")
    with h5py.File(dataset / "test" / "shard-00000.h5", "r+") as file:
        file["noisy"][1, 5, 5] = np.nan
    own = own_settings(tmp_path / "t.json", "median")
    methods, _ = leaderboard.methods_of(settings_for(dataset), own)
    with pytest.raises(FactoryError, match=r"shard-00000\.h5: sample 1: noisy has NaN"):
        leaderboard.leaderboard(settings_for(dataset), methods, texture=False)


def test_help_does_not_import_torch() -> None:
    """The leaderboard itself runs where torch is not installed."""
    code = "import sys, evaluation.leaderboard; print('torch' in sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "False"
