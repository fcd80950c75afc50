"""`simnfnd evaluate` and its tuning: from a dataset folder to the files of the report."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import pytest
import torch

from simnfnd import command
from simnfnd.command import main
from simnfnd.evaluation.filters import REGISTRY, Baseline
from simnfnd.evaluation.judging import runner, tuning
from simnfnd.evaluation.judging.methods import Method, baselines_of, methods_of, networks_of
from simnfnd.evaluation.judging.pairs import items_of, pair_images
from simnfnd.evaluation.judging.runner import SECONDS, Measured
from simnfnd.evaluation.metrics import fidelity as metrics
from simnfnd.evaluation.metrics.fidelity import psnr
from simnfnd.evaluation.metrics.measure import fit_levels
from simnfnd.evaluation.report import build as builder
from simnfnd.evaluation.report import paper
from simnfnd.evaluation.report.compare import read_results
from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.common.workers.tasks import TaskPool
from simnfnd.models.data.pairs import hold_out, read_table
from simnfnd.models.denoise.denoiser import Denoiser
from simnfnd.models.networks import build_network
from simnfnd.models.networks.weights import save_weights
from tests.evaluation.evaluation_settings import (
    BROKEN,
    killed_by_median,
    measured,
    polar_folder,
    settings_for,
)
from tests.project_files import ROOT
from tests.small_dataset import write_dataset

FILES = {"report.html", "report.json", "report.md", "results.csv"}
METRICS = ("psnr", "ssim", "gmsd", "psnr_fan", "shadow_iou", "shadow_residual")
MEDIAN = Method("median", "", {"size": 3})
GAUSSIAN = Method("gaussian", "", {"sigma_px": 1.0})


def assert_same(first: Measured, second: Measured) -> None:
    columns = ["method", "picture", *METRICS]
    assert first.table()[columns].equals(second.table()[columns])


def tune(dataset: Path, file: Path, *names: str, **changes: Any) -> list[str]:
    """The lines of `evaluation tune` for these baselines."""
    tuning_keys = {"file": str(file), **changes.pop("tuning", {})}
    settings = settings_for(dataset, tuning=tuning_keys, **changes)
    with TaskPool(settings.workers) as pool:
        return tuning.tune(settings, baselines_of(names), pool)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two variants a frame, four train scenes of four frames."""
    return write_dataset(tmp_path_factory.mktemp("data"), train=32, test=6, size=48, noise=0.15)


@pytest.mark.slow
def test_one_command_writes_the_whole_report(
    dataset: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    out = tmp_path / "report"
    words = (f"dataset={dataset}", f"out={out}", "baselines=[median]", "tuning.pairs=2",
             "workers=1", f"tuning.file={tmp_path / 'tuned.json'}")  # fmt: skip
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["evaluation"])
    assert main(["evaluate", *words]) == 0
    assert "+ levels (size=" in capsys.readouterr().out, "the best form of the median"
    assert {path.name for path in out.iterdir()} == FILES
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"report", "tuned.json"}, "Hydra left litter"

    # The figures are those of the images in the shards, taken one by one.
    expected = []
    for path in sorted((dataset / "test").glob("*.h5")):
        with h5py.File(path) as file:
            expected += [
                metrics.psnr(clean, noisy, data_range=255)
                for clean, noisy in zip(file["clean"], file["noisy"], strict=True)
            ]
    results = read_results(out)
    noisy = results["method"] == "noisy"
    assert results["psnr"][noisy].to_numpy() == pytest.approx(expected, rel=1e-6)
    content = json.loads((out / "report.json").read_text(encoding="utf-8"))
    (network,) = [row for row in content["rows"] if row["kind"] == "network"]
    assert network["name"].removesuffix("-paper") == "simnfnd", "the one that ships"
    assert network["lost"] is None
    forms = {f"median{form}" for form in ("", " + levels", " tuned", " tuned + levels")}
    assert set(results["method"]) == {"noisy", network["label"], *forms}
    row = next(row for row in content["rows"] if row["label"] == "noisy")
    psnr = row["metrics"]["psnr"]
    assert psnr["mean"] == pytest.approx(np.mean(expected))
    assert psnr["low"] < psnr["mean"] < psnr["high"]
    assert (content["facts"]["pairs"], content["facts"]["frames"]) == (6, 3)
    assert content["best_classical"]["chosen_on"] == "validation pairs"
    levels = next(row for row in content["rows"] if row["label"] == "median + levels")
    assert levels["against_noisy"]["psnr"]["low"] > 0, "the haze is an offset"

    # A card takes figures from the report.
    weights = tmp_path / "own.safetensors"
    card_words = [network["name"], "--out", str(weights), "--figures", str(out / "report.json")]
    assert main(["export-weights", *card_words]) == 0
    assert f"| noisy | {psnr['mean']:.2f} |" in weights.with_suffix(".md").read_text("utf-8")
    markdown = (out / "report.md").read_text(encoding="utf-8")
    assert "| Median | 17.76 / 0.690 / 0.190 |" in markdown
    # One row a method, its other forms below.
    first, _, more = markdown.partition("## All 6 forms")
    assert first.count("| median") == 1
    assert more.partition("##")[0].count("| median") == 4


