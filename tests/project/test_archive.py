"""A zip of the repository, in which links are text files, imports and is a torch hub repository."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from tests.project_files import ROOT

SCRIPT = """
import json, sys
import numpy as np, torch
import simnfnd
from simnfnd.factory.common.errors import FactoryError
denoiser = torch.hub.load(sys.argv[1], "denoiser", source="local")
image = torch.rand(2, 1, 40, 56)
told = {
    "errors": sys.modules["simnfnd.factory.common.errors"].__file__,
    "same": simnfnd.FactoryError is FactoryError,
    "module": isinstance(denoiser, torch.nn.Module),
    "shape": list(denoiser(image).shape),
}
print(json.dumps(told))
"""


def git(*words: str) -> str:
    done = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True)
    return done.stdout.strip()


@pytest.fixture(scope="module")
def unpacked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `git archive` makes of the working tree, unpacked as Windows does it."""
    folder = tmp_path_factory.mktemp("archive")
    changed = git("stash", "create")
    git("archive", "--format=zip", "-o", str(folder / "archive.zip"), changed or "HEAD")
    with zipfile.ZipFile(folder / "archive.zip") as archive:
        archive.extractall(folder / "simnfnd-main")
    return folder / "simnfnd-main"


def run(script: str, root: Path, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", script, str(root)],
        cwd=cwd,
        env={**os.environ, "PYTHONPATH": str(root)},
        capture_output=True,
        text=True,
        check=False,
        timeout=200,
    )


@pytest.mark.slow
def test_an_unpacked_zip_imports_and_is_a_repository_of_torch_hub(
    unpacked: Path, tmp_path: Path
) -> None:
    assert (unpacked / "simnfnd" / "factory").is_file(), "the link is a text file"
    done = run(SCRIPT, unpacked, tmp_path)
    assert done.returncode == 0, done.stderr
    message = json.loads(done.stdout.splitlines()[-1])
    assert Path(message["errors"]).is_relative_to(unpacked)
    assert message["same"] is message["module"] is True
    assert message["shape"] == [2, 1, 40, 56]


NAMES = ("factory.errors", "models.settings", "evaluation.commands")
IMPORTS = f"""
import importlib
for name in {NAMES!r}:
    try:
        importlib.import_module(name)
    except ImportError as error:
        print(error)
"""


@pytest.mark.parametrize("archived", [False, True])
def test_no_module_is_imported_under_two_names(
    archived: bool, unpacked: Path, tmp_path: Path
) -> None:
    done = run(IMPORTS, unpacked if archived else ROOT, tmp_path)
    assert done.stdout.splitlines() == [f"{name}: import simnfnd.{name} instead" for name in NAMES]
