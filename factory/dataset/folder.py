"""The dataset's folder before a run: is it ours, is it the same dataset, can it be written."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import yaml

from ..common.errors import MOST_LISTED, FactoryError
from ..common.files import check_writable, is_temporary, remove_stale_temporaries, write_atomically
from ..common.small_files import load_yaml, one_line, read_regular
from .manifest import CONFIG_NAME, MANIFEST_NAME, PARTS, Manifest, load_manifest, save_manifest
from .schema import DATASET_NAME, SCHEMA, SPLITS, Provenance, plain_values

CARD_NAME = "README.md"
PREVIEW_NAME = "preview.png"
# Folder of what workers leave when they crash; a run that ends normally removes it.
WORK_NAME = ".work"
STATUS_NAME = "status.json"

# Files that come and go with runs, and the one that states where a copy comes from.
_PASSING = (".lock", ".origin", WORK_NAME)


def open_folder(directory: Path, config: Mapping[str, Any], provenance: Provenance) -> Manifest:
    """Make `directory` ready for a run of `provenance` and return what it already holds.

    A new folder gets an empty manifest.json and `config` as config.yaml; one of the same dataset
    is taken up again.  Temp files of dead writers are removed.

    Raises FactoryError when the folder holds another dataset (naming the keys that differ), holds
    something that is no dataset, or cannot be written.
    """
    if directory.exists() and not directory.is_dir():
        raise FactoryError(f"dataset.dir: {directory} is a file; give a folder with dataset.dir=")
    names = sorted(entry.name for entry in directory.iterdir()) if directory.exists() else []
    foreign = [n for n in names if not (is_temporary(n) or n.startswith(_PASSING))]
    # Asked after the listing: another slice may make the folder a dataset meanwhile.
    ours = any((directory / name).exists() for name in (CONFIG_NAME, MANIFEST_NAME))
    if foreign and not ours:
        shown = ", ".join(foreign[:3]) + (", ..." if len(foreign) > 3 else "")
        raise FactoryError(
            f"dataset.dir: {directory} holds other files ({shown}) and no dataset; "
            "give an empty or new folder with dataset.dir="
        )
    check_writable(directory, "dataset.dir")
    for folder in (directory, *(directory / split for split in SPLITS)):
        remove_stale_temporaries(folder)
    manifest = _same_dataset(directory, provenance) if ours else None
    # First of all files, because it tells other slices whose folder this is.
    body = yaml.safe_dump(
        plain_values(config), sort_keys=False, allow_unicode=True, default_flow_style=False
    )
    head = f"# {SCHEMA}, {provenance.generator}, config hash {provenance.config_hash}\n"
    write_atomically(directory / CONFIG_NAME, (head + body).encode())
    if manifest is None:
        values = plain_values(provenance.config)
        manifest = Manifest(provenance.config_hash, provenance.generator, values)
        save_manifest(directory, manifest)
        # If manifest.json was lost, the records beside the shards restore it.
        manifest = load_manifest(directory) or manifest
    return manifest


def _same_dataset(directory: Path, provenance: Provenance) -> Manifest | None:
    """The folder's manifest when it is of this very dataset, None when it has none any more."""
    manifest = load_manifest(directory)
    same = False
    changes = ""
    if manifest:
        same = manifest.config_hash == provenance.config_hash
        changes = differences(manifest.config, provenance.config)
    else:
        with suppress(OSError):
            head = read_regular(directory / CONFIG_NAME).partition(b"\n")[0]
            same = head.endswith(f"config hash {provenance.config_hash}".encode())
    if not same:
        raise FactoryError(
            f"dataset.dir: {directory} holds a dataset of another configuration "
            f"({changes or 'its config hash differs'}); give another folder with dataset.dir=, or "
            "remove this one"
        )
    if manifest and manifest.generator != provenance.generator:
        raise FactoryError(
            f"dataset.dir: {directory} was made by {manifest.generator}, this is "
            f"{provenance.generator}; give another folder with dataset.dir="
        )
    return manifest


def differences(
    stored: Mapping[str, Any], current: Mapping[str, Any], free: re.Pattern[str] | None = None
) -> str:
    """`key there -> here` of the first keys in which two configurations differ, in one line.

    The records of earlier datasets are left out, and dotted keys that match `free`.
    """
    stored_values, current_values = (
        dict(_leaves(plain_values(config))) for config in (stored, current)
    )
    changes = [
        f"{key} {stored_values.get(key, '(absent)')} -> {current_values.get(key, '(absent)')}"
        for key in sorted(stored_values.keys() | current_values.keys())
        if stored_values.get(key) != current_values.get(key)
        and key.split(".")[0] not in PARTS
        and not (free and free.match(key))
    ]
    more = [f"and {len(changes) - MOST_LISTED} more"] if len(changes) > MOST_LISTED else []
    return "; ".join(changes[:MOST_LISTED] + more)


def _leaves(value: Any, prefix: str = "") -> Iterator[tuple[str, str]]:
    if isinstance(value, list) and any(isinstance(item, Mapping) for item in value):
        value = dict(enumerate(value))
    if isinstance(value, Mapping) and value:
        for key, item in value.items():
            yield from _leaves(item, f"{prefix}.{key}" if prefix else str(key))
    else:
        yield prefix, repr(value)


def dataset_settings(directory: Path) -> dict[str, Any]:
    """The `dataset` block of config.yaml; empty when there is none.

    Raises FactoryError when the file cannot be read, or when name or licence are not what the
    settings allow: both go into the cards of exports.
    """
    path = directory / CONFIG_NAME
    try:
        values = load_yaml(path)
    except FileNotFoundError:
        return {}
    except (OSError, ValueError) as error:
        reason = f"cannot be read ({one_line(error)}); restore or delete it"
        raise FactoryError(f"{path}: {reason}") from error
    block = values.get("dataset") if isinstance(values, dict) else None
    block = block if isinstance(block, dict) else {}
    name = block.get("name") or "dataset"
    licence = block.get("licence")
    problem = "" if isinstance(licence, str | None) else f"licence {str(licence)[:40]!r} is no text"
    if not (isinstance(name, str) and DATASET_NAME.fullmatch(name)):
        problem = f"name {str(name)[:40]!r} is not letters, digits, dot, dash, underscore"
    if problem:
        raise FactoryError(f"{path}: dataset.{problem}")
    return block
