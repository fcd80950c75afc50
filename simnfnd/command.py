"""The verbs of `simnfnd`, and how one is found and run.

Nothing heavy is imported before the verb is known: `simnfnd --help` must answer at once.
"""

from __future__ import annotations

import difflib
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module


@dataclass(frozen=True)
class Verb:
    """One word of the command line.

    group, line: where and how `simnfnd --help` lists it.
    target: "module:function"; the function gets the other words and may return an exit code.
    before: words put before those of the user.
    """

    group: str
    line: str
    target: str
    before: tuple[str, ...] = ()


_MAKE, _LOOK, _PASS, _DENOISE, _JUDGE = (
    "Make datasets",
    "Look at datasets",
    "Pass datasets on",
    "Denoise",
    "Judge",
)
_COMMANDS = "simnfnd.factory.commands"

VERBS: dict[str, Verb] = {
    "demo": Verb(_MAKE, "a small dataset from nothing, with a preview of it",
                 f"{_COMMANDS}.make:main", ("experiment=demo",)),
    "make": Verb(_MAKE, "a dataset as the configuration says; -m for a sweep",
                 f"{_COMMANDS}.make:main"),
    "plan": Verb(_MAKE, "what `make` would make and what it would cost",
                 f"{_COMMANDS}.plan:main"),
    "cache": Verb(_MAKE, "the renders that are kept on disk: stats, verify, clear, pack",
                  f"{_COMMANDS}.cache:main"),
    "status": Verb(_LOOK, "how far a dataset is, and who works on it",
                   f"{_COMMANDS}.status:main"),
    "failed": Verb(_LOOK, "the frames that gave no sample, and why",
                   f"{_COMMANDS}.failed:main"),
    "preview": Verb(_LOOK, "contact sheet of a dataset", f"{_COMMANDS}.preview:main"),
    "inspect": Verb(_LOOK, "what is in a dataset or shard", f"{_COMMANDS}.inspect:main"),
    "validate": Verb(_LOOK, "is a dataset whole and consistent", f"{_COMMANDS}.validate:main"),
    "gallery": Verb(_LOOK, "the paper's figures, from procedural scenes",
                    f"{_COMMANDS}.gallery:main"),
    "physics": Verb(_LOOK, "devices and effects of the physical profile",
                    f"{_COMMANDS}.physics:main"),
    "geometry": Verb(_LOOK, "where range and bearing lie in fan pictures",
                     f"{_COMMANDS}.geometry:main"),
    "merge": Verb(_PASS, "several datasets into one", f"{_COMMANDS}.merge:main"),
    "export": Verb(_PASS, "a dataset as WebDataset, Hugging Face, PNG, MDD or sonar messages",
                   f"{_COMMANDS}.export:main"),
    "train": Verb(_DENOISE, "a denoiser on a dataset", "simnfnd.models.training.command:main"),
    "denoise": Verb(_DENOISE, "images, folders, datasets and videos",
                    "simnfnd.models.denoise.command:main"),
    "export-weights": Verb(_DENOISE, "trained weights in 16 bits, with a model card",
                           "simnfnd.models.pretrained.export:main"),
    "evaluate": Verb(_JUDGE, "the report on a dataset; or tune, compare, real, realism, fit",
                     "simnfnd.evaluation.command:main"),
    "campaign": Verb(_JUDGE, "train and compare many networks; `campaign table` shows the result",
                     "simnfnd.evaluation.campaign.command:main"),
}  # fmt: skip


def main(words: Sequence[str] | None = None, default: str | None = None) -> int:
    """Run the verb that `words` (default: the command line) begin with; returns the exit code.

    default: the verb that is meant where the first word is none.
    0, 1 (some frames failed), 2 (bad input) or 130/143 (interrupted).
    """
    from simnfnd.factory.cli import guard, say_error
    from simnfnd.factory.errors import FactoryError

    given = list(sys.argv[1:] if words is None else words)
    if default is not None and (not given or given[0] not in VERBS):
        given.insert(0, default)
    if not given or given[0] in ("-h", "--help", "help"):
        print(overview())
        return 0
    if given[0] == "--version":
        from simnfnd.factory import __version__

        print(f"simnfnd {__version__}")
        return 0
    verb = VERBS.get(given[0])
    if verb is None:
        return say_error(FactoryError(unknown(given[0])))
    module, function = verb.target.split(":")
    rest = [*verb.before, *given[1:]]
    debug = "debug=true" in rest
    return guard(lambda: getattr(import_module(module), function)(rest), debug=debug)


def overview() -> str:
    """What `simnfnd --help` prints."""
    lines = ["simnfnd VERB ...: sonar pictures with a known truth, and denoisers made of them", ""]
    for group in dict.fromkeys(verb.group for verb in VERBS.values()):
        lines.append(f"{group}:")
        lines += [
            f"  {name:<15} {verb.line}" for name, verb in VERBS.items() if verb.group == group
        ]
        lines.append("")
    lines.append("`simnfnd VERB --help` tells more about one; `simnfnd --version` the version.")
    return "\n".join(lines)


def unknown(word: str) -> str:
    """The one line for a word that is no verb."""
    if "=" in word:
        return f"{word}: a setting needs a verb before it; did you mean `simnfnd make {word}`?"
    near = difflib.get_close_matches(word, VERBS, n=3, cutoff=0.5)
    hint = f"did you mean {' or '.join(near)}?" if near else "see `simnfnd --help`"
    return f"{word}: no such verb; {hint}"
