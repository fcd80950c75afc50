"""`python -m evaluation`: how good are the images of a dataset, and of methods that denoise them?

python -m evaluation dataset=DIR [KEY=VALUE ...]        the report on a dataset's pairs
python -m evaluation tune dataset=DIR ...               best parameters of the baselines first
python -m evaluation compare A B                        is one report's row better than another's
python -m evaluation campaign FOLDER                    the table of `python -m models.campaign`
python -m evaluation realism REAL SIM [SIM ...]         how near datasets are to real pictures
python -m evaluation real IN                            what methods make of pictures without truth
python -m evaluation fit REAL                           noise parameters nearest to real pictures
python -m evaluation --help | --cfg job                 every key; VERB --help for a verb
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module

from factory.cli import guard

VERBS = {
    "": "evaluation.command:report",
    "tune": "evaluation.command:tune",
    "campaign": "evaluation.campaign:campaign",
    "compare": "evaluation.compare:main",
    "realism": "evaluation.realism.command:realism",
    "real": "evaluation.real.command:real",
    "fit": "evaluation.fit:fit",
}
"""First word -> "module:function".  The function gets the other words and returns an exit code.

A verb with a configuration of its own calls `evaluation.app.hydra_verb(task, CONFIG, words)`.
"""


def run(words: Sequence[str]) -> int:
    """Run the verb that `words` begin with, the report when there is none; returns the exit code.

    0, 2 for bad input, 130 when interrupted.
    """
    verb = words[0] if words and words[0] in VERBS else ""
    module, function = VERBS[verb].split(":")
    rest = list(words[1:] if verb else words)
    debug = "debug=true" in rest
    return guard(lambda: getattr(import_module(module), function)(rest), debug=debug)


def main() -> None:
    """Entry point of `fls-evaluation`."""
    sys.exit(run(sys.argv[1:]))


if __name__ == "__main__":
    main()
