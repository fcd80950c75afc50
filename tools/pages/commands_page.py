"""The page `reference/commands.md`: every verb of `simnfnd`, from its table of verbs."""

from __future__ import annotations

import contextlib
import io
import os
import re
from collections.abc import Iterator

from simnfnd.command import main
from simnfnd.verbs import VERBS, Verb

_HEAD = """\
# Commands

*Written from the table of verbs in `simnfnd/verbs.py` when the site is built.*

`simnfnd --help` lists the verbs, `simnfnd VERB --help` explains one. Verbs with settings take words
`KEY=VALUE` ([Configuration](../configuration.md), [all keys](keys.md)); the others take options.
Every verb ends with [exit code](../configuration.md#exit-codes) 0, 1, 2, 130 or 143, and says in
one line what was wrong.
"""


def markdown() -> str:
    """The page."""
    lines = [_HEAD]
    for group in dict.fromkeys(verb.group for verb in VERBS.values()):
        lines += [f"## {group}", ""]
        for name, verb in VERBS.items():
            if verb.group == group:
                lines += _verb(name, verb)
                for own, below in verb.verbs.items():
                    lines += _verb(f"{name} {own}", below)
    return "\n".join(lines)


def _verb(name: str, verb: Verb) -> Iterator[str]:
    yield from (f"### {name}", "", f"{verb.line[:1].upper()}{verb.line[1:]}.", "")
    yield from ("```text", *verb.examples, "```", "")
    if verb.needs:
        from simnfnd.factory.cli.extras import EXTRAS

        extras = dict.fromkeys(EXTRAS[module] for module in verb.needs)
        yield from ("Needs the extra " + " and ".join(f"`{one}`" for one in extras) + ".", "")
    if verb.hydra:
        yield from (f"Its settings: [all keys](keys.md#{_anchor(name)}).", "")
    elif options := usage(name):
        yield from ("```text", options, "```", "")


def _anchor(name: str) -> str:
    """Of the part of the page of keys; verbs that share settings share it."""
    known = {"demo": "make", "evaluate tune": "evaluate"}
    return "simnfnd-" + known.get(name, name).replace(" ", "-")


def usage(name: str) -> str:
    """What `simnfnd NAME --help` says of the options, 80 columns wide."""
    said = io.StringIO()
    columns = os.environ.get("COLUMNS")
    os.environ["COLUMNS"] = "80"
    try:
        with contextlib.redirect_stdout(said), contextlib.suppress(SystemExit):
            main([*name.split(), "--help"])
    finally:
        del os.environ["COLUMNS"]
        if columns is not None:
            os.environ["COLUMNS"] = columns
    text = said.getvalue()
    start = text.find("usage: ")
    return re.sub(r"\n{3,}", "\n\n", text[start:].strip()) if start >= 0 else ""
