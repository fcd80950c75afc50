"""How long the commands of the README, the tutorials and the how-to pages take at full size.

python -m tests.project.page_times [PAGE ...]

Runs each in an empty folder and prints the time that the page states, the one measured and the CPU
seconds of all processes.  Wall seconds count on a machine that does nothing else.
"""

from __future__ import annotations

import os
import resource
import shutil
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

from tests.project import page_tables, readme_steps
from tests.project.readme_steps import Run
from tests.project.test_readme import PAGES
from tests.project_files import ROOT

TIMEOUT_S = 3600.0


def main(pages: list[str]) -> int:
    """Measure, print a line a command, and return 1 if any is off by more than a factor of two."""
    off = 0
    with tempfile.TemporaryDirectory(prefix="simnfnd-pages-") as name:
        folder = Path(name)
        os.environ["SIMNFND_CACHE"] = str(folder / "cache")
        # As on a new machine: the first command compiles the loops.
        os.environ["NUMBA_CACHE_DIR"] = str(folder / "numba")
        shutil.copytree(ROOT / "examples", folder / "examples")
        for page in pages or list(PAGES):
            text = (ROOT / page).read_text(encoding="utf-8")
            for step in readme_steps.steps(text, page):
                how = {**page_tables.PAGES.get(page, {}), **PAGES[page]}.get(step.key, Run())
                if not isinstance(how, Run) or readme_steps.missing(how, folder):
                    continue
                # Full size: only what says where things lie stays.
                places = tuple(one for one in how.instead if "/" in one[0] + one[1])
                extra = tuple(word for word in how.extra if "{sandbox}" in word)
                begun, before = time.monotonic(), _cpu_s()
                done = readme_steps.run(
                    step, replace(how, extra=extra, instead=places), folder, TIMEOUT_S
                )
                wall_s, cpu_s = time.monotonic() - begun, _cpu_s() - before
                stated = f"{step.time_s:.0f}" if step.time_s else "-"
                wrong = step.time_s and not 0.5 <= wall_s / step.time_s <= 2
                off += bool(wrong or done.returncode)
                print(
                    f"{page}:{step.line}: stated {stated} s, took {wall_s:.1f} s, "
                    f"CPU {cpu_s:.1f} s, exit code {done.returncode}: {step.key[:70]}",
                    flush=True,
                )
    return int(off > 0)


def _cpu_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