@pytest.mark.slow
def test_processes_do_not_change_the_figures(tmp_path: Path) -> None:
    dataset = write_dataset(tmp_path / "data", train=6, test=6, size=48, per_shard=5)
    alone, together = (measured(dataset, [MEDIAN], split="all", workers=n) for n in (1, 2))
    assert_same(alone, together)
    items = items_of(dataset, "all")
    assert len(items) == 12
    assert items[0].shard == "train/shard-00000.h5"
    assert items_of(dataset, "all", 5) == items[:5]
    for workers in (1, 2):
        tune(dataset, tmp_path / f"{workers}.json", "median", workers=workers)
    assert (tmp_path / "1.json").read_bytes() == (tmp_path / "2.json").read_bytes()


@pytest.mark.slow
def test_a_killed_worker_costs_the_row_of_its_method_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    dataset = write_dataset(tmp_path / "data", train=0, test=2, size=48)
    monkeypatch.setattr(runner, "measure_task", killed_by_median)
    actual = measured(dataset, [MEDIAN, GAUSSIAN], workers=2)
    assert set(actual.lost) == {"median"}
    assert "SIGKILL" in actual.lost["median"]
    monkeypatch.undo()
    assert_same(actual, measured(dataset, [GAUSSIAN]))
    assert not measured(dataset, [MEDIAN]).lost, "the next run tries again"


def test_somebodys_denoised_images_are_a_row(tmp_path: Path) -> None:
    """By the names of `export --to png`, PNG or .npy; equal images give equal figures."""
    dataset = write_dataset(tmp_path / "data", train=2, test=5, size=48, per_shard=3)
    items = items_of(dataset, "test")
    mine = tmp_path / "mine"
    arrays = tmp_path / "arrays"
    for folder in (mine / "test" / "noisy", arrays):
        folder.mkdir(parents=True)
    for number, item in enumerate(items):
        noisy = np.rint(pair_images(item.place).noisy * 255).astype(np.uint8)
        cv2.imwrite(str(mine / "test" / "noisy" / f"{number:06d}.png"), cv2.medianBlur(noisy, 3))
        np.save(arrays / f"{number:06d}.npy", noisy / 255)
    folders = [{"name": "mine", "dir": str(mine)}, {"name": "arrays", "dir": str(arrays)}]
    content = builder.build(settings_for(dataset, pictures=folders))
    rows_ = {row["label"]: row for row in content["rows"]}
    assert rows_["mine"]["kind"] == "pictures"
    assert rows_["mine"]["cpu_s"] is None
    for name in ("psnr", "ssim", "gmsd"):
        assert rows_["mine"]["metrics"][name] == rows_["median"]["metrics"][name]
        assert rows_["arrays"]["metrics"][name] == rows_["noisy"]["metrics"][name]
    assert "psnr" in rows_["mine"]["against_best"]
    np.save(arrays / "000002.npy", np.zeros((48, 40)))
    lost = builder.build(settings_for(dataset, pictures=folders[1:]))["rows"][-1]["lost"]
    assert "test/noisy/000002: 40x48 pixels, but what is judged has 48x48" in lost
    again = settings_for(dataset, pictures=[{"name": "median", "dir": str(mine)}])
    with pytest.raises(FactoryError, match="pictures: median"):
        builder.build(again)
    (mine / "test" / "noisy" / "000001.png").unlink()
    with pytest.raises(FactoryError, match=r"1 of 5 .*test/noisy"):
        builder.build(settings_for(dataset, pictures=folders))


def test_validation_is_what_training_holds_out(dataset: Path) -> None:
    items = tuning.validation_items(settings_for(dataset, tuning={"pairs": 99}))
    remaining, held = hold_out(read_table(dataset, "train").samples, 0.3, 0)
    assert {item.place for item in items} == {(str(s.path), s.row) for s in held}
    assert not {item.scene for item in items} & {sample.scene.split("/")[1] for sample in remaining}
    assert all(item.shard.startswith("train/") for item in items)
    assert len(tuning.validation_items(settings_for(dataset))) == 3


