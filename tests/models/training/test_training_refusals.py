"""What a training refuses, and that it says so in one line."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

from simnfnd.command import main
from simnfnd.factory.common.errors import FactoryError
from tests.models.training.small_training import train_small
from tests.small_dataset import write_dataset


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_dataset(tmp_path_factory.mktemp("data"), train=24, test=4, size=48)


def test_loss_that_is_no_number_stops_training(dataset: Path, tmp_path: Path) -> None:
    words = ("train.learning_rate=10", "train.warmup=0", "loss.square=1e9")
    with pytest.raises(FactoryError, match=r"the loss became (nan|inf).*learning_rate"):
        train_small(dataset, tmp_path, *words)
    assert not (tmp_path / "weights.safetensors").exists()


@pytest.mark.slow
def test_damaged_sample_in_a_reading_process_is_one_line(tmp_path: Path) -> None:
    broken = write_dataset(tmp_path / "data", train=8, test=0, size=48)
    for path in sorted((broken / "train").glob("*.h5")):
        with h5py.File(path, "r") as file:
            places = [file["noisy"].id.get_chunk_info(row).byte_offset for row in range(4)]
        content = bytearray(path.read_bytes())
        for place in places:
            content[place + 20] ^= 0xFF
        path.write_bytes(content)
    with pytest.raises(FactoryError, match=r"^\S*0000\d\.h5: /\w+ sample \d is damaged") as error:
        train_small(broken, tmp_path / "out", "data.workers=1")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (("data.patch=64",), r"data\.patch=64 is larger than the images .*48x48"),
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
    words = ("data.patch=64", "data.batch=1", "data.crops=1", "train.steps=2")
    row = train_small(dataset, tmp_path / "whole", *words)
    assert np.isfinite(row["loss"])
    with pytest.raises(FactoryError, match=r"patch=64 .*data\.batch=data\.crops"):
        train_small(dataset, tmp_path / "mixed", "data.patch=64", "data.batch=2")


def test_unusable_datasets_are_refused(tmp_path: Path) -> None:
    with pytest.raises(FactoryError, match="no such folder"):
        train_small(tmp_path / "nowhere", tmp_path / "out")
    only_test = write_dataset(tmp_path / "test only", train=0, test=2)
    with pytest.raises(FactoryError, match="train split"):
        train_small(only_test, tmp_path / "out")
    other_dataset = write_dataset(tmp_path / "other", train=4, test=0)
    with h5py.File(other_dataset / "train" / "shard-00000.h5", "r+") as file:
        file.attrs["schema"] = "simnfnd/2"
    with pytest.raises(FactoryError, match=r"schema 'simnfnd/2'"):
        train_small(other_dataset, tmp_path / "out")


def test_bad_command_lines_are_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for arguments, words in (
        ((), "dataset: data=pairs needs the folder"),
        (("dataset=nowhere", "modle=nafnet"), "modle"),
    ):
        monkeypatch.setattr(sys, "argv", ["simnfnd"])
        assert main(["train", *arguments]) == 2
        error = capfd.readouterr().err
        assert words in error
        assert error.count("\n") == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("verb", "first", "last", "key"),
    [
        ("train", "data", "ablation", "learning_rate: 0.001"),
        ("demo", "scenes", "scheduler", "seed: 0"),
    ],
)
def test_help_names_the_groups_of_its_verb_alone(
    verb: str,
    first: str,
    last: str,
    key: str,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(sys, "argv", ["simnfnd"])
    assert main([verb, "--help"]) == 0
    printed = capfd.readouterr().out
    groups = dict(
        re.findall(r"^  ([\w/]+): ([\w, ]+)$", printed.partition("\nKeys")[0], re.MULTILINE)
    )
    assert (next(iter(groups)), list(groups)[-1]) == (first, last)
    assert ("model" in groups) == (verb == "train")
    assert key in printed


def test_output_that_cannot_be_written(dataset: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way", encoding="utf-8")
    with pytest.raises(FactoryError, match="out: cannot write"):
        train_small(dataset, tmp_path / "file" / "model")
