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

# What is absent or broken is told by the task that needs it.
with suppress(Exception):
    import simnfnd.factory.jobs.worker
    import simnfnd.factory.pairs
    import simnfnd.factory.renders.views  # noqa: F401
    from simnfnd.factory.loops import compile_all

    compile_all()

gc.freeze()
gc.enable()
