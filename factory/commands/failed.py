"""`simnfnd failed DIR`: the frames that gave no sample, why, and another try."""

from __future__ import annotations

import shlex
import subprocess
import sys
from pathlib import Path

from simnfnd.factory.cli import Parser
from simnfnd.factory.dataset.format.manifest import load_manifest
from simnfnd.factory.dataset.write.failures import load_failures
from simnfnd.factory.errors import FactoryError


def main(words: list[str]) -> int:
    """List the failures, or try them again; returns 0 when there are none (any more), else 1."""
    parser = Parser(prog="simnfnd failed")
    parser.add_argument("dir", type=Path, help="folder of a dataset")
    parser.add_argument(
        "--rerun", action="store_true", help="try each frame by itself, in a folder DIR-retry"
    )
    given = parser.parse_args(words)
    failures = load_failures(given.dir)
    if load_manifest(given.dir) is None and not failures:
        raise FactoryError(f"{given.dir}: no dataset here (no manifest.json)")
    if not failures:
        print(f"{given.dir}: no frame failed")
        return 0
    if not given.rerun:
        for item in failures:
            print(f"{item['kind']}: {item['reason']}\n  {item['command']}")
        print(f"{len(failures)} frames failed; running the dataset's command again tries them, too")
        return 1
    cured = sum(_works(item) for item in failures)
    print(f"{cured} of {len(failures)} frames work now", end="")
    print("; run the dataset's command again to take them in" if cured else "")
    return 0 if cured == len(failures) else 1


def _works(item: dict[str, str]) -> bool:
    """Run the command of one failure, in this environment."""
    words = shlex.split(item["command"])
    command = [sys.executable, "-m", *words, "dataset.on_existing=overwrite"]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    worked = done.returncode == 0
    last = (done.stderr.strip().splitlines() or [""])[-1]
    print(f"{item['frame']}: {'works' if worked else last}")
    return worked
