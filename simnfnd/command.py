"""`simnfnd VERB ...`: finds the verb, says what is wrong with the words, and runs it."""

from __future__ import annotations

import difflib
import gc
import sys
from collections.abc import Iterator, Mapping, Sequence
from importlib import import_module
from itertools import pairwise

from .factory import __version__
from .factory.cli import guard
from .factory.cli.extras import EXTRAS, Need, install_command, require
from .factory.errors import FactoryError
from .verbs import VERBS, Verb

_HELP = ("-h", "--help")
# Hydra prints something with these and does nothing.
_SHOW = (*_HELP, "--cfg", "-c", "--info", "-i", "--hydra-help")
# Options of Hydra whose next word is their value.
_WITH_VALUE = (
    "--cfg", "-c", "--package", "-p", "--config-path", "-cp", "--config-name", "-cn",
    "--config-dir", "-cd", "--experimental-rerun", "--info", "-i",
)  # fmt: skip


def main(words: Sequence[str] | None = None, default: str | None = None) -> int:
    """Run the verb that `words` (default: the command line) begin with; returns the exit code.

    default: the verb that is meant where the first word is a setting or one of its own verbs.
    0, 1 (some frames failed), 2 (bad input) or 130/143 (interrupted).
    """
    given = list(sys.argv[1:] if words is None else words)
    if "--version" in given[:2]:
        return _print(f"simnfnd {__version__}")
    if default is not None and (
        not given or _is_option(given[0]) or given[0] in VERBS[default].verbs
    ):
        given.insert(0, default)
    if not given or given[0] in (*_HELP, "help"):
        return _print(overview())
    from .factory.scheduler.workers.signals import stop_signals

    def run() -> int | None:
        name, verb, rest = find(given)
        if problem := wrong_word(name, verb, rest):
            raise FactoryError(problem)
        if any(word in _HELP for word in rest):
            print(f"{head(name, verb)}\n", flush=True)
        elif not any(word.split("=")[0] in _SHOW for word in rest):
            require(Need(f"simnfnd {name}", module) for module in verb.needs)
            if sys.stderr.isatty() and (verb.hydra or verb.needs or name == "plan"):
                # What follows imports for seconds; in a file nobody waits for the first word.
                print(f"simnfnd {name}: starting", file=sys.stderr, flush=True)
        module, function = verb.target.split(":")
        try:
            gc.disable()  # what is imported stays; looking through it takes a tenth of a second
            action = getattr(import_module(module), function)
            gc.freeze()
        except ModuleNotFoundError as error:
            if (
                verb.needs
                and any(word in _HELP for word in rest)
                and (error.name or "").split(".")[0] in EXTRAS
            ):
                return _print("Its options are listed once that is installed.")
            raise
        finally:
            gc.enable()
        # One way to stop for all: SIGTERM unwinds as Ctrl-C does, so that every `finally` runs.
        with stop_signals():
            code: int | None = action(rest)
        return code

    return guard(run, debug="debug=true" in given)


def find(words: Sequence[str]) -> tuple[str, Verb, list[str]]:
    """The verb (or verb of a verb) that `words` begin with: its name, itself, the other words.

    Raises FactoryError, one line, for a word that is none.
    """
    name, rest = words[0], list(words[1:])
    verb = VERBS.get(name)
    if verb is None:
        raise FactoryError(unknown(name, VERBS))
    if verb.verbs and rest and not _is_option(rest[0]):
        if rest[0] not in verb.verbs:
            raise FactoryError(unknown(rest[0], verb.verbs, f"{name} "))
        return f"{name} {rest[0]}", verb.verbs[rest[0]], rest[1:]
    return name, verb, rest


def unknown(word: str, verbs: Mapping[str, Verb], prefix: str = "") -> str:
    """The one line for a word that is no verb."""
    if "=" in word:
        return f"{word}: a setting needs a verb before it; did you mean `simnfnd make {word}`?"
    # With the verbs of verbs: people leave `evaluate` out.
    known = {own: f"{name} {own}" for name, verb in verbs.items() for own in verb.verbs}
    known |= {name: name for name in verbs}
    close = [word] if word in known else difflib.get_close_matches(word, known, n=3, cutoff=0.5)
    near = [known[name] for name in close]
    hint = (
        f"did you mean `simnfnd {prefix}{f'` or `simnfnd {prefix}'.join(near)}`?"
        if near
        else f"`simnfnd {prefix}--help` lists them"
    )
    return f"{word}: no such verb; {hint}"


def wrong_word(name: str, verb: Verb, words: Sequence[str]) -> str | None:
    """What is wrong with the words of a Hydra verb, before its grammar says so at length."""
    if not verb.hydra:
        return None
    places = 0
    for before, word in pairwise(["", *words]):
        if word == "--":
            return None
        if not _is_option(word) and before not in _WITH_VALUE:
            places += 1
            if verb.places is not None and places > verb.places:
                return f"{word}: not KEY=VALUE; see `simnfnd {name} --help`"
    return None


def overview() -> str:
    """What `simnfnd --help` prints."""
    lines = ["simnfnd VERB ...: sonar pictures with a known truth, and denoisers made of them", ""]
    for group in dict.fromkeys(verb.group for verb in VERBS.values()):
        lines.append(f"{group}:")
        for name, verb in VERBS.items():
            if verb.group == group:
                lines.append(f"  {name:<17} {verb.line}")
                lines += _own_verbs(name, verb)
        lines.append("")
    lines.append("`simnfnd VERB --help` tells more about one, `simnfnd --version` the version.")
    return "\n".join(lines)


def head(name: str, verb: Verb) -> str:
    """What `simnfnd VERB --help` begins with; the options or configuration groups follow."""
    lines = [f"simnfnd {name}: {verb.line}", "", "Examples:"]
    lines += [f"  {example}" for example in verb.examples]
    if verb.verbs:
        lines += ["", "Verbs of its own:", *_own_verbs(name, verb)]
    if verb.needs:
        lines += ["", f"Needs {install_command(*(EXTRAS[module] for module in verb.needs))}"]
    return "\n".join(lines)


def _own_verbs(name: str, verb: Verb) -> Iterator[str]:
    return (f"  {f'{name} {own}':<17} {one.line}" for own, one in verb.verbs.items())


def _is_option(word: str) -> bool:
    """KEY=VALUE, `~KEY` or an option: not the name of a verb or place."""
    return "=" in word or word.startswith(("-", "~", "+"))


def _print(text: str) -> int:
    return guard(lambda: print(text, flush=True))
