"""Which graph computes a weights file, among those that may be run.

A graph is a program: one beside weights of a stranger could count to 2^62 or ask for all memory.
So a graph that ships is taken where it computes the structure of the weights, and one beside them
only where its content is known: `simnfnd export-weights --to runtime` on this machine made it, or
the user vouches for its SHA-256.
"""

from __future__ import annotations

import base64
import hashlib
import os
import re
from contextlib import suppress
from pathlib import Path
from typing import Literal, NamedTuple, cast

from ...factory.common.small_files import read_regular
from . import shipped

VOUCHED = "SIMNFND_GRAPHS"
"""Environment variable: SHA-256 of graphs to be run, separated by commas."""
_MOST_BYTES = 1 << 24


Form = Literal["whole", "geometry", "single", "window", "bearings"]
"""What a graph computes: everything; what the first layer makes of a geometry; a single frame; a
frame of a window, whose change has no weight; interference along bearings."""


class RunnableGraph(NamedTuple):
    """A graph that may be run: its file and the content that was looked at."""

    path: Path
    content: bytes

    def forms(self) -> dict[Form, bytes]:
        """The graph and the others in its file, by what they compute."""
        forms: dict[Form, bytes] = {"whole": self.content}
        for found in re.finditer(_PACKED, self.content):
            form = cast(Form, found["form"].decode())
            forms[form] = base64.b64decode(found["graph"])
        return forms


_PACKED = rb"\(simnfnd graph (?P<form>geometry|single|window|bearings) (?P<graph>[A-Za-z0-9+/=]+)\)"


def packed(form: Form, content: bytes) -> str:
    """A graph as a fact of another one, where `RunnableGraph.forms` finds it."""
    return f"(simnfnd graph {form} {base64.b64encode(content).decode()})"


def find_runnable(weights: Path, description: bytes) -> RunnableGraph | None:
    """The graph that computes these weights and may be run, or None.

    description: of the structure of the weights, which a graph states at its end.
    """
    for path in shipped().values():
        graph = _read(path.with_suffix(".onnx"))
        if graph is not None and description in graph.content:
            return graph
    graph = _read(weights.with_suffix(".onnx"))
    if graph is not None and description in graph.content and is_known(graph.content):
        return graph
    return None


def unknown_graph(weights: Path) -> str:
    """What to say of a graph beside weights that is not run; "" where there is none."""
    graph = _read(weights.with_suffix(".onnx"))
    if graph is None:
        return ""
    digest = hashlib.sha256(graph.content).hexdigest()
    return (
        f"{graph.path.name} was not exported on this machine and is not run; if it is your own, "
        f"set {VOUCHED}={digest}"
    )


def is_known(content: bytes) -> bool:
    """Whether a graph was exported on this machine, or the user vouches for it."""
    digest = hashlib.sha256(content).hexdigest()
    vouched = os.environ.get(VOUCHED, "").replace(",", " ").lower().split()
    return digest in vouched or (_folder() / digest).is_file()


def remember(content: bytes) -> None:
    """Note that a graph was exported on this machine; a folder that cannot be written is none."""
    with suppress(OSError):
        _folder().mkdir(parents=True, exist_ok=True)
        (_folder() / hashlib.sha256(content).hexdigest()).touch()


def _folder() -> Path:
    """Empty files with the SHA-256 of graphs as their names."""
    base = os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser()
    return Path(base) / "simnfnd" / "graphs"


def _read(path: Path) -> RunnableGraph | None:
    with suppress(OSError):
        return RunnableGraph(path, read_regular(path, _MOST_BYTES))
    return None