def test_tuning_finds_the_best_of_the_grid(dataset: Path, tmp_path: Path) -> None:
    file = tmp_path / "deep" / "tuned.json"
    lines = tune(dataset, file, "gaussian", "identity")
    content = json.loads(file.read_text(encoding="utf-8"))
    assert set(content["baselines"]) == {"identity", "gaussian"}
    items = tuning.validation_items(settings_for(dataset))
    assert content["validation"] == [f"{item.shard}#{item.place[1]}" for item in items]

    # By hand: every sigma on every pair.
    baseline = REGISTRY["gaussian"]
    plain = {}
    corrected = {}
    for point in baseline.points():
        images = [pair_images(item.place) for item in items]
        pairs = [(baseline(pair.noisy, point), pair.clean) for pair in images]
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


def test_the_tune_command_never_opens_the_test_split(
    dataset: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    dataset = Path(shutil.copytree(dataset, tmp_path / "data"))
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
    for name in ("report.md", "report.html"):
        text = (tmp_path / "out" / name).read_text(encoding="utf-8")
        assert "lost: ZeroDivisionError: no such luck" in text


def test_rows_are_what_the_methods_give(dataset: Path, tmp_path: Path) -> None:
    file = tmp_path / "t.json"
    names = ("median", "identity")
    tune(dataset, file, *names)
    methods = methods_of(baselines_of(names), tuning.load_tuned(file))
    forms = ["", " + levels", " tuned", " tuned + levels"]
    labels = ["noisy", *(f"median{form}" for form in forms), "noisy + levels"]
    assert [method.label for method in methods] == labels
    actual = measured(dataset, methods).wide()
    # One pair by hand.
    number = 4
    label = "median tuned + levels"
    pair = pair_images(items_of(dataset, "test")[number].place)
    method = methods[labels.index(label)]
    assert method.levels is not None
    image = method.levels(REGISTRY["median"](pair.noisy, method.parameters))
    expected = {
        "psnr": psnr(pair.clean, image, data_range=1.0),
        "psnr_fan": psnr(pair.clean, image, data_range=1.0, mask=pair.sector),
    }
    assert {n: actual[n][label][number] for n in expected} == pytest.approx(expected)
    assert (actual["psnr"][label] > actual["psnr"]["noisy"]).all(), "taking the haze off must help"
    assert actual["ms_ssim"].isna().all(axis=None), "48 pixels are too few for five scales"
    assert actual["ratio_mean"]["noisy"].to_numpy() == pytest.approx(1)
    assert np.isfinite(actual["edge_preservation"][label]).all()


def test_bad_settings_are_one_line(
    dataset: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").touch()
    for arguments, words in (
        (("tune",), "dataset: give the folder"),
        (("dataset=nowhere",), "no such folder"),
        (("dataset=nowhere", "speed=1"), "speed: no such key; did you mean seed?"),
        (("dataset=nowhere", "split=valid"), "split: Input should be 'train', 'test' or 'all'"),
        (("baselines=[wiener]", "dataset=."), "baselines: no 'wiener'"),
        (("models=[nothing]", "dataset=."), "models: weights=nothing: no such file"),
        (("tune", "dataset=.", "tuning.pairs=0"), "tuning.pairs: "),
        ((f"dataset={dataset}", "out=file/x", "models=[]", "baselines=[]"), "out: cannot write"),
    ):
        monkeypatch.setattr(sys, "argv", ["evaluation"])
        assert main(["evaluate", *arguments]) == 2
        error = capsys.readouterr().err
        assert words in error
        assert error.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_bad_files_are_named(dataset: Path, tmp_path: Path) -> None:
    file = tmp_path / "t.json"
    for text in ("{", '{"schema": "other"}', '{"schema": "simnfnd-tuned/1"}'):
        file.write_text(text, encoding="utf-8")
        with pytest.raises(FactoryError, match=r"tuning\.file="):
            tuning.load_tuned(file)
    (tmp_path / "taken").write_text("", encoding="utf-8")
    with pytest.raises(FactoryError, match=r"tuning\.file: .*taken"):
        tune(dataset, tmp_path / "taken" / "t.json", "identity")


def test_the_leaderboard_does_not_import_torch() -> None:
    """It runs where torch is not installed."""
    code = "import sys, simnfnd.evaluation.report.build; print('torch' in sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "False"


def weights(path: Path, seed: int) -> Path:
    """The weights of a small untrained network."""
    config = {"kind": "nafnet", "width": 4, "encoder": [1], "middle": 1, "decoder": [1]}
    torch.manual_seed(seed)
    network = build_network(config)
    for parameter in network.parameters():
        torch.nn.init.normal_(parameter, std=0.05)
    path.parent.mkdir(parents=True, exist_ok=True)
    save_weights(path, network, config, {})
    return path


def test_networks_are_rows_with_their_costs(dataset: Path, tmp_path: Path) -> None:
    first = weights(tmp_path / "small" / "weights.safetensors", 1)
    second = weights(tmp_path / "other.safetensors", 2)
    ablation = {"olddata_l1": None, "simnfnd_l1": str(second), "simnfnd_newloss": None}
    settings = settings_for(dataset, models=[str(first.parent)], ablation=ablation)
    methods = networks_of(settings)
    assert [(method.label, method.ablation) for method in methods] == [
        ("small", ""),
        ("other", "simnfnd_l1"),
    ]
    actual = measured(dataset, methods)
    psnr_db = actual.wide()["psnr"]
    pair = pair_images(items_of(dataset, "test")[1].place)
    expected = psnr(pair.clean, Denoiser(first)(pair.noisy).clip(0, 1), data_range=1.0)
    assert psnr_db["small"][1] == pytest.approx(expected, abs=1e-6)
    assert psnr_db["small"][1] != psnr_db["other"][1]
    assert (actual.wide()[SECONDS]["small"] > 0).all()


def test_paths_without_weights_are_named(dataset: Path, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    for path, words in (
        ("empty", "models: weights=.*no such"),
        ("none", "models: weights=.*no such"),
    ):
        with pytest.raises(FactoryError, match=words):
            networks_of(settings_for(tmp_path / "data", models=[str(tmp_path / path)]))
    (tmp_path / "bad.safetensors").write_bytes(b"no weights")
    settings = settings_for(dataset, limit=2, models=[str(tmp_path / "bad.safetensors")])
    actual = measured(dataset, networks_of(settings))
    assert "not a safetensors file" in actual.lost["bad"], "it loses its row"


@pytest.mark.slow
def test_one_command_gives_both_tables_and_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    ran: list[str] = []

    def run_quickly(words: list[str]) -> int:
        """The same words in this process, on images as small as a crop."""
        ran.append(words[0])
        small = {
            "make": ["sonar.image.width_px=72", "sonar.image.height_px=72", "scheduler=serial"],
            "train": ["model=nafnet", "model.width=4", "device=cpu"],
            "evaluate": ["workers=1", "bootstrap=100"],
        }
        if "model=sid_tgan" in words:
            small["train"] = ["model.width=4", "model.blocks=1", "device=cpu"]
        monkeypatch.setattr(sys, "argv", ["simnfnd"])
        return command.main([*words, *small[words[0]]])

    monkeypatch.setattr(paper, "run", lambda words: 0 if words[0] != "train" else 3)
    out = tmp_path / "out"
    real = polar_folder(tmp_path / "real", 1, 4)
    words = ["--quick", "--real", str(real), "--frames", "8", "--steps", "2", "--out", str(out)]
    assert paper.main(words) == 3
    said = capsys.readouterr()
    assert said.out.startswith("Quick mode, no reproduction: 16 pairs of 8 frames at most")
    assert "the same command goes on from here" in said.err
    monkeypatch.setattr(paper, "run", run_quickly)
    assert paper.main(words) == 0
    assert ran == ["make", *["train"] * 4, "evaluate", "evaluate"]
    text = (out / "tables.md").read_text(encoding="utf-8")
    assert "Quick mode, no reproduction" in text
    assert "| row | paper PSNR / SSIM / GMSD | ours (quick) | which row here |" in text
    for row in ("OldData + L1loss", "SimNFND + L1loss", "SimNFND + Newloss"):
        (line,) = [line for line in text.splitlines() if line.startswith(f"| {row} ")]
        assert line.count(" / ") == 4, "the paper's and ours"
    assert "| Median | 17.76 / 0.690 / 0.190 |" in text
    figure = text.split("## Figure 14")[1]
    for row in ("LPMsDE, after the abstract", "SID-TGAN, after the abstract", "SimNFND + NewLoss"):
        assert f"| {row} |" in figure
    assert (out / "figure14" / "real.html").is_file()
    # What is done is not done again.
    remaining = (out / "simnfnd_l1" / "weights.safetensors").stat().st_mtime_ns
    monkeypatch.setattr(paper, "run", lambda w: run_quickly(w) if "name=simnfnd_l1" in w else 0)
    assert paper.main(words) == 0
    assert (out / "simnfnd_l1" / "weights.safetensors").stat().st_mtime_ns == remaining
