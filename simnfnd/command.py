"""`simnfnd VERB ...`: finds the verb, says what is wrong with the words, and runs it."""

from __future__ import annotations

import atexit
import gc
import os
import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

from .factory import __version__
from .factory.common import extensions
from .factory.common.command_line import guard
from .factory.common.errors import FactoryError
from .factory.common.extras import EXTRAS, Need, install_command, require
from .factory.simulation.config.hydra_loader import config_folders, take_config_folders
from .factory.simulation.config.key_help import key_help
from .verbs import RENAMED, VERBS, Verb

_HELP = ("-h", "--help")
# Not imported from the factory: help and mistakes must answer at once.
KEPT = "what was finished is kept, run again to go on"
_MANIFEST = "manifest.json"
# Hydra prints something with these and does nothing.
_SHOW = (*_HELP, "--cfg", "-c", "--info", "-i", "--hydra-help")


def main(words: Sequence[str] | None = None, default: str | None = None) -> int:
    """Run the verb that `words` (default: the command line) begin with; returns the exit code.

    default: the verb that is meant where the first word is a setting or one of its own verbs.
    0, 1 (some frames failed), 2 (bad input) or 130/143 (interrupted).
    """
    arguments = list(sys.argv[1:] if words is None else words)
    if "--version" in arguments[:2]:
        return _print(f"simnfnd {__version__}")
    if default is not None and (
        not arguments or _is_option(arguments[0]) or f"{default} {arguments[0]}" in VERBS
    ):
        arguments.insert(0, default)
    if not arguments or arguments[0] in (*_HELP, "help"):
        return _print(overview())
    from .factory.common.signals import stop_signals

    def run() -> int | None:
        others, folders = take_config_folders(arguments)
        name, verb, rest = find(others)
        if any(word in _HELP for word in rest):
            print(f"{head(name, verb)}\n", flush=True)
            if verb.config:
                with config_folders(folders):
                    return _print(key_help(verb.config, name))
            if not all(map(find_spec, verb.needs)):
                return _print("Its options are listed once that is installed.")
        elif not any(word.split("=")[0] in _SHOW for word in rest):
            require(Need(f"simnfnd {name}", module) for module in verb.needs)
        module, function = verb.target.split(":")
        # What is imported stays: looking through it for what could go, as it comes in and at the
        # end, takes a tenth of a second.
        gc.set_threshold(100_000)
        atexit.register(gc.freeze)
        action = getattr(import_module(module), function)
        # One way to stop for all: SIGTERM unwinds as Ctrl-C does, so that every `finally` runs.
        with stop_signals(), config_folders(folders):
            try:
                code: int | None = action(rest)
            except KeyboardInterrupt as stopped:
                if verb.resumes and not getattr(stopped, "kept", ""):
                    stopped.kept = KEPT  # type: ignore[attr-defined]
                raise
        return code

    return guard(run, debug="debug=true" in arguments)


class _Command(NamedTuple):
    """A verb with its name, one word or two, and the words that follow it."""

    name: str
    verb: Verb
    rest: list[str]


def find(words: Sequence[str]) -> _Command:
    """Find the verb that `words` begin with.  Raises FactoryError, one line, for unknown verbs."""
    name = words[0]
    rest = list(words[1:])
    has_own_verbs = any(full_name.startswith(f"{name} ") for full_name in VERBS)
    has_second_word = has_own_verbs and bool(rest) and not _is_option(rest[0])
    if has_second_word:
        name = f"{name} {rest.pop(0)}"
    if name in RENAMED:
        print(f"`simnfnd {name}` is now `simnfnd {RENAMED[name]}`", file=sys.stderr)
        name = RENAMED[name]
    if name in VERBS:
        return _Command(name, VERBS[name], rest)
    word = name.rpartition(" ")[2]
    if has_second_word and ("/" in word or os.path.exists(word)):
        raise FactoryError(f"{word}: no such verb; {_verb_for(words[0], Path(word))}")
    if "=" in word:
        raise FactoryError(
            f"{word}: a setting needs a verb before it; did you mean `simnfnd make {word}`?"
        )
    import difflib

    # The last word alone counts, too: people leave `evaluate` out.
    name_by_last_word = {full_name.rpartition(" ")[2]: full_name for full_name in VERBS}
    close_words = difflib.get_close_matches(word, name_by_last_word, n=3, cutoff=0.5)
    if word in close_words:
        close_words = [word]
    near = [name_by_last_word[close_word] for close_word in close_words]
    hint = f"`simnfnd {f'{words[0]} ' if has_second_word else ''}--help` lists them"
    if near:
        hint = f"did you mean `simnfnd {'` or `simnfnd '.join(near)}`?"
    raise FactoryError(f"{word}: no such verb; {hint}")


def _verb_for(verb: str, path: Path) -> str:
    """What was meant by a path in the place of a verb's verb."""
    is_recording = os.path.exists(path) and not os.path.isfile(path / _MANIFEST)
    meant = f"{verb} real {path}" if is_recording else f"{verb} dataset={path}"
    return f"did you mean `simnfnd {meant}`?"


def overview() -> str:
    """What `simnfnd --help` prints."""
    lines = ["simnfnd VERB ...: make pairs of noisy and clean sonar images, and denoise recordings"]
    for group in dict.fromkeys(verb.group for verb in VERBS.values()):
        lines += ["", f"{group}:"]
        lines += [
            f"  {name:<17} {verb.line}" for name, verb in VERBS.items() if verb.group == group
        ]
    more = "`simnfnd VERB --help` explains a verb; `simnfnd --version` prints the version."
    return "\n".join([*lines, "", more])


def head(name: str, verb: Verb) -> str:
    """Return the start of `simnfnd VERB --help`; options or configuration groups follow."""
    lines = [f"simnfnd {name}: {verb.line}", "", "Examples:"]
    lines += [f"  {example}" for example in verb.examples]
    sub_verbs = {key: sub_verb for key, sub_verb in VERBS.items() if key.startswith(f"{name} ")}
    if sub_verbs:
        lines += ["", "Verbs of its own:"]
        lines += [f"  {key:<17} {sub_verb.line}" for key, sub_verb in sub_verbs.items()]
    if verb.config and (of_extensions := extensions.listed()):
        lines += ["", *of_extensions]
    if verb.needs:
        lines += ["", f"Needs {install_command(*(EXTRAS[module] for module in verb.needs))}"]
    return "\n".join(lines)


def _is_option(word: str) -> bool:
    """KEY=VALUE, `~KEY` or an option: not the name of a verb or place."""
    return "=" in word or word.startswith(("-", "~", "+"))


def _print(text: str) -> int:
    return guard(lambda: print(text, flush=True))
