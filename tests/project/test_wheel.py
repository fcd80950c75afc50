"""The wheel, away from the checkout: it holds what it must, and works beside other packages."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from tests.project_files import PACKAGES, ROOT, files

pytestmark = pytest.mark.slow
SUFFIXES = {".py", ".yaml", ".css", ".js", ".html", ".safetensors", ".typed"}


def checked(words: list[str], cwd: Path, **environment: str) -> str:
    """Run, and return what was printed; fail with all of it otherwise."""
    done = subprocess.run(
        words,
        cwd=cwd,
        env={**os.environ, **environment},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
        timeout=300,
    )
    assert done.returncode == 0, f"{words} ended with {done.returncode}:\n{done.stdout[-4000:]}"
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Built from a copy in which the links are text files, as in a zip of the repository.

    So the checkout gets no build folder, and lends nothing that is ignored.
    """
    source = tmp_path_factory.mktemp("source")
    for path in files():
        (source / path).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(ROOT / path, source / path)
    for link in (ROOT / "simnfnd").iterdir():
        if link.is_symlink():  # to the rooms
            (source / "simnfnd" / link.name).write_text(str(link.readlink()), encoding="ascii")
    target = tmp_path_factory.mktemp("wheel")
    checked(
        [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(target), "."],
        cwd=source,
    )
    (built,) = target.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    target = tmp_path_factory.mktemp("site")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(target)
    # Loops that the checkout has compiled serve the copy, too, if it looks as old: half a minute.
    for remaining in (ROOT / "factory").rglob("__pycache__/*.nb[ic]"):
        copy = target / "simnfnd" / remaining.relative_to(ROOT)
        copy.parent.mkdir(exist_ok=True)
        shutil.copy(remaining, copy)
        module = f"{remaining.name.split('.')[0]}.py"
        stat = (remaining.parents[1] / module).stat()
        os.utime(copy.parents[1] / module, ns=(stat.st_atime_ns, stat.st_mtime_ns))
    return target


def test_wheel_holds_every_module_and_every_configuration_file(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = {name for name in archive.namelist() if ".dist-info/" not in name}
        metadata = next(n for n in archive.namelist() if n.endswith(".dist-info/METADATA"))
        text = archive.read(metadata).decode()
        scripts = archive.read(metadata.replace("METADATA", "entry_points.txt")).decode()
    wanted = {
        path.as_posix() if path.parts[0] == "simnfnd" else f"simnfnd/{path.as_posix()}"
        for path in files()
        if path.parts[0] in (*PACKAGES, "simnfnd") and path.suffix in SUFFIXES
    }
    assert wanted - names == set()
    assert {Path(name).suffix for name in wanted} == SUFFIXES
    assert {name.split("/")[0] for name in names} == {"simnfnd"}
    assert "License-Expression: Apache-2.0" in text
    assert "Requires-Python: >=3.11" in text
    assert "[console_scripts]\nsimnfnd = simnfnd.__main__:main\n" in scripts


def test_a_dataset_is_made_and_read_beside_other_packages(installed: Path, tmp_path: Path) -> None:
    """Workers, too, import ours and not the packages of the working directory."""
    for name in ("factory", "models", "evaluation", "conf"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text("raise ImportError('not ours')\n")
    words = [sys.executable, "-m", "simnfnd", "make", "render=analytic", "scenes.locations=2"]
    words += ["scenes.frames_per_location=1", "scenes.width=242", "scenes.height=152"]
    words += ["dataset.dir=made", "scheduler.workers=2"]
    said = checked(words, tmp_path, PYTHONPATH=str(installed))
    assert said.splitlines()[-1].startswith("dataset: ")
    assert (tmp_path / "made" / "preview.png").is_file()
    code = (
        "import simnfnd.models as room; print(room.__file__)\n"
        "from simnfnd import PairDataset\n"
        "with PairDataset('made', 'all') as pairs: print(pairs[0]['noisy'].shape)\n"
    )
    said = checked([sys.executable, "-c", code], tmp_path, PYTHONPATH=str(installed))
    place, shape = said.split("\n", 1)
    assert Path(place).is_relative_to(installed)
    assert shape.strip() == "(256, 256)"
