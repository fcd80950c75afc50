"""Denoising needs nothing that only POSIX systems have, and no link."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.models.adapt.scenes import noisy, scene, write
from tests.project_files import ROOT
from tests.small_dataset import write_dataset

SITE = """
import os, signal, sys
for name in ("fcntl", "grp", "pwd", "resource", "termios"):
    sys.modules[name] = None
for name in ("O_NONBLOCK", "fork", "forkpty", "getuid", "register_at_fork"):
    delattr(os, name)
for name in ("SIGALRM", "alarm", "pthread_kill", "setitimer"):
    delattr(signal, name)
def symlink(*given, **named):
    raise OSError("a required privilege is not held by the client")
os.symlink = os.link = symlink
"""
SCRIPT = """
import json, sys
import numpy as np
import simnfnd
from simnfnd.command import main
codes = []
for number, name in enumerate(sys.argv[1:]):
    codes.append(main(["denoise", name, "--out", f"out/{number}"]))
image, removed = simnfnd.denoise(np.full((64, 64), 0.5), return_removed=True)
loaded = [name for name in ("bpy", "hydra", "pydantic", "torch") if name in sys.modules]
print(json.dumps([codes, image.shape, loaded]))
"""


@pytest.fixture
def inputs(tmp_path: Path) -> list[str]:
    """An image, a folder of them, an array, and a shard, which is read in another process."""
    for number in range(4):
        write(tmp_path / "images" / f"{number}.png", noisy(scene(0), number))
    np.save(tmp_path / "stack.npy", np.stack([noisy(scene(0), n) for n in range(2)]))
    write_dataset(tmp_path / "data", train=0, test=1)
    return ["images/0.png", "images", "stack.npy", "data"]


@pytest.mark.slow
def test_denoising_works_without_what_windows_lacks(tmp_path: Path, inputs: list[str]) -> None:
    (tmp_path / "site").mkdir()
    (tmp_path / "site" / "sitecustomize.py").write_text(SITE, encoding="ascii")
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", SCRIPT, *inputs],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path / "site"), str(ROOT)])},
        capture_output=True,
        text=True,
        check=False,
        timeout=200,
    )
    assert done.returncode == 0, done.stderr
    codes, shape, loaded = json.loads(done.stdout.splitlines()[-1])
    assert codes == [0] * len(inputs), done.stderr
    assert shape == [64, 64]
    assert "torch" not in loaded
    assert "bpy" not in loaded
    written = {path.relative_to(tmp_path / "out").as_posix() for path in tmp_path.rglob("out/*/*")}
    assert {"0/0.png", "1/0.png", "2/stack.npy", "3/test"} <= written
