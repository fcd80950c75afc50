"""The scripts of `make setup`, on machines made of fake commands."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

from tests.project_files import ROOT

BASH = shutil.which("bash") or "bash"
LIBRARIES = [
    *("libx11-6", "libxrender1", "libxfixes3", "libxi6", "libxkbcommon0", "libsm6", "libgl1"),
    *("libegl1", "libusb-1.0-0"),
]
COMMANDS = {
    "apt-get": 'echo "apt-get $*" >> "${0%/*}/log"',
    "python3.11": f'exec "{sys.executable}" "$@"',
}


def run(
    folder: Path, commands: dict[str, str], script: str, *words: str
) -> subprocess.CompletedProcess[str]:
    """Run a script of tools; `commands`, as name -> shell body, are all that is on its PATH."""
    for tool in ("dirname", "grep", "bash", "cat"):
        if not (folder / tool).exists():
            (folder / tool).symlink_to(shutil.which(tool) or tool)
    for name, body in commands.items():
        (folder / name).write_text(f"#!{BASH}\n{body}\n", encoding="utf-8")
        (folder / name).chmod(0o755)
    return subprocess.run(
        [BASH, str(ROOT / "tools" / script), *words],
        env={"PATH": str(folder), "VENV": str(folder / "no-venv")},
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )


def test_without_root_the_exact_line_is_printed(tmp_path: Path) -> None:
    present = " ".join(name for name in LIBRARIES if name not in ("libgl1", "libusb-1.0-0"))
    # The last argument is the name asked for.
    query = (
        f'for p in {present}; do [[ ${{@: -1}} == "$p" ]] && echo installed && exit; done; exit 1'
    )
    commands = {**COMMANDS, "dpkg-query": query, "id": "echo 1000"}
    said = run(tmp_path, commands, "debian_packages.sh")
    assert said.returncode == 2
    line = "    sudo apt-get install -y --no-install-recommends libgl1 libusb-1.0-0"
    assert said.stderr.splitlines()[1] == line
    assert not (tmp_path / "log").exists()


def test_root_installs_after_an_update(tmp_path: Path) -> None:
    commands = {**COMMANDS, "dpkg-query": "exit 1", "id": "echo 0"}
    assert run(tmp_path, commands, "debian_packages.sh").returncode == 0
    assert run(tmp_path, commands, "debian_packages.sh", "tests").returncode == 0
    update, install, _, more = (tmp_path / "log").read_text(encoding="utf-8").splitlines()
    assert update.startswith("apt-get update")
    assert install.split()[-len(LIBRARIES) :] == LIBRARIES
    assert "chromium" not in install
    assert "chromium" in more, "for the test of the report"


def test_no_python_311_is_one_clear_line(tmp_path: Path) -> None:
    said = run(tmp_path, {"python3": "exit 1"}, "find_python.sh")
    assert (said.returncode, said.stderr.count("\n")) == (2, 1)
    assert "PYTHON311=" in said.stderr
