"""`simnfnd make [KEY=VALUE ...]`, a dataset or with `-m` a sweep; `simnfnd demo`, both profiles."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

from ...common.extras import install_command
from ...common.workers import template
from ...simulation.config.application import run_app
from ...simulation.config.hydra_loader import config_folder_words
from ..cli import PRELOADED

_LOCAL = ("scheduler=local", "scheduler=paper48", "scheduler.backend=local")
# Words that say nothing of the profile: with others, one dataset is what was asked for.
_OF_BOTH = ("render", "scenes.", "frames.", "scheduler", "seed=", "cache.", "dataset.dir=")
_FOLDER = "dataset.dir="


def main(words: Sequence[str]) -> int:
    """Make what the configuration says; returns the exit code, 1 when some frames failed."""
    # Libraries read these when they are first imported; a pool of workers must not multiply them.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")

    if _makes_here(words):
        # Now, so that it loads beside what this process has to load.
        template.start(PRELOADED)

    from ...simulation.config.root import FactoryConfig
    from ..cli.generate import generate

    return run_app(generate, "factory", words, FactoryConfig)


def _makes_here(words: Sequence[str]) -> bool:
    """Whether processes of this machine will make pairs; a wrong guess costs a second."""
    elsewhere = ("scheduler=", "scheduler.backend=", "hydra/launcher=", "--", "-h", "-c", "-i")
    return not any(
        word.startswith(elsewhere) and word not in _LOCAL and word != "--multirun" for word in words
    )


def demo(words: Sequence[str]) -> int:
    """Make the paper's points, then the sonar equation; the exit code of the first that failed.

    An install of the core alone makes the points, and says what the others need.
    """
    code = main(["experiment=demo", *words])
    if code or not all(word.startswith(_OF_BOTH) for word in words):
        return code
    if find_spec("scipy") is None:
        print(f"the images of the sonar equation, too: {install_command('sonar')}")
        return 0
    folders = [word.removeprefix(_FOLDER) for word in words if word.startswith(_FOLDER)]
    points = folders[-1] if folders else "outputs/demo"
    physical = f"{points.rstrip('/')}-physical"
    shared = [word for word in words if not word.startswith(_FOLDER)]
    # Hydra composes once a process.
    again = ["make", *config_folder_words(), "experiment=demo_physical", *shared]
    again.append(f"{_FOLDER}{physical}")
    if code := subprocess.run([sys.executable, "-m", "simnfnd", *again], check=False).returncode:
        return code

    from ...dataset.preview import side_by_side

    figure = Path(f"{points.rstrip('/')}-profiles.png")
    both = [("pointwise", Path(points)), ("coherent", Path(physical))]
    side_by_side(both, figure, frames=4, whole=True)
    print(f"both, side by side: {figure}")
    return 0
