"""The folder of a dataset: disks that fill up, failures, what is taken up, card and preview."""

from __future__ import annotations

import contextlib
import os
import resource
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
import yaml

from simnfnd.factory.dataset.card import write_card
from simnfnd.factory.dataset.folder import open_folder
from simnfnd.factory.dataset.manifest import Failure
from simnfnd.factory.dataset.preview import preview
from simnfnd.factory.dataset.schema import config_hash
from simnfnd.factory.dataset.settings import DatasetSettings
from simnfnd.factory.errors import FactoryError
from simnfnd.factory.files import (
    check_writable,
    remove_stale_temporaries,
    space,
    whole_folder,
    write_atomically,
)
from tests.factory.dataset.some_shards import PROVENANCE, dataset, write
from tests.factory.scheduler.run_files import wait_for
from tests.fake_source import refs

# --- files and disks --------------------------------------------------------------------------


@pytest.fixture
def small_files() -> Iterator[None]:
    """No file may exceed 2000 bytes: to the writer the same as a disk that fills up."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2000, limits[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, limits)


@pytest.mark.usefixtures("small_files")
def test_a_full_disk_leaves_nothing_half_written(tmp_path: Path) -> None:
    with pytest.raises(FactoryError, match="no room to write") as caught:
        write(tmp_path)
    assert "\n" not in str(caught.value)
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


def test_a_failed_write_leaves_the_old_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "manifest.json"
    write_atomically(path, b"old")

    def fail(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(FactoryError, match="No space left"):
        write_atomically(path, b"new")
    assert path.read_bytes() == b"old"
    assert [entry.name for entry in tmp_path.iterdir()] == ["manifest.json"]


def test_temp_files_of_the_dead_are_removed_and_of_the_living_left(tmp_path: Path) -> None:
    token = 16 * "0"
    here, elsewhere = f"here-{space()}", "here-ffffffff"
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    names = {
        f".shard-00000.h5.{here}-{dead.pid}-{token}.tmp": False,
        f".shard-00001.h5.{here}-{os.getpid()}-{token}.tmp": True,
        f".shard-00002.h5.{elsewhere}-{dead.pid}-{token}.tmp": True,
        f".shard-00003.h5.{elsewhere}-1-{token}.tmp": False,
        "shard-00004.h5": True,
        ".notes.tmp": True,
    }
    for name in names:
        (tmp_path / name).touch()
    days_ago = time.time() - 3 * 86_400
    os.utime(tmp_path / f".shard-00003.h5.{elsewhere}-1-{token}.tmp", (days_ago, days_ago))
    assert remove_stale_temporaries(tmp_path) == 2
    left = {path.name for path in tmp_path.iterdir()}
    assert left == {name for name, stays in names.items() if stays}


@pytest.mark.skipif(sys.platform == "win32", reason="no zombies there")
def test_a_dead_process_that_nobody_has_collected_is_dead(tmp_path: Path) -> None:
    with subprocess.Popen([sys.executable, "-c", "print()"], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.read()
        wait_for(lambda: psutil.Process(process.pid).status() == psutil.STATUS_ZOMBIE)
        (tmp_path / f".shard-00000.h5.{space()}-{process.pid}-{16 * '0'}.tmp").touch()
        assert remove_stale_temporaries(tmp_path) == 1


@pytest.mark.parametrize("folder", ["file/below", "/proc/nowhere"])
def test_a_folder_that_cannot_be_written_is_named_with_its_key(tmp_path: Path, folder: str) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(FactoryError, match=r"dataset\.dir: cannot write .*; give a writable"):
        check_writable(tmp_path / folder, "dataset.dir")


def test_a_folder_is_whole_or_absent(tmp_path: Path) -> None:
    for fails in (True, False):
        with contextlib.suppress(ValueError), whole_folder(tmp_path / "out") as partial:
            (partial / "a").write_bytes(b"a")
            if fails:
                raise ValueError
        assert (tmp_path / "out").exists() is not fails
    assert [entry.name for entry in tmp_path.iterdir()] == ["out"]


# --- failures, folder -------------------------------------------------------------------------


def test_a_folder_of_the_same_dataset_is_taken_up(tmp_path: Path) -> None:
    manifest = dataset(tmp_path / "data")
    (tmp_path / "data/notes.txt").write_text("mine")
    assert open_folder(tmp_path / "data", {"whole": True}, PROVENANCE) == manifest
    config = (tmp_path / "data/config.yaml").read_text()
    assert yaml.safe_load(config) == {"whole": True}
    assert PROVENANCE.config_hash in config.splitlines()[0]
    (tmp_path / "data/manifest.json").unlink()
    assert open_folder(tmp_path / "data", {"whole": True}, PROVENANCE).shards == {}
    assert (tmp_path / "data/notes.txt").exists()


def test_another_configuration_is_refused_with_the_keys_that_differ(tmp_path: Path) -> None:
    dataset(tmp_path)
    changed = {"seed": 7, "sonar": {"hfov_deg": 45.0}, "noise": {"density": 0.3}}
    other = replace(PROVENANCE, config_hash=config_hash(changed), config=changed)
    with pytest.raises(FactoryError) as caught:
        open_folder(tmp_path, {}, other)
    message = str(caught.value)
    assert "sonar.hfov_deg 30.0 -> 45.0" in message
    assert "noise.density (absent) -> 0.3" in message
    assert "noise.density.uniform [0.1, 0.5] -> (absent)" in message
    assert "seed" not in message
    assert "\n" not in message
    with pytest.raises(FactoryError, match=r"made by simnfnd 0\.1\.0, this is simnfnd 9"):
        open_folder(tmp_path, {}, replace(PROVENANCE, generator="simnfnd 9"))
    (tmp_path / "manifest.json").unlink()
    with pytest.raises(FactoryError, match="another configuration"):
        open_folder(tmp_path, {}, other)


def test_a_folder_with_other_things_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("precious")
    with pytest.raises(FactoryError, match=r"holds other files \(thesis\.tex\) and no dataset"):
        open_folder(tmp_path, {}, PROVENANCE)
    with pytest.raises(FactoryError, match="is a file"):
        open_folder(tmp_path / "thesis.tex", {}, PROVENANCE)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


# --- card and preview -------------------------------------------------------------------------


def test_the_card_says_what_is_there_and_its_code_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    manifest = dataset(tmp_path)
    failure = Failure(refs(1)[0], "frame", "bad", "train/shard-00000.h5")
    settings = DatasetSettings(name="reef", licence="CC-BY-4.0")
    path = write_card(tmp_path, manifest, PROVENANCE, settings, [failure], {"no depth": 3})
    _, front, body = path.read_text().split("---\n", 2)
    header = yaml.safe_load(front)
    assert header["license"] == "cc-by-4.0"
    assert header["size_categories"] == ["n<1K"]
    for text in (
        "# reef: simulated forward-looking sonar images, noisy and clean",
        "12 pairs",
        "8 train and 4 test",
        "| train | reef | beta | 4 |",
        "| test | reef | gamma | 4 |",
        PROVENANCE.config_hash,
        "hfov_deg: 30.0",
        "    uniform: [0.1, 0.5]",
        "images left out: 3, no depth",
        "frames that failed: 1,",
        "Of this dataset: CC-BY-4.0.",
    ):
        assert text in body
    code = body.split("```python\n")[1].split("```")[0]
    assert len([line for line in code.splitlines() if line.strip()]) <= 5
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    exec(code, names)
    assert names["noisy"].shape == (24, 20)
    assert names["made_from"]["scene"] == b"alpha"


def test_the_contact_sheet_shows_the_pixels_of_the_shards(tmp_path: Path) -> None:
    from PIL import Image

    dataset(tmp_path)
    path = preview(tmp_path, pairs=3)
    assert path == tmp_path / "preview.png"
    first = path.read_bytes()
    preview(tmp_path, out=tmp_path / "again.png", pairs=3)
    assert (tmp_path / "again.png").read_bytes() == first
    image = np.asarray(Image.open(path).convert("RGB")).astype(int)
    assert image.shape[0] > 700
    assert image.shape[1] > 2000
    # Shadows are the only blue thing on the sheet, echoes the only amber one.
    blue = (image[..., 2] > image[..., 0] + 60).mean()
    amber = (image[..., 0] > image[..., 2] + 60).mean()
    assert 0.005 < blue < 0.2
    assert 0.05 < amber < 0.6
