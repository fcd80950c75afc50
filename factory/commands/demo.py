"""`simnfnd demo`: the same procedural frames by both profiles, and a picture of both."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from . import make

# Words that say nothing of the profile: with others, one dataset is what was asked for.
_OF_BOTH = ("render", "scenes.", "scheduler", "seed=", "dataset.dir=")
_FOLDER = "dataset.dir="


def main(words: Sequence[str]) -> int:
    """Make the paper's points, then the sonar equation; the exit code of the first that failed."""
    code = make.main(["experiment=demo", *words])
    if code or not all(word.startswith(_OF_BOTH) for word in words):
        return code
    given = [word.removeprefix(_FOLDER) for word in words if word.startswith(_FOLDER)]
    points = given[-1] if given else "outputs/demo"
    physical = f"{points.rstrip('/')}-physical"
    shared = [word for word in words if not word.startswith(_FOLDER)]
    # Hydra composes once a process.
    again = ["make", "experiment=demo_physical", *shared, f"{_FOLDER}{physical}"]
    if code := subprocess.run([sys.executable, "-m", "simnfnd", *again], check=False).returncode:
        return code

    from ..dataset.preview import side_by_side

    picture = Path(f"{points.rstrip('/')}-profiles.png")
    side_by_side({"points": Path(points), "sonar equation": Path(physical)}, picture)
    print(f"both, side by side: {picture}")
    return 0
