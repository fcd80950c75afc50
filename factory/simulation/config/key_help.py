"""What `--help` says of a configuration: choices of its groups, and its keys with their comments.

Reads the YAML files as text, so that help answers without composing them.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from ....conf import __file__ as _INIT
from .hydra_loader import searched_folders

_CONF = Path(_INIT).parent
_GROUP = re.compile(r"  - (\w+): (\w+)")
_BASE = re.compile(r"  - (\w+)")
_NO_KEYS = ("defaults:", "hydra:")


def choices_of(group: str) -> list[str]:
    """Names of the choices of a group, sorted: of the package and of `--config-dir`."""
    folders = (_CONF, *searched_folders())
    return sorted({path.stem for folder in folders for path in (folder / group).glob("*.yaml")})


def key_help(config_name: str, command: str) -> str:
    """Groups and keys of a root configuration, conf/<config_name>.yaml.

    command: such as `make`; experiments of other commands are left out.
    """
    blocks = _blocks(_CONF / f"{config_name}.yaml")
    matches = [match for line in blocks["defaults:"] if (match := _GROUP.match(line))]
    chosen = {match[1]: match[2] for match in matches}
    lines = []
    if chosen:
        lines += ["Groups (GROUP=NAME):", *_choice_lines(chosen, command), ""]
    lines.append("Keys (KEY=VALUE) and their defaults:")
    for key, block in blocks.items():
        lines += block if key not in _NO_KEYS else []
    for group, choice in chosen.items():
        if choice != "null":
            lines += [f"{group}:  # of {group}={choice}", *_keys_of_choice(group, choice)]
    lines += ["", f"`simnfnd {command} WORDS --cfg job` prints what words make of them."]
    return "\n".join(lines)


def _choice_lines(groups: dict[str, str], command: str) -> Iterator[str]:
    for group in groups:
        names = choices_of(group)
        if group == "experiment":
            names = [name for name in names if _is_run_by(name, command)]
        if names:
            yield f"  {group}: {', '.join(names)}"
        for folder in sorted(path for path in (_CONF / group).iterdir() if path.is_dir()):
            below = f"{group}/{folder.name}"
            yield f"  {below}: {', '.join(choices_of(below))}"


def _is_run_by(experiment: str, command: str) -> bool:
    """Whether the first comment of an experiment, the command that runs it, is this command."""
    path = _CONF / "experiment" / f"{experiment}.yaml"
    return not path.is_file() or f"\n# simnfnd {command} " in path.read_text("utf-8")[:200]


def _keys_of_choice(group: str, choice: str) -> Iterator[str]:
    """The lines of a group's file, indented, after those of the files that it builds on."""
    blocks = _blocks(_CONF / group / f"{choice}.yaml")
    for line in blocks.pop("defaults:", []):
        base = _BASE.match(line)
        if base and base[1] != "_self_":
            yield from _keys_of_choice(group, base[1])
    for block in blocks.values():
        yield from (f"  {line}" for line in block)


def _blocks(path: Path) -> dict[str, list[str]]:
    """First word of each key at the margin -> its lines, with the comments above it.

    The comment that a file begins with is left out, and so are blank lines.
    """
    text = path.read_text("utf-8")
    text = re.sub(r"\A(#.*\n)+\n?", "", text)
    blocks: dict[str, list[str]] = {}
    comments: list[str] = []
    block: list[str] = []
    for line in filter(str.strip, text.splitlines()):
        if line.startswith("#"):
            comments.append(line)
            continue
        if not line.startswith(" "):
            block = blocks.setdefault(line.split()[0], [])
            block += comments
        comments = []
        block.append(line)
    return blocks
