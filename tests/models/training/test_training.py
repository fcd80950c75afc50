"""Networks, losses, data and training: from a dataset folder to weights that denoise."""

from __future__ import annotations

import csv
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import pytest
import torch
import yaml
from hydra import compose, initialize_config_module
from omegaconf import OmegaConf
from torch.utils.data import DataLoader

from simnfnd.evaluation.metrics import fidelity as metrics
from simnfnd.factory.errors import FactoryError
from simnfnd.factory.files import sha256_of
from simnfnd.factory.settings import build
from simnfnd.models import WEIGHTS_NAME
from simnfnd.models.data.crops import Crops, Visit, VisitSampler, concatenate, interval_sizes
from simnfnd.models.data.pairs import (
    PairReader,
    PairSource,
    SampleRef,
    hold_out,
    read_table,
    spread,
)
from simnfnd.models.losses import build_loss
from simnfnd.models.networks import build_network
from simnfnd.models.networks.weights import load_weights, save_weights
from simnfnd.models.settings import DATA, ModelsSettings
from simnfnd.models.training import quality
from simnfnd.models.training.module import DenoisingModule, learning_rate_factor
from simnfnd.models.training.train import train
from simnfnd.models.training.validation import is_stopped, read_checkpoint
from tests.project_files import ROOT
from tests.small_dataset import fan_images, write_dataset

TINY = {"kind": "nafnet", "width": 8, "encoder": [1, 1], "middle": 1, "decoder": [1, 1]}
# The recipe of every small training here, as overrides of conf/models.yaml.
SMALL = (
    "model.width=8",
    "model.encoder=[1,1]",
    "model.decoder=[1,1]",
    "data.patch=32",
    "data.batch=4",
    "train.steps=90",
    "train.check_every=30",
    "train.warmup=5",
    "train.learning_rate=0.003",
    "train.ema=0.95",
    "tensorboard=false",
    "pictures=0",
)


@pytest.fixture(autouse=True, scope="module")
def one_thread() -> None:
    # Tiny networks gain nothing from more, and test runs side by side would fight for cores.
    torch.set_num_threads(1)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_dataset(tmp_path_factory.mktemp("data"), train=24, test=4, size=48)


def config_for(dataset: Path, out: Path, *overrides: str) -> tuple[ModelsSettings, dict[str, Any]]:
    with initialize_config_module("simnfnd.conf", version_base="1.3"):
        composed = compose("models", [f"dataset.dir='{dataset}'", f"out='{out}'", *overrides])
    values: Any = OmegaConf.to_container(composed, resolve=True)
    return build(ModelsSettings, values), values


def train_small(dataset: Path, out: Path, *overrides: str) -> dict[str, float | int]:
    return train(*config_for(dataset, out, *SMALL, *overrides))


