"""Datasets are merged when they are of one kind and share nothing; anything else is refused."""

from __future__ import annotations

import json
from pathlib import Path

import h5py
import numpy as np
import pytest
import yaml

from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.dataset.manifest import damage, load_manifest
from simnfnd.factory.dataset.schema import config_hash
from simnfnd.factory.dataset.validate import validate
from simnfnd.factory.production.commands.merge import main, merge
from tests.factory.dataset.hostile import admit, reseal
from tests.factory.production.export.export_dataset import CONFIG, write


@pytest.fixture
def two(tmp_path: Path) -> tuple[Path, Path]:
    return write(tmp_path / "a", place="reef", seed=1), write(tmp_path / "b", place="pier", seed=2)


def refused(directories, out: Path, match: str) -> None:
    with pytest.raises(FactoryError, match=match) as caught:
        merge(directories, out)
    assert "\n" not in str(caught.value)
    assert not out.exists()
    assert not list(out.parent.glob(".*partial*"))


@pytest.mark.slow
def test_the_shards_are_those_of_both(two, tmp_path, capsys) -> None:
    out = tmp_path / "out"
    main([str(two[0]), str(two[1]), "--out", str(out), "--name", "both"])
    assert "18 train and 6 test pairs in 6 shards" in capsys.readouterr().out
    manifest = load_manifest(out)
    assert manifest is not None
    assert list(manifest.shards) == [
        "test/shard-00000.h5", "test/shard-00001.h5", "train/shard-00000.h5",
        "train/shard-00001.h5", "train/shard-00002.h5", "train/shard-00003.h5",
    ]  # fmt: skip
    assert [damage(out, info) for info in manifest.shards.values()] == [None] * 6
    for name, (source, original) in {
        "train/shard-00001.h5": (two[0], "train/shard-00001.h5"),
        "train/shard-00002.h5": (two[1], "train/shard-00000.h5"),
        "test/shard-00001.h5": (two[1], "test/shard-00000.h5"),
    }.items():
        assert (out / name).read_bytes() == (source / original).read_bytes()
    with h5py.File(out / "index.h5") as index, h5py.File(two[1] / "test/shard-00000.h5") as last:
        np.testing.assert_array_equal(index["test/noisy"][3:], last["noisy"][:])
    merge((out, write(tmp_path / "c", place="canyon", seed=3)), tmp_path / "abc")
    report = validate(tmp_path / "abc", deep=True)
    assert (report.errors, report.samples) == ((), 36)


def test_it_says_where_everything_came_from(two, tmp_path) -> None:
    merge(two, tmp_path / "out", name="both")
    manifest = json.loads((tmp_path / "out/manifest.json").read_text())
    config = manifest["config"]
    assert config["noise"] == CONFIG["noise"]
    assert "seed" not in config
    assert [part["seed"] for part in config["merged"]] == [1, 2]
    hashes = [part["config_hash"] for part in config["merged"]]
    assert hashes == [config_hash({**CONFIG, "seed": seed}) for seed in (1, 2)]
    assert manifest["config_hash"] not in hashes
    card = (tmp_path / "out/README.md").read_text()
    assert all(digest in card for digest in hashes)
    assert "license: cc-by-4.0" in card
    assert "# both" in card
    assert yaml.safe_load((tmp_path / "out/config.yaml").read_text())["dataset"]["name"] == "both"
    with h5py.File(tmp_path / "out/index.h5") as index:
        assert index.attrs["config_hash"] == manifest["config_hash"]
        assert json.loads(index.attrs["config"]) == config


def test_a_sample_in_both_is_refused(tmp_path, two) -> None:
    again = write(tmp_path / "again", place="reef", seed=9)
    refused((two[0], again), tmp_path / "out", r"reef/reef-train/0.000 variant 0 is in .*a and in")


def test_a_scene_that_trains_here_and_tests_there_is_refused(tmp_path, two) -> None:
    # The other dataset's test scene, with frames of its own, trains here.
    leaking = write(tmp_path / "leaking", place="mole", seed=9)
    for path in leaking.glob("train/*.h5"):
        with h5py.File(path, "r+") as file:
            table = file["meta"][:]
            table["location"] = b"pier"
            table["scene"] = b"pier-test"
            table["frame"] = [b"new-%d-%d" % (int(path.stem[-1]), row) for row in range(len(table))]
            file["meta"][:] = table
            reseal(file)
    admit(leaking)
    refused((two[1], leaking), tmp_path / "out", "pier/pier-test is in test of .* and in train of")


def test_other_noise_is_refused_by_its_key(tmp_path, two) -> None:
    noise = {"background": {"density": {"uniform": [0.1, 0.9]}}}
    second = write(tmp_path / "other", place="mole", config={**CONFIG, "noise": noise})
    refused(
        (two[0], second), tmp_path / "out", r"noise.background.density.uniform \[0.1, 0.5\] -> \["
    )


def test_licences_must_agree_or_be_given(tmp_path, two) -> None:
    second = write(tmp_path / "other", place="mole", licence="MIT")
    refused((two[0], second), tmp_path / "out", r"licences differ .*CC-BY-4.0.*MIT.*--licence")
    merge((two[0], second), tmp_path / "out", licence="CC-BY-4.0")
    assert "license: cc-by-4.0" in (tmp_path / "out/README.md").read_text()


def test_damage_is_found_before_anything_is_written(tmp_path, two) -> None:
    path = two[1] / "train/shard-00000.h5"
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    refused(two, tmp_path / "out", "b/train/shard-00000.h5: SHA-256 differs")


def test_what_cannot_be_merged(tmp_path, two) -> None:
    out = tmp_path / "out"
    refused(two[:1], out, "at least two")
    refused((two[0], two[0]), out, "at least two")
    refused((two[0], tmp_path), out, "no manifest.json")
    with pytest.raises(FactoryError, match="holds files already"):
        merge(two, two[0])
