"""Tuning on validation pairs and the leaderboard, from a dataset folder to the files."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from simnfnd.command import main
from simnfnd.evaluation import tuning
from simnfnd.evaluation.filters import REGISTRY, Baseline
from simnfnd.evaluation.methods import baselines_of, methods_of
from simnfnd.evaluation.metrics.fidelity import gmsd, psnr
from simnfnd.evaluation.metrics.measure import fit_levels
from simnfnd.evaluation.pairs import items_of, picture
from simnfnd.evaluation.report import build as builder
from simnfnd.factory.errors import FactoryError
from simnfnd.factory.scheduler.workers.tasks import TaskPool
from tests.evaluation.evaluation_settings import measured, settings_for
from tests.evaluation.filters.scenes import BROKEN
from tests.project_files import ROOT
from tests.small_dataset import write_dataset


def tune(dataset: Path, file: Path, *names: str, **changes: Any) -> list[str]:
    """The lines of `evaluation tune` for these baselines."""
    tuning_keys = {"file": str(file), **changes.pop("tuning", {})}
    settings = settings_for(dataset, tuning=tuning_keys, **changes)
    with TaskPool(settings.workers) as pool:
        return tuning.tune(settings, baselines_of(names), pool)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two variants a frame, four train scenes of four frames; `limit` keeps the tests short."""
    return write_dataset(tmp_path_factory.mktemp("data"), train=32, test=6, size=48, noise=0.15)


def test_validation_is_what_training_holds_out(dataset: Path) -> None:
    from simnfnd.models.data.pairs import hold_out, read_table

    items = tuning.validation_items(settings_for(dataset, tuning={"pairs": 99}))
    kept, held = hold_out(read_table(dataset, "train").samples, 0.3, 0)
    assert {item.place for item in items} == {(str(s.path), s.row) for s in held}
    assert not {item.scene for item in items} & {sample.scene.split("/")[1] for sample in kept}
    assert all(item.shard.startswith("train/") for item in items)
    few = tuning.validation_items(settings_for(dataset))
    assert len(few) == 3


def test_tuning_finds_the_best_of_the_grid_or_better(dataset: Path, tmp_path: Path) -> None:
    file = tmp_path / "deep" / "tuned.json"
    lines = tune(dataset, file, "gaussian", "identity")
    content = json.loads(file.read_text(encoding="utf-8"))
    assert set(content["baselines"]) == {"identity", "gaussian"}
    items = tuning.validation_items(settings_for(dataset))
    assert content["validation"] == [f"{item.shard}#{item.place[1]}" for item in items]

    # By hand: every sigma on every pair.
    baseline, plain, corrected = REGISTRY["gaussian"], {}, {}
    for point in baseline.points():
        pictures = [picture(item.place) for item in items]
        pairs = [(baseline(pair.noisy, point), pair.clean) for pair in pictures]
        levels = fit_levels(pairs)
        key = float(point["sigma_px"])
        plain[key] = np.mean([psnr(c, i, data_range=1.0) for i, c in pairs])
        corrected[key] = np.mean([psnr(c, levels(i), data_range=1.0) for i, c in pairs])
    entry = content["baselines"]["gaussian"]
    best = max(plain, key=lambda key: plain[key])
    assert max(plain.values()) - 1e-9 < entry["tuned"]["psnr"] < max(plain.values()) + 0.5
    assert entry["tuned"]["parameters"]["sigma_px"] == pytest.approx(best, rel=0.25)
    assert entry["tuned_levels"]["psnr_levels"] > max(corrected.values()) - 1e-9
    assert entry["default"]["psnr"] == pytest.approx(plain[1.0])
    assert corrected[1.0] > plain[1.0] + 1, "the haze of the test images is an offset"
    assert any(line.startswith("gaussian: ") and "tuned (sigma_px=" in line for line in lines)


