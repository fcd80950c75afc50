"""The comments of a YAML file by the key that they explain."""

from __future__ import annotations

import re
from collections.abc import Mapping

_KEY = re.compile(r"^(\s*)([A-Za-z_][\w-]*):(?:\s+(.*))?$")


def comments(text: str) -> Mapping[str, str]:
    """Dotted key -> the comment above it, or beside its value.

    text: YAML whose keys stand one a line, as in `conf`.  A comment above stands for the keys that
    follow it without a gap and have none of their own, and a block's for the keys in it; one beside
    a value goes on in the lines of comment below it that are indented further.
    """
    found: dict[str, str] = {}
    above: list[str] = []
    shared: dict[int, str] = {}
    path: list[tuple[int, str]] = []
    last = ""
    for line in text.splitlines():
        stripped = line.strip()
        if stripped.startswith("#"):
            said = stripped.lstrip("#").strip()
            if last and len(line) - len(line.lstrip()) > 8:
                found[last] += f" {said}"
            else:
                above.append(said)
            continue
        last = ""
        match = _KEY.match(line)
        if match is None:
            above = []
            shared = shared if stripped else {}
            continue
        indent = len(match.group(1))
        path = [step for step in path if step[0] < indent] + [(indent, match.group(2))]
        key = ".".join(name for _, name in path)
        beside = re.search(r"(?:^|\s)#\s*(.*)$", match.group(3) or "")
        if beside:
            found[key] = beside.group(1).strip()
            last = key
        elif above:
            found[key] = shared[indent] = " ".join(above)
        elif indent in shared and match.group(3):
            found[key] = shared[indent]
        above = []
    return found
