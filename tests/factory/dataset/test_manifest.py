"""manifest.json, and beside the shards what a run settled since then."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simnfnd.factory.dataset.manifest import (
    Manifest,
    ShardInfo,
    ShardOutcome,
    damage,
    forget_outcomes,
    load_failures,
    load_manifest,
    save_manifest,
    save_outcome,
)
from simnfnd.factory.dataset.schema import config_hash
from simnfnd.factory.errors import FactoryError
from tests.factory.dataset.some_shards import dataset

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
    save_outcome(folder, ShardOutcome(path, hash_, shard, [FAILURE] if shard is None else []))
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
    found = shards(tmp_path)
    assert sorted(found) == [info(n).path for n in (1, 2, 3)]
    assert found[info(1).path].samples == 7
    assert found[info(3).path].failed == ("reef/alpha/1",)
    assert load_failures(tmp_path) == [FAILURE]
    save_manifest(tmp_path, replace(START, shards=found))
    forget_outcomes(tmp_path)
    assert shards(tmp_path) == found
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
    assert len(shards(tmp_path)) == 3, "a pipe stops nobody"


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
    with pytest.raises(FactoryError, match=r"manifest\.json: damaged \(its config does not give"):
        load_manifest(tmp_path)
