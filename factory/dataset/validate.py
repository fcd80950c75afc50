"""Is a dataset what its manifest says: whole, consistent, and fair to those who test on it.

HDF5 is a large C library, and a damaged file can make it crash, hang or ask for all memory there
is.  `shard_facts` therefore runs in a process that may die of it, and index.h5 is not opened.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Hashable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ..errors import FactoryError
from ..files import sha256_of
from ..isolated import LASTING
from ..labels import classes_of
from .layout import check_texts, config_of, echo_names, image_axes, inside, optional_layers
from .manifest import INDEX_NAME, MANIFEST_NAME, Manifest, damage, load_manifest
from .reader import ImageStack, reading
from .schema import REQUIRED_COLUMNS, SPLITS, layers

_LIMIT_S = 60.0
# Slower than any disk: a shard that takes longer is not read but stuck.
_BYTES_PER_S = 1e6
# A table that is wrong in every row is reported a few times, not a thousand times.
_MOST_PROBLEMS = 8

Facts = dict[str, Any]
"""What a shard says of itself.

problems: what is wrong; with any, nothing else need be there.  config_hash, split.
form: what all shards share, as text.  samples: location, scene, frame and variant of each.
noisy, clean: digests of the pictures, in hexadecimal, when they were read.
"""


@dataclass(frozen=True)
class Report:
    """What validation found, a line each that says error or note and where; and what it checked."""

    findings: tuple[str, ...]
    samples: int
    shards: int

    @property
    def errors(self) -> tuple[str, ...]:
        """The findings that make the dataset unfit."""
        return tuple(finding for finding in self.findings if finding.startswith("error: "))


def validate(directory: Path, deep: bool = False) -> Report:
    """Check a dataset: manifest, SHA-256, schema, counts, duplicates, leaks from train to test.

    deep: read every picture, too (NaN, value ranges, damaged chunks, equal pictures).
    Files are opened in an isolated process, which may crash or hang without harm.
    Raises FactoryError when there is no readable manifest.json.
    """
    if not directory.is_dir():
        raise FactoryError(f"{directory}: no such folder; give that of a dataset")
    manifest = load_manifest(directory)
    if manifest is None:
        raise FactoryError(f"{directory}: no {MANIFEST_NAME}; give the folder of a dataset")
    facts = {path: _facts_of(directory, manifest, path, deep) for path in sorted(manifest.shards)}
    findings = [
        *(f"error: {path}: {one}" for path, found in facts.items() for one in found["problems"]),
        *_of_index(directory, manifest),
        *(f"error: {problem}" for problem in _of_all(facts)),
    ]
    return Report(tuple(findings), manifest.samples(), len(manifest.shards))


def _facts_of(directory: Path, manifest: Manifest, path: str, deep: bool) -> Facts:
    info = manifest.shards[path]
    if os.path.lexists(directory / path) and not inside(directory, directory / path):
        return {"problems": ["no regular file, or leads out of the dataset's folder; not read"]}
    if wrong := damage(directory, info):
        return {"problems": [f"{wrong}; run the command that made the dataset again"]}
    limit_s = _LIMIT_S + info.bytes / _BYTES_PER_S
    try:
        facts: Facts = LASTING.call(shard_facts, directory / path, deep, limit_s=limit_s)
    except FactoryError as error:
        return {"problems": [str(error)]}
    if not facts["problems"]:
        if (count := len(facts["samples"])) != info.samples:
            facts["problems"].append(f"{count} samples, the manifest says {info.samples}")
        if facts["split"] != info.split:
            facts["problems"].append(f"says that its split is {facts['split']!r}")
        if (hash_ := facts["config_hash"]) not in manifest.config_hashes:
            facts["problems"].append(f"is of another configuration ({hash_[:40]!r})")
    return facts


def _of_index(directory: Path, manifest: Manifest) -> Iterator[str]:
    path = directory / INDEX_NAME
    if not os.path.lexists(path):
        yield f"note: {INDEX_NAME}: absent; the command that made the dataset writes it"
    elif not inside(directory, path):
        yield f"error: {INDEX_NAME}: no regular file inside the dataset's folder; not read"
    elif manifest.index_sha256 not in ("", sha256_of(path)):
        yield (
            f"error: {INDEX_NAME}: its SHA-256 is not that of the manifest; remove it and run the "
            "command that made the dataset again, which writes it anew and makes nothing else that "
            "is whole"
        )


def _of_all(facts: Mapping[str, Facts]) -> Iterator[str]:
    """Shards of another form; samples of one name or noisy picture; what a test would know.

    Those are scenes and clean pictures that are in train and in test.
    """
    first = next((path for path, found in facts.items() if "form" in found), "")
    places: dict[Hashable, str] = {}
    scenes: dict[str, set[str]] = {split: set() for split in SPLITS}
    clean: dict[str, set[str]] = {split: set() for split in SPLITS}
    for path, found in facts.items():
        form = found.get("form")
        if form and form != facts[first]["form"]:
            yield f"{path}: has another form than {first}: {form[:300]}"
        for row, key in enumerate(map(tuple, found.get("samples", ()))):
            place = places.setdefault(key, here := f"{path} sample {row}")
            if place != here:
                name = f"{'/'.join(filter(None, key[:3]))} variant {key[3]}"
                yield f"{path}: sample {row} is {name} again, as {place}"
        for row, digest in enumerate(found.get("noisy", ())):
            place = places.setdefault(digest, here := f"{path} sample {row}")
            if place != here:
                yield f"{path}: sample {row} has the same noisy picture as {place}"
        split = path.partition("/")[0]
        scenes[split].update("/".join(key[:2]) for key in found.get("samples", ()))
        clean[split].update(found.get("clean", ()))
    if both := sorted(set.intersection(*scenes.values())):
        yield f"{MANIFEST_NAME}: {len(both)} scene(s) both train and test: {', '.join(both[:3])}"
    if both := sorted(set.intersection(*clean.values())):
        yield f"{MANIFEST_NAME}: {len(both)} clean picture(s) are in train and in test"


# --- in the isolated process


def shard_facts(path: Path, deep: bool) -> Facts:
    """Check one shard; `deep` reads every picture."""
    try:
        with reading(path) as file:
            check_texts(file)
            return _facts(file, deep)
    except FactoryError as error:
        return {"problems": [str(error).removeprefix(f"{path}: ")]}


def _facts(file: h5py.File, deep: bool) -> Facts:
    noisy, table = file["noisy"], file["meta"][()]
    known = layers(str(noisy.dtype), optional_layers(file), classes_of(config_of(file)))
    sizes = [f"{layer.name} {file[layer.name].shape[1:]}" for layer in known if layer.of_camera]
    axes = [(axis.name, axis.units) for axis in image_axes(noisy)]
    problems = [
        f"/meta: column {name} has infinite values"
        for name in table.dtype.names
        if table.dtype[name].kind == "f" and np.isinf(table[name]).any()
    ]
    digests: dict[str, list[str]] = {"noisy": [], "clean": []}
    stacks = {layer: ImageStack(file[layer.name]) for layer in known}
    for row in range(len(table)) if deep else ():
        for layer, stack in stacks.items():
            try:
                picture = stack[row]
            except FactoryError as error:
                problems.append(str(error))
                continue
            if problem := layer.value_problem(picture):
                problems.append(f"sample {row}: /{layer.name} {problem}")
            if layer.name in digests:
                content = hashlib.blake2b(picture.tobytes(), digest_size=16)
                digests[layer.name].append(content.hexdigest())
        if len(problems) >= _MOST_PROBLEMS:
            break
    names = ", ".join((*(layer.name for layer in known), *echo_names(file)))
    shapes = " ".join((str(noisy.shape[1:]), *sizes))
    form = f"{shapes} {noisy.dtype}, layers {names}, axes {axes}, "
    return {
        "problems": problems[:_MOST_PROBLEMS],
        "config_hash": str(file.attrs["config_hash"])[:200],
        "split": str(file.attrs["split"]),
        "form": f"{form}columns {', '.join(table.dtype.names)}"[:4000],
        "samples": [
            [*(row[name].decode() for name in REQUIRED_COLUMNS[:3]), int(row["variant"])]
            for row in table
        ],
        **({} if problems else digests),
    }
