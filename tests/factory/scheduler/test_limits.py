"""`ulimit`: as many workers as fit, and a line that says so."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import psutil
import pytest
import yaml

from simnfnd.factory.cli import guard
from simnfnd.factory.scheduler.settings import SchedulerSettings
from tests.project_files import ROOT

CODE = """
import resource, sys
from pathlib import Path
from simnfnd.factory.cli import guard
from tests.run_fake import make
if __name__ == "__main__":
    limit, folder = int(sys.argv[1]), Path(sys.argv[2])
    resource.setrlimit(resource.RLIMIT_NOFILE, (limit, limit))
    print(guard(lambda: print(make(folder, workers=48).samples)))
"""


@pytest.mark.parametrize(
    ("limit", "said", "told"),
    [
        (64, r"ulimit -n is 64: [12] of 4 workers fit and are used; raise it", "32\n0\n"),
        (40, r"error: scheduler.workers: ulimit -n is 40, in which no worker fits", "2\n"),
    ],
)
def test_a_shell_with_few_open_files(tmp_path: Path, limit: int, said: str, told: str) -> None:
    script = tmp_path / "run.py"
    script.write_text(CODE)
    done = subprocess.run(
        [sys.executable, str(script), str(limit), str(tmp_path / "dataset")],
        cwd=ROOT, capture_output=True, text=True, env={**os.environ, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert re.search(said, done.stderr)
    assert "Traceback" not in done.stderr
    assert done.stdout == told


@pytest.mark.parametrize("which", ["n", "v"])
def test_the_papers_48_processes_in_a_narrow_shell(
    monkeypatch: pytest.MonkeyPatch, which: str
) -> None:
    import resource

    kinds = {"n": resource.RLIMIT_NOFILE, "v": resource.RLIMIT_AS}
    most = {"n": 256, "v": psutil.Process().memory_info().vms + (3 << 30)}[which]
    monkeypatch.setattr(
        resource, "getrlimit", lambda kind: (most, most) if kind == kinds[which] else (-1, -1)
    )
    values = yaml.safe_load((ROOT / "conf/scheduler/paper48.yaml").read_text())
    del values["defaults"]
    settings = SchedulerSettings(**values)
    crew = settings.crew(480, 480)
    assert crew.total == 48
    found, note = settings.within_limits(crew)
    assert 4 < found.total < 40
    shown = most if which == "n" else most // 1024
    assert note.startswith(
        f"ulimit -{which} is {shown}: {found.total} of 48 workers fit and are used; raise it"
    )


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (PermissionError(13, "Permission denied", "a/train"), "error: a/train: Permission denied"),
        (OSError(24, "Too many open files"), "error: system: Too many open files; raise"),
        (OSError(40, "Too many levels of symbolic links", "a"), "error: a: Too many levels"),
        (MemoryError(), "error: memory: not enough of it"),
    ],
)
def test_what_the_machine_refuses_is_one_line(
    error: BaseException, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    def action() -> None:
        raise error

    assert guard(action) == 2
    told = capsys.readouterr().err
    assert told.startswith(said)
    assert told.count("\n") == 1
    with pytest.raises(type(error)):
        guard(action, debug=True)
