"""A small training: it learns, ends with the same bytes after a breakdown, and stops in time."""

from __future__ import annotations

import csv
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
import yaml

from simnfnd import PairDataset
from simnfnd.evaluation.metrics import fidelity as metrics
from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.common.files import sha256_of
from simnfnd.models import WEIGHTS_NAME
from simnfnd.models.data.crops import Crops, Visit
from simnfnd.models.networks import build_network
from simnfnd.models.networks.weights import load_weights, save_weights
from simnfnd.models.pretrained.card import recipe_digest
from simnfnd.models.training import loop as device
from simnfnd.models.training.checkpoints import read_checkpoint
from simnfnd.models.training.cost import read_cost
from simnfnd.models.training.loop import Stopped, TrainingLoop
from simnfnd.models.training.recipe import recipe_of
from simnfnd.models.training.train import train
from tests.models.training.small_training import SMALL, TINY, config_for, train_small
from tests.project_files import ROOT
from tests.small_dataset import write_dataset


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_dataset(tmp_path_factory.mktemp("data"), train=24, test=4, size=48)


@pytest.fixture(scope="module")
def trained(dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of an undisturbed small training."""
    out = tmp_path_factory.mktemp("models") / "undisturbed"
    train_small(dataset, out)
    return out


@pytest.mark.slow
def test_training_learns_to_denoise(trained: Path, dataset: Path) -> None:
    with (trained / "metrics.csv").open(encoding="utf-8") as file:
        rows = [{name: float(value) for name, value in row.items()} for row in csv.DictReader(file)]
    assert [row["step"] for row in rows] == [15, 30, 45]
    assert rows[-1]["loss"] < 0.7 * rows[0]["loss"]
    assert rows[-1]["gain_db"] > 3
    assert rows[-1]["ssim"] > rows[-1]["ssim_noisy"]
    names = {path.name for path in trained.iterdir()}
    assert names == {
        "checkpoint.ckpt",
        "config.yaml",
        "cost.json",
        "metrics.csv",
        "samples.png",
        "weights.safetensors",
    }
    # And on scenes that were neither trained nor validated on.
    network = load_weights(trained / "weights.safetensors").network
    for pair in PairDataset(dataset, "test", scaled=True):
        noisy = pair["noisy"]
        clean = pair["clean"]
        with torch.inference_mode():
            denoised = network(torch.from_numpy(noisy)[None, None])[0, 0].clamp(0, 1).numpy()
        before = metrics.psnr(clean, noisy, data_range=1)
        assert metrics.psnr(clean, denoised, data_range=1) > before + 2


def test_weights_describe_themselves(trained: Path, dataset: Path) -> None:
    loaded = load_weights(trained / "weights.safetensors")
    settings, _ = config_for(dataset, trained, *SMALL)
    assert recipe_digest(loaded.training) == recipe_digest(recipe_of(settings))
    cost = read_cost(trained)
    assert cost.cpu_s > 0
    assert cost.sittings == 1
    assert loaded.model["width"] == 8
    assert loaded.training["dataset.config_hash"] == "0123abcd"
    assert loaded.training["validation"]["step"] in (15, 30, 45)
    config = yaml.safe_load((trained / "config.yaml").read_text(encoding="utf-8"))
    assert config["train"]["steps"] == 45


@pytest.mark.slow
def test_same_seed_same_weights_and_a_breakdown_changes_nothing(
    trained: Path, dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Stopped in the middle of the second interval, training ends with the very same bytes."""
    step = TrainingLoop.update
    crop = Crops.__getitem__
    calls: list[int] = []
    drawn: list[int] = []

    def recorded(self: Crops, visit: Visit) -> Any:
        drawn.append(visit.number)
        return crop(self, visit)

    def breaks_down(self: TrainingLoop, *arguments: Any) -> Any:
        calls.append(self.step)
        if len(calls) == 22:
            raise OSError("the power went")
        return step(self, *arguments)

    with monkeypatch.context() as patch:
        patch.setattr(TrainingLoop, "update", breaks_down)
        with pytest.raises(OSError, match="power"):
            train_small(dataset, tmp_path)
    assert len((tmp_path / "metrics.csv").read_text(encoding="utf-8").splitlines()) == 2
    # What was not in the checkpoint is drawn again, and every interval draws something new.
    with monkeypatch.context() as patch:
        patch.setattr(Crops, "__getitem__", recorded)
        train_small(dataset, tmp_path)
    assert drawn == list(range(15 * 4, 45 * 4))
    for name in ("weights.safetensors", "metrics.csv", "samples.png"):
        assert (tmp_path / name).read_bytes() == (trained / name).read_bytes()


@pytest.mark.slow
def test_killed_training_continues(trained: Path, dataset: Path, tmp_path: Path) -> None:
    """SIGKILL to the real program right after a checkpoint, then the same command again."""
    command = [
        *(sys.executable, "-m", "simnfnd.models", f"dataset={dataset}", f"out={tmp_path}"),
        *SMALL,
    ]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)}
    process = subprocess.Popen(command, cwd=tmp_path, env=environment, stderr=subprocess.DEVNULL)
    try:
        deadline = time.monotonic() + 60
        while not (tmp_path / "checkpoint.ckpt").exists() and time.monotonic() < deadline:
            assert process.poll() is None
            time.sleep(0.02)
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait()
    assert read_checkpoint(tmp_path / "checkpoint.ckpt")["rows"][-1]["step"] < 45
    train_small(dataset, tmp_path)
    name = "weights.safetensors"
    assert (tmp_path / name).read_bytes() == (trained / name).read_bytes()


