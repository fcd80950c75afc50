"""Which recordings weights learned from: figures on these say nothing about others.

A weights file says it in its header (`learned_from`), weights that ship in the front matter of
their card.  Files are known by their content, not by their name.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from ...factory.common.files import sha256_of

KEY = "learned_from"
"""Key in the header of weights, and in the front matter of a model card."""

_HEADER = "simnfnd"  # entry of the safetensors header, as `networks.weights` writes it


class LearnedFile(NamedTuple):
    """A recording or image.  file: its name.  bytes: its size."""

    file: str
    bytes: int
    sha256: str


def described(paths: Iterable[Path]) -> list[LearnedFile]:
    """What is to be kept of files that weights learn from, each once, by name."""
    files = {path for path in paths if path.is_file()}
    return sorted(LearnedFile(path.name, path.stat().st_size, sha256_of(path)) for path in files)


def learned_files(weights: Path) -> list[LearnedFile]:
    """The files that weights learned from, where they or their card name them."""
    files = [*_in_header(weights), *_in_card(weights.with_suffix(".md"))]
    return list(dict.fromkeys(files))


def known_as(path: Path, learned: Iterable[LearnedFile]) -> str | None:
    """The name under which a file was learned from; None where it was not, or is no file."""
    if not path.is_file():
        return None
    size = path.stat().st_size
    same_size = [entry for entry in learned if entry.bytes == size]
    if not same_size:
        return None
    digest = sha256_of(path)
    return next((entry.file for entry in same_size if entry.sha256 == digest), None)


def as_front_matter(files: Iterable[LearnedFile]) -> str:
    """The lines of a model card, with a line end."""
    entries = [entry._asdict() for entry in files]
    return yaml.safe_dump({KEY: entries}, sort_keys=False, width=200)


def _in_header(weights: Path) -> list[LearnedFile]:
    from safetensors import SafetensorError, safe_open  # needs an extra

    try:
        with safe_open(weights, framework="np") as file:
            header = json.loads((file.metadata() or {}).get(_HEADER, "{}"))
        return entries_of(header["training"])
    except (SafetensorError, OSError, ValueError, KeyError, TypeError):
        return []


def _in_card(card: Path) -> list[LearnedFile]:
    try:
        _, front, _ = card.read_text(encoding="utf-8").split("---\n", 2)
        return entries_of(yaml.safe_load(front))
    except (OSError, ValueError, yaml.YAMLError):
        return []


def entries_of(content: Mapping[str, Any]) -> list[LearnedFile]:
    """What a header or a card says, which may be anybody's: what does not fit is left out."""
    files = []
    listed = content.get(KEY) if isinstance(content, dict) else None
    for entry in listed if isinstance(listed, list) else []:
        try:
            name, size, digest = (entry[key] for key in LearnedFile._fields)
            files.append(LearnedFile(str(name), int(size), str(digest)))
        except (TypeError, KeyError, ValueError):
            continue
    return files
