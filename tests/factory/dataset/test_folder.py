"""The folder of a dataset: disks that fill up, failures, what is taken up, card and preview."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.common.files import (
    check_writable,
    remove_stale_temporaries,
    space,
    whole_file,
    whole_folder,
    write_atomically,
)
from simnfnd.factory.dataset.card import write_card
from simnfnd.factory.dataset.folder import open_folder
from simnfnd.factory.dataset.manifest import (
    Failure,
    Manifest,
    ShardInfo,
    damage,
    forget_outcomes,
    load_failures,
    load_manifest,
    save_manifest,
    save_outcome,
)
from simnfnd.factory.dataset.preview import preview
from simnfnd.factory.dataset.schema import config_hash
from simnfnd.factory.dataset.settings import DatasetSettings
from tests.factory.dataset.some_shards import PROVENANCE, dataset
from tests.factory.production.scheduler.run_files import wait_for
from tests.fake_source import refs


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
    own_place = f"here-{space()}"
    foreign_place = "here-ffffffff"
    dead = subprocess.Popen([sys.executable, "-c", ""])  # its exit status is not collected
    wait_for(lambda: psutil.Process(dead.pid).status() == psutil.STATUS_ZOMBIE)
    names = {
        f".shard-00000.h5.{own_place}-{dead.pid}-{token}.tmp": False,
        f".shard-00001.h5.{own_place}-{os.getpid()}-{token}.tmp": True,
        f".shard-00002.h5.{foreign_place}-{dead.pid}-{token}.tmp": True,
        f".shard-00003.h5.{foreign_place}-1-{token}.tmp": False,
        "shard-00004.h5": True,
        ".notes.tmp": True,
    }
    for name in names:
        (tmp_path / name).touch()
    days_ago = time.time() - 3 * 86_400
    os.utime(tmp_path / f".shard-00003.h5.{foreign_place}-1-{token}.tmp", (days_ago, days_ago))
    remove_stale_temporaries(tmp_path)
    dead.wait()
    left = {path.name for path in tmp_path.iterdir()}
    assert left == {name for name, stays in names.items() if stays}


@pytest.mark.parametrize("folder", ["file/below", "/proc/nowhere"])
def test_a_folder_that_cannot_be_written_is_named_with_its_key(tmp_path: Path, folder: str) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(FactoryError, match=r"dataset\.dir: "):
        check_writable(tmp_path / folder, "dataset.dir")


@pytest.mark.parametrize("writer", [whole_file, whole_folder])
def test_what_a_killed_writer_left_goes_with_the_next(
    tmp_path: Path, writer: Callable[[Path], AbstractContextManager[Path]]
) -> None:
    """Of the same name; what a living process writes stays."""
    killed = subprocess.Popen([sys.executable, "-c", ""])
    killed.wait()
    token = 16 * "0"
    mine = tmp_path / f".out.{space()}-{killed.pid}-{token}.tmp"
    living = tmp_path / f".out.{space()}-{os.getpid()}-{token}.tmp"
    others = tmp_path / f".other.{space()}-{killed.pid}-{token}.tmp"
    for folder in (mine, living, others):
        folder.mkdir()
        (folder / "half").touch()
    with writer(tmp_path / "out") as partial:
        if not partial.is_dir():
            partial.touch()
    assert sorted(tmp_path.iterdir()) == sorted([living, others, tmp_path / "out"])


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
    changed_provenance = replace(PROVENANCE, config_hash=config_hash(changed), config=changed)
    with pytest.raises(FactoryError) as caught:
        open_folder(tmp_path, {}, changed_provenance)
    message = str(caught.value)
    assert "sonar.hfov_deg 30.0 -> 45.0" in message
    assert "noise.density (absent) -> 0.3" in message
    assert "noise.density.uniform [0.1, 0.5] -> (absent)" in message
    assert "seed" not in message
    assert "\n" not in message
    with pytest.raises(FactoryError, match=r"simnfnd 0\.1\.0.*simnfnd 9"):
        open_folder(tmp_path, {}, replace(PROVENANCE, generator="simnfnd 9"))
    (tmp_path / "manifest.json").unlink()
    with pytest.raises(FactoryError, match="another configuration"):
        open_folder(tmp_path, {}, changed_provenance)


def test_a_folder_with_other_things_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("precious")
    with pytest.raises(FactoryError, match=r"thesis\.tex"):
        open_folder(tmp_path, {}, PROVENANCE)
    with pytest.raises(FactoryError, match="is a file"):
        open_folder(tmp_path / "thesis.tex", {}, PROVENANCE)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


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
        "`index.h5` joins the shards",
        "**Pixels.** ",
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


HASH = config_hash({"seed": 1})
START = Manifest(HASH, "simnfnd 0", {"seed": 1})


def info(number: int, **changes: object) -> ShardInfo:
    path = f"train/shard-{number:05d}.h5"
    return replace(ShardInfo(path, "train", 4, 1000, "0" * 64, "plan"), **changes)  # type: ignore[arg-type]


def begun(folder: Path) -> None:
    """A manifest of shards 0 to 2."""
    save_manifest(folder, replace(START, shards={info(n).path: info(n) for n in range(3)}))


def settle(folder: Path, number: int, shard: ShardInfo | None, hash_: str = HASH) -> Path:
    """The file of the result beside a shard."""
    path = info(number).path
    save_outcome(folder, path, hash_, shard, [FAILURE] if shard is None else [])
    return (folder / path).with_suffix(".json")


FAILURE = {"frame": "a/1", "shard": info(0).path, "kind": "frame", "reason": "NaN", "command": "x"}


def shards(folder: Path) -> dict[str, ShardInfo]:
    manifest = load_manifest(folder)
    assert manifest is not None
    return dict(manifest.shards)


def test_what_lies_beside_shards_counts_at_once_and_goes_once_it_is_put_together(
    tmp_path: Path,
) -> None:
    begun(tmp_path)
    settle(tmp_path, 3, info(3, failed=("reef/alpha/1",)))
    settle(tmp_path, 1, info(1, samples=7))
    settle(tmp_path, 0, None)
    settle(tmp_path, 9, info(9), "of another run")
    actual = shards(tmp_path)
    assert sorted(actual) == [info(n).path for n in (1, 2, 3)]
    assert actual[info(1).path].samples == 7
    assert actual[info(3).path].failed == ("reef/alpha/1",)
    assert load_failures(tmp_path) == [FAILURE]
    save_manifest(tmp_path, replace(START, shards=actual))
    forget_outcomes(tmp_path)
    assert shards(tmp_path) == actual
    assert not list(tmp_path.glob("*/*"))


@settings(max_examples=20)
@given(cut=st.floats(0, 1), junk=st.binary(max_size=6))
def test_a_result_that_is_damaged_costs_its_shard_alone(
    tmp_path_factory: pytest.TempPathFactory, cut: float, junk: bytes
) -> None:
    folder = tmp_path_factory.mktemp("spoilt")
    begun(folder)
    settle(folder, 3, info(3))
    path = settle(folder, 4, info(4))
    whole = path.read_bytes()
    path.write_bytes(whole[: int(cut * (len(whole) - 1))] + junk)
    assert sorted(shards(folder)) == [info(n).path for n in range(4)]


@pytest.mark.parametrize("path", ["../secret.h5", "/etc/passwd", "test/shard-00003.h5"])
def test_nothing_elsewhere_can_be_settled(tmp_path: Path, path: str) -> None:
    begun(tmp_path)
    file = settle(tmp_path, 3, info(3))
    file.write_bytes(file.read_bytes().replace(info(3).path.encode(), path.encode()))
    assert len(shards(tmp_path)) == 3
    file.unlink()
    os.mkfifo(file)
    assert len(shards(tmp_path)) == 3, "a pipe blocks no run"


def test_manifest_reads_back_and_its_bytes_do_not_depend_on_order(tmp_path: Path) -> None:
    manifest = dataset(tmp_path)
    text = (tmp_path / "manifest.json").read_bytes()
    assert load_manifest(tmp_path) == manifest
    backwards = replace(manifest, shards=dict(reversed(list(manifest.shards.items()))))
    save_manifest(tmp_path, backwards)
    assert (tmp_path / "manifest.json").read_bytes() == text
    document = json.loads(text)
    assert document["totals"]["train"] == {
        "samples": 8,
        "shards": 2,
        "bytes": sum((tmp_path / f"train/shard-0000{k}.h5").stat().st_size for k in (0, 1)),
    }
    for shard in document["shards"]:
        assert damage(tmp_path, ShardInfo(**{**shard, "failed": ()})) is None


@pytest.mark.parametrize(
    "path",
    ["../secret.h5", "/etc/passwd", "train/../../x.h5", "test/shard-00000.h5", "train/x.txt"],
)
def test_a_manifest_that_names_files_elsewhere_is_refused(tmp_path: Path, path: str) -> None:
    dataset(tmp_path)
    document = json.loads((tmp_path / "manifest.json").read_text())
    train = next(shard for shard in document["shards"] if shard["split"] == "train")
    train["path"] = path
    (tmp_path / "manifest.json").write_text(json.dumps(document))
    with pytest.raises(FactoryError, match=r"manifest\.json: damaged"):
        load_manifest(tmp_path)


def test_a_config_that_does_not_give_its_hash_is_refused(tmp_path: Path) -> None:
    dataset(tmp_path)
    path = tmp_path / "manifest.json"
    path.write_text(path.read_text().replace("30.0", "31.0"))
    with pytest.raises(FactoryError, match=r"manifest\.json: damaged .*config"):
        load_manifest(tmp_path)