@pytest.fixture(scope="module")
def trained(dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of an undisturbed small training."""
    out = tmp_path_factory.mktemp("models") / "undisturbed"
    train_small(dataset, out)
    return out


# --- networks and losses


@pytest.mark.parametrize("size", [(1, 1), (17, 30), (48, 64), (33, 5)])
def test_nafnet_takes_any_size(size: tuple[int, int]) -> None:
    network = build_network(TINY)
    assert network(torch.rand(2, 1, *size)).shape == (2, 1, *size)


def test_small_nafnet_is_as_large_as_published() -> None:
    """1.14 M parameters and 1.27 GMAC at 256x256, counted by torch from the operations."""
    from torch.utils.flop_counter import FlopCounterMode

    config = yaml.safe_load((ROOT / "conf/model/nafnet.yaml").read_text(encoding="utf-8"))
    network = build_network(config)
    assert sum(p.numel() for p in network.parameters()) == pytest.approx(1.14e6, rel=0.005)
    with FlopCounterMode(display=False) as counter, torch.inference_mode():
        network(torch.zeros(1, 1, 256, 256))
    assert counter.get_total_flops() / 2 == pytest.approx(1.27e9, rel=0.005)


def test_padding_does_not_reach_far_pixels() -> None:
    """An image and its upper left part agree where attention over the whole image is the same."""
    network = build_network(TINY)
    image = torch.rand(1, 1, 37, 41)
    padded = torch.nn.functional.pad(image, (0, 3, 0, 3), mode="replicate")
    assert torch.equal(network(image), network(padded)[..., :37, :41])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"kind": "restormer9"}, "model.kind"),
        ({"width": 0}, "model.width"),
        ({"decoder": [1]}, "as many of each"),
        ({"depth": 3}, "model.depth: unknown key"),
    ],
)
def test_odd_networks_are_refused(change: dict[str, object], words: str) -> None:
    with pytest.raises(FactoryError, match=words):
        build_network({**TINY, **change})


def test_losses_are_their_formulas() -> None:
    a = torch.tensor([[0.0, 0.5]]).reshape(1, 1, 1, 2).requires_grad_()
    b = torch.tensor([[0.3, 0.5]]).reshape(1, 1, 1, 2)
    assert build_loss({"kind": "l1"})(a, b).item() == pytest.approx(0.15)
    smooth = build_loss({"kind": "charbonnier", "epsilon": 0.4})
    assert smooth(a, b).item() == pytest.approx((0.5 + 0.4) / 2)
    (gradient,) = torch.autograd.grad(smooth(a, b), a)
    assert gradient.flatten().tolist() == pytest.approx([-0.3 / 0.5 / 2, 0])
    with pytest.raises(FactoryError, match=r"loss\.kind"):
        build_loss({"kind": "l7"})


def test_quality_agrees_with_the_evaluation() -> None:
    noisy, clean, _ = fan_images(48, np.random.default_rng(3))
    batch = [torch.from_numpy(image)[None, None] for image in (noisy, clean)]
    assert float(quality.psnr_db(*batch)) == pytest.approx(
        metrics.psnr(clean, noisy, data_range=1), abs=1e-4
    )
    assert float(quality.ssim(*batch)) == pytest.approx(
        metrics.ssim(clean, noisy, data_range=1), abs=1e-6
    )


def test_learning_rate_climbs_and_falls() -> None:
    factors = [learning_rate_factor(step, 10, 100) for step in range(101)]
    assert factors[0] == pytest.approx(1 / 11)
    assert factors[10] == 1 == max(factors)
    assert factors[55] == pytest.approx(0.5)
    assert factors[100] == pytest.approx(0)
    assert factors[10:] == sorted(factors[10:], reverse=True)


# --- data


def test_validation_shares_no_scene_with_training(dataset: Path) -> None:
    samples = read_table(dataset, "train").samples
    assert len(samples) == 24
    learning, validation = hold_out(samples, 0.1, seed=0)
    assert {s.scene for s in learning}.isdisjoint(s.scene for s in validation)
    assert len(learning) + len(validation) == 24
    assert len({s.scene for s in validation}) == 1
    one = tuple(s for s in samples if s.scene == samples[0].scene)
    learning, validation = hold_out(one, 0.3, seed=0)
    assert {s.frame for s in learning}.isdisjoint(s.frame for s in validation)
    assert learning
    assert validation
    with pytest.raises(FactoryError, match="one frame"):
        hold_out(tuple(s for s in one if s.frame == one[0].frame), 0.5, seed=0)


def test_spread_keeps_the_ends_of_a_long_list() -> None:
    samples = tuple(SampleRef(Path("x"), row, "s", "f") for row in range(100))
    rows = [sample.row for sample in spread(samples, 4)]
    assert rows == [0, 25, 50, 75]
    assert spread(samples, None) == spread(samples, 100) == samples


def visits(images: int, data: Any, steps: int = 5, intervals: int = 7) -> list[list[Visit]]:
    """All steps of a training."""
    sampler = VisitSampler(images, data, intervals, steps, seed=1)
    found = []
    for interval in range(intervals):
        sampler.set_epoch(interval)
        assert len(sampler) == steps
        found += list(sampler)
    return found


def data_settings(kind: str = "pairs", **changes: Any) -> Any:
    with initialize_config_module("simnfnd.conf", version_base="1.3"):
        values: Any = OmegaConf.to_container(compose("models", [f"data={kind}"]).data)
    return build(DATA[kind], {**values, **changes})


def test_every_image_is_visited_before_any_is_visited_again() -> None:
    steps = visits(7, data_settings(batch=1))
    drawn = [visit for step in steps for visit in step]
    assert [visit.number for visit in drawn] == list(range(35))
    assert [visit.round for visit in drawn] == [number // 7 for number in range(35)]
    rounds = [[visit.image for visit in drawn[i : i + 7]] for i in range(0, 35, 7)]
    assert all(sorted(images) == list(range(7)) for images in rounds)
    assert len({tuple(images) for images in rounds}) > 1


def test_stages_change_patch_and_batch_between_intervals() -> None:
    stages = [{"share": 0.5, "patch": 16, "batch": 12}, {"share": 0.3, "patch": 24, "batch": 8}]
    data = data_settings(stages=stages, patch=32, batch=4, crops=2)
    assert interval_sizes(data, 10) == [(16, 12)] * 5 + [(24, 8)] * 3 + [(32, 4)] * 2
    steps = visits(7, data, steps=3, intervals=10)
    assert [len(step) for step in steps] == [6] * 15 + [4] * 9 + [2] * 6
    drawn = [visit for step in steps for visit in step]
    assert [visit.number for visit in drawn] == list(range(len(drawn)))
    assert {visit.patch for visit in steps[0] + steps[15]} == {16, 24}


def test_devices_share_every_step(monkeypatch: pytest.MonkeyPatch) -> None:
    data = data_settings(batch=6)
    alone = visits(7, data)
    parts = []
    for rank in range(3):
        monkeypatch.setattr("simnfnd.models.data.crops._rank", lambda rank=rank: (rank, 3))
        parts.append(visits(7, data))
    for step, *shares in zip(alone, *parts, strict=True):
        assert sorted(visit for share in shares for visit in share) == sorted(step)
        assert [len(share) for share in shares] == [2, 2, 2]


def test_crops_are_windows_of_the_images_mirrored_at_most(dataset: Path) -> None:
    table = read_table(dataset, "train")
    samples = table.samples
    crops = Crops(PairSource(samples, None), crops=4, flip=True, seed=0)
    images = PairReader().layers(samples[3])
    windows, mirrored = set(), set()
    for number in range(10):
        batch = crops[Visit(number, 3, 0, 20)]
        assert batch["noisy"].shape == (4, 1, 20, 20)
        for row in range(4):
            places = [
                (top, left, flip)
                for top in range(29)
                for left in range(29)
                for flip in (False, True)
                if all(
                    np.array_equal(
                        image[top : top + 20, left : left + 20][:, :: -1 if flip else 1],
                        batch[name][row, 0].numpy(),
                    )
                    for name, image in zip(("noisy", "clean", "shadow"), images, strict=True)
                )
            ]
            assert len(places) >= 1, "a crop is no window of the image"
            windows.add(places[0][:2])
            mirrored.add(places[0][2])
    assert len(windows) > 20
    assert mirrored == {False, True}


def test_some_visits_show_weaker_noise_down_to_none(dataset: Path) -> None:
    samples = read_table(dataset, "train").samples
    source = PairSource(samples, None, weaker=0.5, seed=0)
    noisy, clean, _ = PairReader().layers(samples[0])
    factors = []
    for visit in range(60):
        seen = source.sample(0, visit).noisy
        factors.append(float(np.vdot(seen - clean, noisy - clean) / np.sum((noisy - clean) ** 2)))
        np.testing.assert_allclose(seen, clean + factors[-1] * (noisy - clean), atol=1e-5)
    assert 0.3 < np.mean(np.array(factors) < 0.999) < 0.7
    assert min(factors) == pytest.approx(0, abs=1e-6)
    np.testing.assert_array_equal(source.sample(0, None).noisy, noisy)
    np.testing.assert_array_equal(source.sample(0, 7).noisy, source.sample(0, 7).noisy)


def test_reading_processes_change_nothing(dataset: Path) -> None:
    samples = read_table(dataset, "train").samples
    data = data_settings(batch=4, patch=16)

    def batches(workers: int) -> list[torch.Tensor]:
        loader = DataLoader(
            Crops(PairSource(samples, None, weaker=0.5), flip=True, seed=0),
            batch_sampler=VisitSampler(len(samples), data, 1, 3, seed=0),
            collate_fn=concatenate,
            num_workers=workers,
            multiprocessing_context="spawn" if workers else None,
        )
        return [batch["noisy"] for batch in loader]

    for one, other in zip(batches(0), batches(2), strict=True):
        assert torch.equal(one, other)


# --- training


def test_training_learns_to_denoise(trained: Path, dataset: Path) -> None:
    with (trained / "metrics.csv").open(encoding="utf-8") as file:
        rows = [{name: float(value) for name, value in row.items()} for row in csv.DictReader(file)]
    assert [row["step"] for row in rows] == [30, 60, 90]
    assert rows[-1]["loss"] < 0.7 * rows[0]["loss"]
    assert rows[-1]["gain_db"] > 3
    assert rows[-1]["ssim"] > rows[-1]["ssim_noisy"]
    names = {path.name for path in trained.iterdir()}
    assert names == {
        "checkpoint.ckpt",
        "config.yaml",
        "metrics.csv",
        "samples.png",
        "weights.safetensors",
    }
    # And on scenes that were neither trained nor validated on.
    network = load_weights(trained / "weights.safetensors").network
    for sample in read_table(dataset, "test").samples:
        noisy, clean = PairReader().pair(sample)
        with torch.inference_mode():
            denoised = network(torch.from_numpy(noisy)[None, None])[0, 0].clamp(0, 1).numpy()
        before = metrics.psnr(clean, noisy, data_range=1)
        assert metrics.psnr(clean, denoised, data_range=1) > before + 2


def test_weights_describe_themselves(trained: Path) -> None:
    loaded = load_weights(trained / "weights.safetensors")
    assert loaded.model["width"] == 8
    assert loaded.training["dataset.config_hash"] == "0123abcd"
    assert loaded.training["validation"]["step"] in (30, 60, 90)
    config = yaml.safe_load((trained / "config.yaml").read_text(encoding="utf-8"))
    assert config["train"]["steps"] == 90


def test_same_seed_same_weights_and_a_breakdown_changes_nothing(
    trained: Path, dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Stopped in the middle of the second interval, training ends with the very same bytes."""
    step, crop = DenoisingModule.training_step, Crops.__getitem__
    calls: list[int] = []
    drawn: list[int] = []

    def recorded(self: Crops, visit: Visit) -> Any:
        drawn.append(visit.number)
        return crop(self, visit)

    def breaks_down(self: DenoisingModule, batch: Any, index: int) -> Any:
        calls.append(index)
        if len(calls) == 47:
            raise OSError("the power went")
        return step(self, batch, index)

    with monkeypatch.context() as patch:
        patch.setattr(DenoisingModule, "training_step", breaks_down)
        with pytest.raises(OSError, match="power"):
            train_small(dataset, tmp_path)
    assert len((tmp_path / "metrics.csv").read_text(encoding="utf-8").splitlines()) == 2
    # What was not in the checkpoint is drawn again, and every interval draws something new.
    with monkeypatch.context() as patch:
        patch.setattr(Crops, "__getitem__", recorded)
        train_small(dataset, tmp_path)
    assert drawn == list(range(30 * 4, 90 * 4))
    name = "weights.safetensors"
    assert (tmp_path / name).read_bytes() == (trained / name).read_bytes()
    assert _without_seconds(tmp_path) == _without_seconds(trained)
    assert (tmp_path / "samples.png").read_bytes() == (trained / "samples.png").read_bytes()


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
    assert read_checkpoint(tmp_path / "checkpoint.ckpt")["rows"][-1]["step"] < 90
    train_small(dataset, tmp_path)
    name = "weights.safetensors"
    assert (tmp_path / name).read_bytes() == (trained / name).read_bytes()


def test_finished_training_is_not_done_again(
    trained: Path, dataset: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(DenoisingModule, "training_step", None)
    before = (trained / "weights.safetensors").stat().st_mtime_ns
    best = train_small(dataset, trained)
    assert best["gain_db"] > 3
    assert (trained / "weights.safetensors").stat().st_mtime_ns == before


def test_other_settings_do_not_continue_a_training(trained: Path, dataset: Path) -> None:
    with pytest.raises(FactoryError, match=r"loss.kind l1 -> charbonnier.*resume=false"):
        train_small(dataset, trained, "loss=charbonnier")


def test_training_begins_from_given_weights(trained: Path, dataset: Path, tmp_path: Path) -> None:
    weights = trained / WEIGHTS_NAME
    still = ("train.learning_rate=1e-12", "train.ema=0")
    train_small(dataset, tmp_path / "on", f"start='{weights}'", *still)
    before = load_weights(weights).network.state_dict()
    after = load_weights(tmp_path / "on" / WEIGHTS_NAME)
    for name, values in after.network.state_dict().items():
        torch.testing.assert_close(values, before[name], rtol=0, atol=1e-6)
    assert after.training["start"] == sha256_of(weights)[:16]
    moved = tmp_path / "moved"
    train_small(dataset, moved, f"start='{weights}'", "train.parts=[outro]", "train.ema=0")
    for name, values in load_weights(moved / WEIGHTS_NAME).network.state_dict().items():
        assert torch.equal(values, before[name]) != name.startswith("outro."), name
    with pytest.raises(FactoryError, match=r"train\.parts: the network has no 'tail'; .*outro"):
        train_small(dataset, tmp_path / "odd", "train.parts=[tail]")
    with pytest.raises(FactoryError, match=r"start=.*give both the same sizes"):
        train_small(dataset, tmp_path / "wider", f"start='{weights}'", "model.width=12")
    with pytest.raises(FactoryError, match=r"weights=nowhere: no such file"):
        train_small(dataset, tmp_path / "none", "start=nowhere")


def test_training_stops_when_nothing_gets_better() -> None:
    rows = [{"psnr": value} for value in (20.0, 22.0, 21.9, 22.0)]
    assert not is_stopped(rows, DenoisingModule, None)
    assert not is_stopped(rows, DenoisingModule, 3)
    assert is_stopped(rows, DenoisingModule, 2)
    assert not is_stopped(rows[:2], DenoisingModule, 2)
    assert not is_stopped([*rows, {"psnr": 22.1}], DenoisingModule, 2)


def validate_ever_worse(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Every validation is 1 dB below the one before; the list has an entry for each."""
    calls: list[int] = []

    def worse_and_worse(image: torch.Tensor, clean: torch.Tensor) -> torch.Tensor:
        calls.append(1)
        return torch.full((len(image),), 50.0 - len(calls))

    monkeypatch.setattr("simnfnd.models.training.module.psnr_db", worse_and_worse)
    return calls


def test_early_stopping_is_a_finished_training(
    dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = validate_ever_worse(monkeypatch)
    short = ("train.steps=12", "train.check_every=2", "train.patience=2")
    assert train_small(dataset, tmp_path, *short)["step"] == 2
    assert len((tmp_path / "metrics.csv").read_text(encoding="utf-8").splitlines()) == 4
    done = len(calls)
    assert train_small(dataset, tmp_path, *short)["step"] == 2
    assert len(calls) == done, "a training that stopped early was continued"


def test_curves_and_pictures_while_training(dataset: Path, tmp_path: Path) -> None:
    short = ("train.steps=4", "train.check_every=2", "tensorboard=true", "pictures=2")
    train_small(dataset, tmp_path, *short)
    assert sorted(path.name for path in (tmp_path / "samples").iterdir()) == [
        "000002.png",
        "000004.png",
    ]
    sheet = cv2.imread(str(tmp_path / "samples" / "000004.png"), cv2.IMREAD_UNCHANGED)
    assert sheet is not None
    assert sheet.shape == (2 * 48 + 4, 3 * 48 + 2 * 4)
    (events,) = (tmp_path / "tensorboard").iterdir()
    content = events.read_bytes()
    for tag in (b"psnr", b"loss", b"learning_rate", b"samples"):
        assert tag in content


def test_damaged_checkpoint_is_named(trained: Path, dataset: Path, tmp_path: Path) -> None:
    content = (trained / "checkpoint.ckpt").read_bytes()
    (tmp_path / "checkpoint.ckpt").write_bytes(content[: len(content) // 2])
    with pytest.raises(FactoryError, match=r"checkpoint\.ckpt: damaged.*resume=false"):
        train_small(dataset, tmp_path)


def test_finished_weights_are_not_overwritten_unasked(
    trained: Path, dataset: Path, tmp_path: Path
) -> None:
    (tmp_path / "weights.safetensors").write_bytes(b"of somebody else")
    with pytest.raises(FactoryError, match="holds weights but no checkpoint"):
        train_small(dataset, tmp_path)
    assert (tmp_path / "weights.safetensors").read_bytes() == b"of somebody else"


def test_loss_that_is_no_number_stops_training(dataset: Path, tmp_path: Path) -> None:
    with pytest.raises(FactoryError, match=r"the loss became (nan|inf).*learning_rate"):
        train_small(dataset, tmp_path, "train.learning_rate=1e30", "train.warmup=0")
    assert not (tmp_path / "weights.safetensors").exists()


def test_damaged_sample_in_a_reading_process_is_one_line(tmp_path: Path) -> None:
    broken = write_dataset(tmp_path / "data", train=8, test=0, size=48)
    for path in sorted((broken / "train").glob("*.h5")):
        with h5py.File(path, "r") as file:
            places = [file["noisy"].id.get_chunk_info(row).byte_offset for row in range(4)]
        content = bytearray(path.read_bytes())
        for place in places:
            content[place + 20] ^= 0xFF
        path.write_bytes(content)
    with pytest.raises(FactoryError, match=r"^\S*shard-0000\d\.h5: sample \d is damaged") as error:
        train_small(broken, tmp_path / "out", "data.workers=1")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (("data.patch=64",), r"data\.patch=64 is larger than the images .*48x48"),
        (("train.check_every=40",), "multiple of check_every"),
        (("train.precision=16-mixed", "device=cpu"), "16-mixed needs a GPU"),
        (("data.validation=1.0",), r"data\.validation"),
        (("name=a/b",), "name"),
    ],
)
def test_odd_settings_are_refused(
    overrides: tuple[str, ...], words: str, dataset: Path, tmp_path: Path
) -> None:
    with pytest.raises(FactoryError, match=words):
        train_small(dataset, tmp_path, *overrides)


def test_a_step_of_one_image_takes_it_whole(dataset: Path, tmp_path: Path) -> None:
    words = ("data.patch=64", "data.batch=1", "data.crops=1")
    row = train_small(dataset, tmp_path / "whole", *words)
    assert np.isfinite(row["loss"])
    stages = "data.stages=[{share: 0.5, patch: 64, batch: 2}]"
    with pytest.raises(FactoryError, match=r"patch=64 is larger than .*or data\.batch=data\.crops"):
        train_small(dataset, tmp_path / "mixed", *words, stages)


def test_unusable_datasets_are_refused(tmp_path: Path) -> None:
    with pytest.raises(FactoryError, match="no such folder"):
        train_small(tmp_path / "nowhere", tmp_path / "out")
    only_test = write_dataset(tmp_path / "test only", train=0, test=2)
    with pytest.raises(FactoryError, match="train split is empty"):
        train_small(only_test, tmp_path / "out")
    other = write_dataset(tmp_path / "other", train=4, test=0)
    with h5py.File(other / "train" / "shard-00000.h5", "r+") as file:
        file.attrs["schema"] = "simnfnd/2"
    with pytest.raises(FactoryError, match=r"schema 'simnfnd/2'"):
        train_small(other, tmp_path / "out")


def test_output_that_cannot_be_written(dataset: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way", encoding="utf-8")
    with pytest.raises(FactoryError, match="out: cannot write"):
        train_small(dataset, tmp_path / "file" / "model")


def test_wrong_weights_files_are_named(trained: Path, tmp_path: Path) -> None:
    path = tmp_path / "weights.safetensors"
    with pytest.raises(FactoryError, match="no such file"):
        load_weights(path)
    good = (trained / "weights.safetensors").read_bytes()
    for content in (b"", b"not weights", good[:-100]):
        path.write_bytes(content)
        with pytest.raises(FactoryError, match="not a safetensors file, or a damaged one"):
            load_weights(path)
    from safetensors.torch import save_file

    save_file({"x": torch.zeros(2)}, path)
    with pytest.raises(FactoryError, match="not made by this program"):
        load_weights(path)
    save_weights(path, build_network({**TINY, "width": 4}), TINY, {})
    with pytest.raises(FactoryError, match="do not fit their network"):
        load_weights(path)


def test_bad_command_lines_are_one_line(tmp_path: Path) -> None:
    for arguments, words in (
        ((), "dataset: give the folder"),
        (("dataset=nowhere", "modle=nafnet"), "modle"),
        (("dataset=nowhere", "model=vgg"), "vgg"),
        (("denoise", "a.png"), "--out"),
        (("denoise", "a.png", "--out", "o", "--weights", "w"), "a.png: no such file"),
    ):
        done = subprocess.run(
            [sys.executable, "-m", "simnfnd.models", *arguments],
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
            capture_output=True,
            text=True,
            check=False,
            timeout=60,
        )
        assert done.returncode == 2, done.stderr
        assert words in done.stderr
        assert done.stderr.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_the_best_weights_are_kept_not_the_last(
    dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    validate_ever_worse(monkeypatch)
    best = train_small(dataset, tmp_path, "train.steps=6", "train.check_every=2")
    assert best["step"] == 2
    loaded = load_weights(tmp_path / "weights.safetensors")
    assert loaded.training["validation"]["step"] == 2
    state = torch.load(tmp_path / "checkpoint.ckpt", weights_only=True)["state_dict"]
    last = {name: value for name, value in state.items() if name.startswith("average.module.")}
    kept = loaded.network.state_dict()
    assert any(
        not torch.equal(value, kept[name.removeprefix("average.module.")])
        for name, value in last.items()
    )


def _without_seconds(folder: Path) -> list[str]:
    lines = (folder / "metrics.csv").read_text(encoding="utf-8").splitlines()
    return [line.rpartition(",")[0] for line in lines]