def test_tuned_results_are_kept_until_something_changes(
    dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "tuned.json"
    tune(dataset, file, "median")
    before = file.read_bytes()
    ran: list[str] = []
    honest = tuning.on_pairs

    def counted(task: Any) -> Any:
        ran.append(task.baseline)
        return honest(task)

    monkeypatch.setattr(tuning, "on_pairs", counted)
    again = tune(dataset, file, "median")
    assert not ran
    assert again[0].startswith("median: ")
    tune(dataset, file, "grey_opening")
    assert ran == ["grey_opening"]
    # Another grid, other pairs: another result.
    median = REGISTRY["median"]
    finer = Baseline("median", median.function, median.default, {"size": (3, 5)}, "here")
    monkeypatch.setitem(REGISTRY, "median", finer)
    tune(dataset, file, "median")
    assert ran == ["grey_opening", "median"]
    monkeypatch.undo()
    tune(dataset, file, "median", "grey_opening")
    content = json.loads(file.read_text(encoding="utf-8"))["baselines"]
    assert content["median"] == json.loads(before)["baselines"]["median"], "same bytes again"


def test_the_tune_command_never_opens_the_test_split(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    dataset = write_dataset(tmp_path / "data", train=16, test=4, size=48)
    for path in (dataset / "test").glob("*.h5"):
        path.write_bytes(b"nothing to read here")
    words = (f"dataset={dataset}", "baselines=[median]", f"tuning.file={tmp_path / 't.json'}")
    monkeypatch.setattr(sys, "argv", ["evaluation"])
    assert main(["evaluate", "tune", *words, "tuning.pairs=2", "workers=1"]) == 0
    assert "median: " in capsys.readouterr().out
    assert (tmp_path / "t.json").is_file()


def test_a_method_that_crashes_loses_its_row_alone(
    dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(REGISTRY, "broken", BROKEN)
    lines = tune(dataset, tmp_path / "t.json", "broken", "median")
    assert lines[0] == "broken: lost (ZeroDivisionError: no such luck)"
    assert lines[1].startswith("median: ")
    settings = settings_for(
        dataset,
        baselines=["broken", "median"],
        out=str(tmp_path / "out"),
        tuning={"file": str(tmp_path / "t.json")},
    )
    content = builder.build(settings)
    assert content["rows"][-1]["label"] == "broken"
    assert content["rows"][-1]["lost"] == "ZeroDivisionError: no such luck"
    assert {row["label"]: row["lost"] for row in content["rows"]}["median"] is None
    text = (tmp_path / "out" / "report.md").read_text(encoding="utf-8")
    assert "| broken | lost: ZeroDivisionError: no such luck |" in text
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "lost: ZeroDivisionError" in page


def test_rows_are_what_the_methods_give(dataset: Path, tmp_path: Path) -> None:
    file, names = tmp_path / "t.json", ("median", "identity")
    tune(dataset, file, *names)
    methods = methods_of(baselines_of(names), tuning.load_tuned(file))
    forms = ["", " + levels", " tuned", " tuned + levels"]
    labels = ["noisy", *(f"median{form}" for form in forms), "noisy + levels"]
    assert [method.label for method in methods] == labels
    found = measured(dataset, methods, tmp_path / "out").wide()
    # One pair by hand.
    number, label = 4, "median tuned + levels"
    pair = picture(items_of(dataset, "test")[number].place)
    method = methods[labels.index(label)]
    assert method.levels is not None
    image = method.levels(REGISTRY["median"](pair.noisy, method.parameters))
    expected = {
        "psnr": psnr(pair.clean, image, data_range=1.0),
        "psnr_fan": psnr(pair.clean, image, data_range=1.0, mask=pair.sector),
        "gmsd_unpooled": gmsd(pair.clean, image, data_range=1.0, pooled=False),
    }
    assert {n: found[n][label][number] for n in expected} == pytest.approx(expected)
    assert (found["psnr"][label] > found["psnr"]["noisy"]).all(), "taking the haze off must help"
    assert found["ms_ssim"].isna().all(axis=None), "48 pixels are too few for five scales"
    assert found["ratio_mean"]["noisy"].to_numpy() == pytest.approx(1)
    assert np.isfinite(found["edge_preservation"][label]).all()


def test_tuning_in_processes_writes_the_same_bytes(dataset: Path, tmp_path: Path) -> None:
    for workers in (1, 2):
        tune(dataset, tmp_path / f"{workers}.json", "median", "grey_opening", workers=workers)
    assert (tmp_path / "1.json").read_bytes() == (tmp_path / "2.json").read_bytes()


def test_bad_settings_are_one_line(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    for arguments, words in (
        (("tune",), "dataset: give the folder"),
        (("dataset=nowhere",), "no such folder"),
        (("dataset=nowhere", "speed=1"), "speed: no such key; did you mean seed?"),
        (("dataset=nowhere", "split=valid"), "split: Input should be 'train', 'test' or 'all'"),
        (("baselines=[wiener]", "dataset=."), "baselines: no 'wiener'"),
        (("models=[nothing]", "dataset=."), "models: weights=nothing: no such file"),
        (("tune", "dataset=.", "tuning.pairs=0"), "tuning.pairs: "),
    ):
        monkeypatch.setattr(sys, "argv", ["evaluation"])
        assert main(["evaluate", *arguments]) == 2
        error = capsys.readouterr().err
        assert words in error
        assert error.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_bad_files_are_named(dataset: Path, tmp_path: Path) -> None:
    file = tmp_path / "t.json"
    for text in ("{", "[]", '{"schema": "other"}', '{"schema": "simnfnd-tuned/1"}'):
        file.write_text(text, encoding="utf-8")
        with pytest.raises(FactoryError, match=r"tuning\.file=.*not a file that"):
            tuning.load_tuned(file)
    (tmp_path / "taken").write_text("", encoding="utf-8")
    with pytest.raises(FactoryError, match=r"tuning\.file: cannot write.*taken"):
        tune(dataset, tmp_path / "taken" / "t.json", "identity")


def test_the_leaderboard_does_not_import_torch() -> None:
    """It runs where torch is not installed."""
    code = "import sys, simnfnd.evaluation.report.build; print('torch' in sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "False"
