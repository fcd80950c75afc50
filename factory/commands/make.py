"""`simnfnd make [GROUP=NAME ...] [KEY=VALUE ...]`: a dataset; `-m` one for every combination."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence

from ..cli import PRELOADED, run_app
from ..scheduler.workers import template

_LOCAL = ("scheduler=local", "scheduler=paper48", "scheduler.backend=local")


def main(words: Sequence[str]) -> int:
    """Make what the configuration says; returns the exit code, 1 when some frames failed."""
    # Libraries read these when they are first imported; a pool of workers must not multiply them.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")

    if _makes_here(words):
        # Now, so that it loads beside what this process has to load.
        template.start(PRELOADED)

    from ..cli.generate import generate
    from ..distribution import as_override

    # Hydra's parser refuses a flag between overrides; people write it where they like.
    flags = [word for word in words if word in ("-m", "--multirun")]
    sys.argv[1:] = flags + [as_override(word) for word in words if word not in flags]
    return run_app(generate, "factory")


def _makes_here(words: Sequence[str]) -> bool:
    """Whether processes of this machine will make pairs; a wrong guess costs a second."""
    elsewhere = ("scheduler=", "scheduler.backend=", "hydra/launcher=", "--", "-h", "-c", "-i")
    return not any(
        word.startswith(elsewhere) and word not in _LOCAL and word != "--multirun" for word in words
    )
