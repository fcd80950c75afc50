"""Datasets of strangers: every verb that opens one gives one line, and writes where it was told."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.dataset import PairDataset
from simnfnd.factory.dataset.preview import preview
from simnfnd.factory.production.commands.inspect import report
from simnfnd.factory.production.export import export
from tests.factory.dataset.hostile import admit, reseal
from tests.factory.production.export.export_dataset import write

SHARD = "train/shard-00001.h5"


def read(folder: Path) -> None:
    with PairDataset(folder) as pairs:
        list(pairs)


def open_trusted(folder: Path) -> None:
    """Without the other process: for what must be refused in this one, too."""
    with PairDataset(folder, trusted=True) as pairs:
        list(pairs)


READERS: dict[str, Callable[[Path], Any]] = {
    "read": read,
    "export": lambda folder: export(folder, "png", folder.parent / "out"),
    "inspect": lambda folder: list(report(folder, "it")),
    "preview": lambda folder: preview(folder, folder.parent / "sheet.png"),
}


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("sound") / "dataset")


def change(folder: Path, action: Callable[[h5py.File], Any]) -> None:
    """Change a shard on purpose, with a manifest that agrees."""
    with h5py.File(folder / SHARD, "r+") as file:
        action(file)
    admit(folder)


def set_attribute(name: str, value: Any) -> Callable[[h5py.File], None]:
    def action(file: h5py.File) -> None:
        del file.attrs[name]
        if value is not None:
            file.attrs[name] = value

    return action


ATTRIBUTES: dict[str, tuple[Callable[[h5py.File], None], str]] = {
    "no config": (set_attribute("config", None), "config is absent or no text"),
    "config cut off": (set_attribute("config", '{"seed": 3'), "attribute config is no JSON"),
    "config deep": (set_attribute("config", "[" * 60_000), "attribute config is no JSON"),
    "no config_hash": (set_attribute("config_hash", None), "attribute config_hash is absent"),
    "split above": (set_attribute("split", "../../escaped"), "reads train or test"),
}


@pytest.mark.parametrize("kind", sorted(ATTRIBUTES))
def test_a_damaged_attribute_is_one_line_of_every_reader(folder: Path, kind: str) -> None:
    action, words = ATTRIBUTES[kind]
    change(folder, action)
    before = sorted(folder.parent.rglob("*"))
    with pytest.raises(FactoryError, match=rf"{SHARD}.*{words}") as caught:
        open_trusted(folder)
    assert "\n" not in str(caught.value)
    for verb in READERS if kind in ("split above", "config cut off") else {}:
        with pytest.raises(FactoryError, match=SHARD):
            READERS[verb](folder)
    assert sorted(folder.parent.rglob("*")) == before


def test_a_shard_of_the_other_split_is_refused(folder: Path) -> None:

    def to_test(file: h5py.File) -> None:
        file.attrs["split"] = "test"
        reseal(file)

    change(folder, to_test)
    for verb in ("read", "export", "inspect"):
        with pytest.raises(FactoryError, match=rf"{SHARD}: .*split is 'test'"):
            READERS[verb](folder)


def test_numbers_in_place_of_references_kill_no_process(folder: Path) -> None:
    """They end in a crash inside HDF5 when they are followed."""

    def number(file: h5py.File) -> None:
        del file["noisy"].attrs["DIMENSION_LIST"]
        file["noisy"].attrs["DIMENSION_LIST"] = np.arange(3)

    change(folder, number)
    for read_it in READERS.values():
        read_it(folder)


def test_files_are_opened_in_another_process_first(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A table of texts that HDF5 walks for ever would hang this one."""
    monkeypatch.setattr("simnfnd.factory.dataset.reader.LIMIT_S", 2.0)
    path = folder / SHARD
    content = bytearray(path.read_bytes())
    start = content.index(b"GCOL") + 16
    content[start : start + 200] = bytes(200)
    path.write_bytes(content)
    admit(folder)
    with pytest.raises(FactoryError, match=rf"{SHARD}: (not read within 2 s|damaged)"):
        read(folder)


@pytest.mark.parametrize("name", ["a\nlicense: mit", "x" * 500, 7, ["a"]])
def test_a_name_from_a_file_stays_one_line_of_the_card(folder: Path, name: object) -> None:
    import yaml

    path = folder / "config.yaml"
    values = yaml.safe_load(path.read_text())
    values["dataset"]["name"] = name
    path.write_text(yaml.safe_dump(values))
    with pytest.raises(FactoryError, match=r"config\.yaml: dataset\.name"):
        export(folder, "huggingface", folder.parent / "out")
