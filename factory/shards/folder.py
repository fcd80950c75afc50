"""The dataset's folder before a run: is it ours, is it the same dataset, can it be written."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml

from factory.errors import FactoryError
from factory.shards.files import (
    check_writable,
    is_temporary,
    remove_stale_temporaries,
    write_atomically,
)
from factory.shards.manifest import MANIFEST_NAME, Manifest, load_manifest, save_manifest
from factory.shards.schema import SCHEMA, SPLITS, Provenance, plain_values

CONFIG_NAME = "config.yaml"
CARD_NAME = "README.md"
PREVIEW_NAME = "preview.png"
# Journals of the workers; empty and gone after a run that ended by itself.
WORK_NAME = ".work"

_SHOWN_DIFFERENCES = 6
_HASH = re.compile(r"config hash (\w+)")


def open_folder(directory: Path, config: Mapping[str, Any], provenance: Provenance) -> Manifest:
    """Make `directory` ready for a run of `provenance` and return what it already holds.

    A new folder gets an empty manifest.json and `config` as config.yaml; one of the same dataset
    is taken up again.  Temp files of dead writers are removed.

    Raises FactoryError when the folder holds another dataset (naming the keys that differ), holds
    something that is no dataset, or cannot be written.
    """
    if directory.exists() and not directory.is_dir():
        raise FactoryError(f"dataset.dir: {directory} is a file; give a folder with dataset.dir=")
    ours = (directory / CONFIG_NAME).exists() or (directory / MANIFEST_NAME).exists()
    if not ours:
        _refuse_foreign(directory)
    check_writable(directory, "dataset.dir")
    for folder in (directory, *(directory / split for split in SPLITS)):
        remove_stale_temporaries(folder)
    manifest = _same_dataset(directory, provenance) if ours else None
    if manifest is None:
        values = plain_values(provenance.config)
        manifest = Manifest(provenance.config_hash, provenance.generator, values)
    save_manifest(directory, manifest)
    write_atomically(directory / CONFIG_NAME, _config_text(config, provenance).encode())
    return manifest


def _refuse_foreign(directory: Path) -> None:
    if not directory.is_dir():
        return
    foreign = sorted(entry.name for entry in directory.iterdir() if not is_temporary(entry.name))
    if foreign:
        shown = ", ".join(foreign[:3]) + (", ..." if len(foreign) > 3 else "")
        raise FactoryError(
            f"dataset.dir: {directory} holds other files ({shown}) and no dataset; "
            "give an empty or new folder with dataset.dir="
        )


def _same_dataset(directory: Path, provenance: Provenance) -> Manifest | None:
    """The folder's manifest when it is of this very dataset, None when it has none any more."""
    manifest = load_manifest(directory)
    config_hash = manifest.config_hash if manifest else _hash_in_config(directory)
    if config_hash != provenance.config_hash:
        raise FactoryError(_difference(directory, manifest, provenance))
    if manifest and manifest.generator != provenance.generator:
        raise FactoryError(
            f"dataset.dir: {directory} was made by {manifest.generator}, this is "
            f"{provenance.generator}; give another folder with dataset.dir="
        )
    return manifest


def _difference(directory: Path, manifest: Manifest | None, provenance: Provenance) -> str:
    """One line that names the keys in which the folder's dataset differs from the asked one."""
    there = dict(_leaves(manifest.config if manifest else {}))
    here = dict(_leaves(plain_values(provenance.config)))
    keys = sorted(key for key in there.keys() | here.keys() if there.get(key) != here.get(key))
    changes = [
        f"{key} {_shown(there, key)} -> {_shown(here, key)}" for key in keys[:_SHOWN_DIFFERENCES]
    ]
    if len(keys) > _SHOWN_DIFFERENCES:
        changes.append(f"and {len(keys) - _SHOWN_DIFFERENCES} more")
    if not manifest or not changes:
        changes = ["its config hash differs"]
    return (
        f"dataset.dir: {directory} holds a dataset of another configuration "
        f"({'; '.join(changes)}); "
        "give another folder with dataset.dir=, or the old settings to go on with it"
    )


def _shown(values: Mapping[str, Any], key: str) -> str:
    return repr(values[key]) if key in values else "(absent)"


def _leaves(value: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    if isinstance(value, Mapping) and value:
        for key, item in value.items():
            yield from _leaves(item, f"{prefix}.{key}" if prefix else str(key))
    else:
        yield prefix, value


def _hash_in_config(directory: Path) -> str | None:
    try:
        with (directory / CONFIG_NAME).open(encoding="utf-8") as file:
            match = _HASH.search(file.readline())
    except (OSError, UnicodeDecodeError):
        return None
    return match[1] if match else None


def _config_text(config: Mapping[str, Any], provenance: Provenance) -> str:
    body = yaml.safe_dump(
        plain_values(config), sort_keys=False, allow_unicode=True, default_flow_style=False
    )
    return f"# {SCHEMA}, {provenance.generator}, config hash {provenance.config_hash}\n{body}"
