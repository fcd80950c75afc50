"""`python -m factory`: make datasets, and look at them.

python -m factory [GROUP=NAME ...] [KEY=VALUE ...]      make a dataset
python -m factory -m KEY=A,B ...                        make one for every combination
python -m factory preview DIR [--out FILE] [--pairs N]  contact sheet of a dataset
python -m factory --help | --cfg job                    every group and key
"""

from __future__ import annotations

import argparse
import os
import sys


def main() -> None:
    """Entry point of `python -m factory` and `fls-factory`.

    Exits with 0, 1 (some frames failed), 2 (bad input) or 130/143 (interrupted).
    """
    from factory.cli import guard, run_app

    words = sys.argv[1:]
    if words and words[0] == "preview":
        sys.exit(guard(lambda: _preview(words[1:])))

    from factory.distribution import as_override
    from factory.generate import generate

    sys.argv[1:] = [as_override(word) for word in words]
    sys.exit(run_app(generate, "factory"))


def _preview(words: list[str]) -> None:
    from pathlib import Path

    from factory.shards.preview import preview

    parser = argparse.ArgumentParser(prog="python -m factory preview")
    parser.add_argument("dir", type=Path, help="folder of a dataset")
    parser.add_argument("--out", type=Path, help="picture to write (default: DIR/preview.png)")
    parser.add_argument("--pairs", type=int, default=8, help="pairs to show")
    given = parser.parse_args(words)
    print(f"preview: {preview(given.dir, out=given.out, pairs=given.pairs)}")


if __name__ == "__main__":
    # Libraries read these when they are first imported; a pool of workers must not multiply them.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    main()
