"""The scripts of examples/, run as a stranger runs them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import venv
from pathlib import Path

import pytest

from tests.project_files import ROOT
from tests.small_dataset import write_dataset

EXAMPLES = ROOT / "examples"


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """24 pairs that train, in shards, with manifest and index."""
    from simnfnd.factory.dataset.format.manifest import Manifest, ShardInfo, save_manifest
    from simnfnd.factory.dataset.write.index import write_index
    from simnfnd.factory.files import sha256_of

    root = write_dataset(tmp_path_factory.mktemp("examples") / "data", train=24, test=4, size=48)
    manifest = Manifest("0123abcd", "tests")
    for path in sorted(root.glob("*/*.h5")):
        relative = path.relative_to(root).as_posix()
        info = ShardInfo(relative, relative.split("/")[0], 4, path.stat().st_size, sha256_of(path))
        manifest = manifest.with_shard(info)
    save_manifest(root, manifest)
    write_index(root, manifest)
    return root


def run(
    script: str, *words: str, python: str = sys.executable, cwd: Path
) -> subprocess.CompletedProcess[str]:
    environment = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    if python == sys.executable:
        environment["PYTHONPATH"] = str(ROOT)
    return subprocess.run(
        [python, str(EXAMPLES / script), *words],
        cwd=cwd,
        env=environment,
        capture_output=True,
        text=True,
        timeout=120,
    )


def test_h5py_alone_reads_index_and_shards(dataset: Path, tmp_path: Path) -> None:
    done = run("read_with_h5py.py", str(dataset), "100", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "index.h5: 100 of 24 pairs, 48 x 48" in done.stdout
    assert "shards: 100 pairs out of 6 files" in done.stdout
    psnr_db = float(done.stdout.split("mean PSNR ")[1].split()[0])
    assert 5 < psnr_db < 25


def test_h5py_alone_notices_a_missing_shard(dataset: Path, tmp_path: Path) -> None:
    document = json.loads((dataset / "manifest.json").read_text())
    (tmp_path / "manifest.json").write_text(json.dumps(document))
    done = run("read_with_h5py.py", str(tmp_path), cwd=tmp_path)
    assert done.returncode == 1
    assert "missing: test/shard-00000.h5" in done.stderr


@pytest.mark.slow
def test_an_environment_of_numpy_and_h5py_is_enough(dataset: Path, tmp_path: Path) -> None:
    """1000 random pairs from index.h5 and 1000 from the shards; nothing else is installed."""
    venv.create(tmp_path / "venv", with_pip=True)
    python = str(tmp_path / "venv" / "bin" / "python")
    pip = [python, "-m", "pip", "--disable-pip-version-check"]
    installed = subprocess.run(
        [*pip, "install", "--quiet", "-c", str(ROOT / "constraints.txt"), "numpy", "h5py"],
        capture_output=True,
        text=True,
    )
    if installed.returncode:
        pytest.skip(f"no package index here: {installed.stderr.strip()[-200:]}")
    listed = subprocess.run([*pip, "list", "--format=json"], capture_output=True, text=True)
    names = {item["name"] for item in json.loads(listed.stdout)}
    assert names - {"pip", "setuptools"} == {"numpy", "h5py"}
    done = run("read_with_h5py.py", str(dataset), python=python, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "index.h5: 1000 of 24 pairs" in done.stdout
    assert "shards: 1000 pairs" in done.stdout


def test_a_tiny_network_learns(dataset: Path, tmp_path: Path) -> None:
    done = run("train_a_tiny_network.py", str(dataset), "60", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    before, after = done.stdout.removeprefix("mean squared error ").split(" -> ")
    assert float(after) < 0.5 * float(before)


def test_workers_read_every_pair(dataset: Path, tmp_path: Path) -> None:
    done = run("load_with_workers.py", str(dataset), cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("24 of 24 pairs, ")


def test_every_example_is_tested() -> None:
    here = Path(__file__).read_text(encoding="utf-8")
    for path in EXAMPLES.glob("*.py"):
        assert f'"{path.name}"' in here, f"{path.name} is run by no test"
