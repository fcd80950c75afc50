"""All that a worker of `make` needs, imported once in the process that workers are forked from."""

from __future__ import annotations

import gc
import sys
from contextlib import suppress

# A module of the user's, in the folder where the command is given, is none of ours.
sys.path[:] = [folder for folder in sys.path if folder]

# What is loaded stays: to look through it for what could go costs an eighth of loading it, and a
# fork that looks through it copies it.
gc.disable()

# A missing or broken module is reported by the task that needs it.
with suppress(Exception):
    from ...simulation.pairs import pair_maker as pairs  # noqa: F401
    from ...simulation.pairs.compilation import load_compiled
    from ..scheduler import worker  # noqa: F401

    load_compiled()

gc.freeze()
gc.enable()