@pytest.mark.slow
def test_a_stopped_training_goes_on_from_its_last_step(
    trained: Path,
    dataset: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Long before the first check, and what it says is true."""
    step = TrainingLoop.update

    def stopped(self: TrainingLoop, *arguments: Any) -> Any:
        if self.step == 11:
            os.kill(os.getpid(), signal.SIGTERM)
        return step(self, *arguments)

    with monkeypatch.context() as patch:
        patch.setattr(TrainingLoop, "update", stopped)
        with pytest.raises(Stopped, match="step 12 of 45") as caught:
            train_small(dataset, tmp_path)
    assert caught.value.exit_code == 128 + signal.SIGTERM
    assert read_checkpoint(tmp_path / "checkpoint.ckpt")["step"] == 12
    assert not (tmp_path / "weights.safetensors").exists()
    train_small(dataset, tmp_path)
    name = "weights.safetensors"
    assert (tmp_path / name).read_bytes() == (trained / name).read_bytes()


def test_checkpoints_are_kept_by_time(
    dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not only at checks: a training whose machine goes away loses two minutes at most."""
    step = TrainingLoop.update

    def breaks_down(self: TrainingLoop, *arguments: Any) -> Any:
        if self.step == 4:
            raise OSError("the power went")
        return step(self, *arguments)

    monkeypatch.setattr("simnfnd.models.training.loop.SAVE_EVERY_S", 0.0)
    monkeypatch.setattr(TrainingLoop, "update", breaks_down)
    with pytest.raises(OSError, match="power"):
        train_small(dataset, tmp_path)
    assert read_checkpoint(tmp_path / "checkpoint.ckpt")["step"] == 4


def test_a_resumed_training_forgets_geometry_at_the_same_steps(
    dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Stopped right after a check: the loader's own random number must not shift the network's."""
    words = ["model=sonarnet", "model.widths=[8,8]", "model.blocks=[1,1]", "model.forget=0.5"]
    words += [word for word in SMALL if not word.startswith("model")]
    words += ["train.steps=6", "train.check_every=2"]
    drawn: dict[str, list[float]] = {"whole": [], "resumed": []}
    update = TrainingLoop.update

    def noted(self: TrainingLoop, batch: Any) -> Any:
        if name == "resumed" and self.step == 2 and len(drawn[name]) == 2:
            drawn[name].append(-1.0)
            raise OSError("the power went")
        drawn[name].append(float(torch.rand(())))
        return update(self, batch)

    monkeypatch.setattr(TrainingLoop, "update", noted)
    name = "whole"
    train(*config_for(dataset, tmp_path / name, *words))
    name = "resumed"
    with pytest.raises(OSError, match="power"):
        train(*config_for(dataset, tmp_path / name, *words))
    train(*config_for(dataset, tmp_path / name, *words))
    drawn[name].remove(-1.0)
    assert drawn["resumed"] == drawn["whole"]
    files = [tmp_path / name / WEIGHTS_NAME for name in drawn]
    assert files[0].read_bytes() == files[1].read_bytes()


def test_geometry_stays_exact_in_mixed_precision(
    dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    batches: list[dict[str, torch.Tensor]] = []

    def noted(network: torch.nn.Module, batch: dict[str, torch.Tensor]) -> torch.Tensor:
        batches.append(batch)
        return next(network.parameters()).sum() * 0

    settings, _ = config_for(dataset, tmp_path, *SMALL)
    mixed = replace(settings.train, precision="bf16-mixed")
    network = build_network(TINY)
    loop = TrainingLoop(network, noted, mixed, 0, torch.device("cpu"))
    third = torch.full((1, 1, 8, 8), 1 / 3)
    loop.update({"noisy": third, "clean": third, "azimuth_rad": third, "range_fraction": third})
    assert all(torch.equal(values, third) for values in batches[0].values())


def test_a_training_ends_with_a_check_between_intervals(dataset: Path, tmp_path: Path) -> None:
    row = train_small(dataset, tmp_path, "train.steps=5", "train.check_every=3")
    lines = (tmp_path / "metrics.csv").read_text(encoding="utf-8").splitlines()
    assert [line.split(",")[0] for line in lines[1:]] == ["3", "5"]
    assert row["step"] in (3, 5)


def test_a_network_is_trained_with_geometry_by_default(dataset: Path, tmp_path: Path) -> None:
    settings, _ = config_for(dataset, tmp_path)
    network = build_network(settings.model)
    assert {"range_fraction", "azimuth_rad", "sector"} <= set(network.extras)
    assert "remove" not in network.extras


def test_finished_training_is_not_done_again(
    trained: Path, dataset: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(TrainingLoop, "update", None)
    before = (trained / "weights.safetensors").stat().st_mtime_ns
    best = train_small(dataset, trained)
    assert best["gain_db"] > 3
    assert (trained / "weights.safetensors").stat().st_mtime_ns == before


def test_other_settings_do_not_continue_a_training(trained: Path, dataset: Path) -> None:
    with pytest.raises(FactoryError, match=r"loss.kind l1 -> newloss.*resume=false"):
        train_small(dataset, trained, "loss=newloss")


def test_training_begins_from_given_weights(trained: Path, dataset: Path, tmp_path: Path) -> None:
    weights = trained / WEIGHTS_NAME
    still = ("train.learning_rate=1e-12", "train.ema=0", "train.steps=2")
    train_small(dataset, tmp_path / "on", f"start='{weights}'", *still)
    before = load_weights(weights).network.state_dict()
    after = load_weights(tmp_path / "on" / WEIGHTS_NAME)
    for name, values in after.network.state_dict().items():
        torch.testing.assert_close(values, before[name], rtol=0, atol=1e-6)
    assert after.training["start"] == sha256_of(weights)[:16]
    with pytest.raises(FactoryError, match=r"start=.*sizes"):
        train_small(dataset, tmp_path / "wider", f"start='{weights}'", "model.width=12")
    with pytest.raises(FactoryError, match=r"weights=nowhere: no such file"):
        train_small(dataset, tmp_path / "none", "start=nowhere")


def test_damaged_checkpoint_is_named(trained: Path, dataset: Path, tmp_path: Path) -> None:
    content = (trained / "checkpoint.ckpt").read_bytes()
    (tmp_path / "checkpoint.ckpt").write_bytes(content[: len(content) // 2])
    with pytest.raises(FactoryError, match=r"checkpoint\.ckpt: damaged.*resume=false"):
        train_small(dataset, tmp_path)


def test_finished_weights_are_not_overwritten_unasked(
    trained: Path, dataset: Path, tmp_path: Path
) -> None:
    (tmp_path / "weights.safetensors").write_bytes(b"of somebody else")
    with pytest.raises(FactoryError, match="checkpoint"):
        train_small(dataset, tmp_path)
    assert (tmp_path / "weights.safetensors").read_bytes() == b"of somebody else"


def test_wrong_weights_files_are_named(trained: Path, tmp_path: Path) -> None:
    path = tmp_path / "weights.safetensors"
    with pytest.raises(FactoryError, match="no such file"):
        load_weights(path)
    good = (trained / "weights.safetensors").read_bytes()
    for content in (b"", b"not weights", good[:-100]):
        path.write_bytes(content)
        with pytest.raises(FactoryError, match="safetensors"):
            load_weights(path)
    from safetensors.torch import save_file

    save_file({"x": torch.zeros(2)}, path)
    with pytest.raises(FactoryError, match="not made by this program"):
        load_weights(path)
    save_weights(path, build_network({**TINY, "width": 4}), TINY, {})
    with pytest.raises(FactoryError, match="network"):
        load_weights(path)


def test_the_best_weights_are_kept_not_the_last(
    dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[int] = []

    def worse_and_worse(clean: Any, image: Any) -> float:
        calls.append(1)
        return 50.0 - len(calls)

    monkeypatch.setattr("simnfnd.models.training.validation.psnr_db", worse_and_worse)
    best = train_small(dataset, tmp_path, "train.steps=6", "train.check_every=2")
    assert best["step"] == 2
    loaded = load_weights(tmp_path / "weights.safetensors")
    assert loaded.training["validation"]["step"] == 2
    state = torch.load(tmp_path / "checkpoint.ckpt", weights_only=True)["average"]
    weights = loaded.network.state_dict()
    assert any(not torch.equal(value, state[f"module.{name}"]) for name, value in weights.items())


@pytest.mark.parametrize(("has", "expected"), [(True, "bf16-mixed"), (False, "32-true")])
def test_the_device_decides_and_the_weights_say_so(
    has: bool,
    expected: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    dataset = write_dataset(tmp_path / "data", train=4, test=0, size=48)
    out = tmp_path / "out"
    words = (*SMALL, "train.precision=auto", "train.steps=2", "train.check_every=1", "device=cpu")
    monkeypatch.setattr(device, "has_bf16", lambda device: has)
    train(*config_for(dataset, out, *words))
    assert f"train.precision=auto: {expected}\n" in capsys.readouterr().err
    assert load_weights(out / "weights.safetensors").training["train.precision"] == expected


SONARNET = {
    **{"kind": "sonarnet", "widths": [8, 8], "blocks": [1, 1], "polar": False, "lines": False},
    **{"mask": True, "forget": 0.0},
}
