"""`python -m factory`: make datasets, and look at them.

python -m factory [GROUP=NAME ...] [KEY=VALUE ...]      make a dataset
python -m factory -m KEY=A,B ...                        make one for every combination
python -m factory plan [-m] ...                         what that would make and cost; makes nothing
python -m factory status DIR                            how far it is, and who works on it
python -m factory failed DIR [--rerun]                  frames that gave no sample, and why
python -m factory cache stats|verify|clear|pack ...     the renders that are kept on disk
python -m factory preview DIR [--out FILE] [--pairs N]  contact sheet of a dataset
python -m factory inspect DIR|FILE [--png FILE]         what is in a dataset or shard
python -m factory validate DIR [--deep]                 is a dataset whole and consistent
python -m factory gallery [--out DIR]                   the paper's figures, from procedural scenes
python -m factory physics [--out DIR]                   devices and effects of the physical profile
python -m factory merge A B ... --out DIR               several datasets into one
python -m factory export DIR --to FORMAT --out DIR      for WebDataset, Hugging Face, PNG, ...
python -m factory --help | --cfg job                    every group and key; VERB --help for a verb
"""

from __future__ import annotations

import os
import sys
from importlib import import_module

# First word -> "module:function"; the function gets the other words and may return an exit code.
VERBS = {
    "plan": "factory.commands.plan:main",
    "status": "factory.commands.status:main",
    "failed": "factory.commands.failed:main",
    "cache": "factory.commands.cache:main",
    "preview": "factory.commands.preview:main",
    "inspect": "factory.commands.inspect:main",
    "validate": "factory.commands.validate:main",
    "gallery": "factory.commands.gallery:main",
    "physics": "factory.commands.physics:main",
    "merge": "factory.commands.merge:main",
    "export": "factory.commands.export:main",
}


def main() -> None:
    """Entry point of `python -m factory` and `fls-factory`.

    Exits with 0, 1 (some frames failed), 2 (bad input) or 130/143 (interrupted).
    """
    from factory.cli import guard, run_app

    words = sys.argv[1:]
    if words and words[0] in VERBS:
        module, function = VERBS[words[0]].split(":")
        sys.exit(guard(lambda: getattr(import_module(module), function)(words[1:])))

    from factory.distribution import as_override
    from factory.generate import generate

    # Hydra's parser refuses a flag between overrides; people write it where they like.
    flags = [word for word in words if word in ("-m", "--multirun")]
    sys.argv[1:] = flags + [as_override(word) for word in words if word not in flags]
    sys.exit(run_app(generate, "factory"))


if __name__ == "__main__":
    # Libraries read these when they are first imported; a pool of workers must not multiply them.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    main()
