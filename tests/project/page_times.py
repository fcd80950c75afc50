"""How long the commands of the README, the tutorials and the how-to pages take at full size.

python -m tests.project.page_times [PAGE ...]

Runs each in an empty folder and prints the time that the page states, the one measured and the CPU
seconds of all processes.  Wall seconds count on a machine that does nothing else.
"""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from tests.project.page_steps import PAGES, steps
from tests.project.test_pages import NOT_HERE
from tests.project_files import ROOT


def main(pages: list[str]) -> int:
    """Measure, print a line a command, and return 1 if any is off by more than a factor of two."""
    off = 0
    with tempfile.TemporaryDirectory(prefix="simnfnd-pages-") as name:
        folder = Path(name)
        bin_ = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
        # As on a new machine: the first command compiles the loops.
        own = {"SIMNFND_CACHE": name + "/cache", "NUMBA_CACHE_DIR": name + "/numba", "PATH": bin_}
        shutil.copytree(ROOT / "examples", folder / "examples")
        for step in (one for page in PAGES for one in steps(page)):
            page = step.page.relative_to(ROOT).as_posix()
            if (pages and page not in pages) or step.text.startswith(NOT_HERE[:2] + NOT_HERE[3:]):
                continue
            text = step.text.replace("make demo", "simnfnd demo").replace(".venv/bin/", "")
            program = ["bash", "-euc"] if step.kind == "sh" else [sys.executable, "-c"]
            begun, before = time.monotonic(), _cpu_s()
            done = subprocess.run([*program, text], cwd=folder, env={**os.environ, **own})
            wall_s, cpu_s = time.monotonic() - begun, _cpu_s() - before
            wrong = step.time_s and not 0.5 <= wall_s / step.time_s <= 2
            off += bool(wrong or done.returncode)
            print(
                f"{page}:{step.line}: stated {step.time_s} s, took {wall_s:.1f} s, "
                f"CPU {cpu_s:.1f} s, exit code {done.returncode}: {text[:70]}",
                flush=True,
            )
    return int(off > 0)


def _cpu_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
