"""The scripts of `make setup`, on machines made of fake commands."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

from tests.project_files import ROOT

BASH = shutil.which("bash") or "bash"
LIBRARIES = [
    *("libx11-6", "libxrender1", "libxfixes3", "libxi6", "libxkbcommon0", "libsm6", "libgl1"),
    *("libegl1", "libusb-1.0-0"),
]

Machine = Callable[[Mapping[str, str]], Path]
Said = subprocess.CompletedProcess[str]


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    """Build a folder of commands: name -> shell body; it is the whole PATH of the script."""

    def build(commands: Mapping[str, str]) -> Path:
        folder = tmp_path / "bin"
        folder.mkdir()
        for tool in ("dirname", "grep", "bash", "cat"):
            (folder / tool).symlink_to(shutil.which(tool) or tool)
        for name, body in commands.items():
            (folder / name).write_text(f"#!{BASH}\n{body}\n", encoding="utf-8")
            (folder / name).chmod(0o755)
        return folder

    return build


def run(script: str, path: Path, *words: str, **variables: str) -> Said:
    environment = {"PATH": str(path), "VENV": str(path / "no-venv"), **variables}
    return subprocess.run(
        [BASH, str(ROOT / "tools" / script), *words],
        env=environment,
        cwd=path,
        capture_output=True,
        text=True,
        check=False,
    )


def dpkg(*installed: str) -> str:
    """A dpkg-query that knows these packages; the last argument is the name asked for."""
    known = " ".join(installed)
    return f'for p in {known}; do [[ ${{@: -1}} == "$p" ]] && echo installed && exit; done; exit 1'


PYTHON = f'exec "{sys.executable}" "$@"'
LOG = 'echo "apt-get $*" >> "${0%/*}/log"'


def test_without_root_the_exact_line_is_printed(machine: Machine) -> None:
    present = [name for name in LIBRARIES if name not in ("libgl1", "libusb-1.0-0")]
    path = machine(
        {"dpkg-query": dpkg(*present), "apt-get": LOG, "id": "echo 1000", "python3.11": PYTHON}
    )
    said = run("debian_packages.sh", path)
    assert said.returncode == 2
    line = "    sudo apt-get install -y --no-install-recommends libgl1 libusb-1.0-0"
    assert said.stderr.splitlines()[1] == line
    assert not (path / "log").exists()


def test_root_installs_after_an_update(machine: Machine) -> None:
    path = machine({"dpkg-query": dpkg(), "apt-get": LOG, "id": "echo 0", "python3.11": PYTHON})
    assert run("debian_packages.sh", path).returncode == 0
    assert run("debian_packages.sh", path, "tests").returncode == 0
    update, install, _, more = (path / "log").read_text(encoding="utf-8").splitlines()
    assert update.startswith("apt-get update")
    assert install.split()[-len(LIBRARIES) :] == LIBRARIES
    assert "chromium" not in install
    assert "chromium" in more, "for the test of the report"


def test_no_python_311_is_one_clear_line(machine: Machine) -> None:
    said = run("find_python.sh", machine({"python3": "exit 1"}))
    assert said.returncode == 2
    assert said.stderr.count("\n") == 1
    assert "PYTHON311=" in said.stderr
