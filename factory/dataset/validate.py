"""Is a dataset what its manifest says: whole, consistent, and fair to those who test on it.

HDF5 is a large C library, and a damaged file can make it crash, hang or ask for all memory there
is.  `shard_facts` therefore runs in a process that may die of it, and index.h5 is not opened.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Hashable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
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
_SHOWN = 3
# A table that is wrong in every row is reported a few times, not a thousand times.
_MOST_PROBLEMS = 8


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong (`error`), or that one should know (`note`).

    where: file below the dataset's folder.
    """

    kind: str
    where: str
    text: str

    def __str__(self) -> str:
        return f"{self.kind}: {self.where}: {self.text}"


@dataclass(frozen=True)
class Report:
    """What validation found, and how much it checked."""

    findings: tuple[Finding, ...]
    samples: int
    shards: int

    @property
    def errors(self) -> tuple[Finding, ...]:
        """The findings that make the dataset unfit."""
        return tuple(finding for finding in self.findings if finding.kind == "error")


@dataclass(frozen=True)
class ShardFacts:
    """What a shard says of itself.

    form: what all shards of a dataset share, as text.  samples: location, scene, frame and variant
    of each.  digests: of the noisy and clean pictures, in hexadecimal, when they were read.
    """

    problems: list[str]
    config_hash: str = ""
    split: str = ""
    form: str = ""
    samples: list[list[Any]] = field(default_factory=list)
    digests: dict[str, list[str]] = field(default_factory=dict)


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
    findings: list[Finding] = []
    for path, found in facts.items():
        findings += [Finding("error", path, problem) for problem in found.problems]
    findings += _index_findings(directory, manifest)
    findings += _disagreements(facts)
    findings += _doubles(facts)
    findings += _leaks(facts)
    return Report(tuple(findings), manifest.samples(), len(manifest.shards))


def _facts_of(directory: Path, manifest: Manifest, path: str, deep: bool) -> ShardFacts:
    info = manifest.shards[path]
    if os.path.lexists(directory / path) and not inside(directory, directory / path):
        return ShardFacts(["no regular file, or leads out of the dataset's folder; not read"])
    if wrong := damage(directory, info):
        return ShardFacts([f"{wrong}; run the command that made the dataset again"])
    limit_s = _LIMIT_S + info.bytes / _BYTES_PER_S
    try:
        facts = ShardFacts(**LASTING.call(_told, directory / path, deep, limit_s=limit_s))
    except FactoryError as error:
        return ShardFacts([str(error)])
    if facts.problems:
        return facts
    problems = []
    if len(facts.samples) != info.samples:
        problems.append(f"{len(facts.samples)} samples, the manifest says {info.samples}")
    if facts.split != info.split:
        problems.append(f"says that its split is {facts.split!r}")
    if facts.config_hash not in manifest.config_hashes:
        problems.append(f"is of another configuration ({facts.config_hash[:40]!r})")
    return replace(facts, problems=problems)


def _index_findings(directory: Path, manifest: Manifest) -> Iterator[Finding]:
    path = directory / INDEX_NAME
    if not os.path.lexists(path):
        yield Finding("note", INDEX_NAME, "absent; the command that made the dataset writes it")
    elif not inside(directory, path):
        yield Finding("error", INDEX_NAME, "no regular file inside the dataset's folder; not read")
    elif manifest.index_sha256 not in ("", sha256_of(path)):
        text = (
            "its SHA-256 is not that of the manifest; remove it and run the command that made the "
            "dataset again, which writes it anew and makes nothing else that is whole"
        )
        yield Finding("error", INDEX_NAME, text)


def _disagreements(facts: Mapping[str, ShardFacts]) -> Iterator[Finding]:
    forms = {path: found.form for path, found in facts.items() if found.form}
    first = next(iter(forms), "")
    for path, form in forms.items():
        if form != forms[first]:
            yield Finding("error", path, f"has another form than {first}: {form[:300]}")


def _doubles(facts: Mapping[str, ShardFacts]) -> Iterator[Finding]:
    """Samples of the same name, and (when pictures were read) of the same noisy picture."""
    places: dict[Hashable, str] = {}
    for path, found in facts.items():
        for row, key in enumerate(map(tuple, found.samples)):
            if key in places:
                name = f"{'/'.join(filter(None, key[:3]))} variant {key[3]}"
                yield Finding("error", path, f"sample {row} is {name} again, as {places[key]}")
            places.setdefault(key, f"{path} sample {row}")
        for row, digest in enumerate(found.digests.get("noisy", ())):
            if digest in places:
                text = f"sample {row} has the same noisy picture as {places[digest]}"
                yield Finding("error", path, text)
            places.setdefault(digest, f"{path} sample {row}")


def _leaks(facts: Mapping[str, ShardFacts]) -> Iterator[Finding]:
    """What a test would know from training: scenes, and clean pictures; a location is a note."""
    sides = [[one for path, one in facts.items() if path.startswith(split)] for split in SPLITS]

    def shared(values: Any) -> list[str]:
        train, test = ({value for one in side for value in values(one)} for side in sides)
        return sorted(train & test)

    if scenes := shared(lambda one: ["/".join(key[:2]) for key in one.samples]):
        text = f"{len(scenes)} scene(s) both train and test: {', '.join(scenes[:_SHOWN])}"
        yield Finding("error", MANIFEST_NAME, text)
    if clean := shared(lambda one: one.digests.get("clean", ())):
        text = f"{len(clean)} clean picture(s) are in train and in test"
        yield Finding("error", MANIFEST_NAME, text)
    places = shared(lambda one: [key[0] for key in one.samples if key[0]])
    if places and not scenes:
        shown = ", ".join(places[:_SHOWN])
        text = f"location(s) with scenes on both sides, none of them the same: {shown}"
        yield Finding("note", MANIFEST_NAME, text)


# --- in the isolated process


def _told(path: Path, deep: bool) -> dict[str, Any]:
    return asdict(shard_facts(path, deep))


def shard_facts(path: Path, deep: bool) -> ShardFacts:
    """Check one shard; `deep` reads every picture."""
    try:
        with reading(path) as file:
            return _facts(file, deep)
    except FactoryError as error:
        return ShardFacts([str(error).removeprefix(f"{path}: ")])


def _facts(file: h5py.File, deep: bool) -> ShardFacts:
    noisy = file["noisy"]
    known = layers(str(noisy.dtype), optional_layers(file), classes_of(config_of(file)))
    sizes = [f"{layer.name} {file[layer.name].shape[1:]}" for layer in known if layer.of_camera]
    table = file["meta"][()]
    axes = [(axis.name, axis.units) for axis in image_axes(noisy)]
    check_texts(file)
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
    names = [*(layer.name for layer in known), *echo_names(file)]
    form = f"{' '.join((str(noisy.shape[1:]), *sizes))} {noisy.dtype}, layers {', '.join(names)}, "
    return ShardFacts(
        problems[:_MOST_PROBLEMS],
        str(file.attrs["config_hash"])[:200],
        str(file.attrs["split"]),
        f"{form}axes {axes}, columns {', '.join(table.dtype.names)}"[:4000],
        [
            [*(row[name].decode() for name in REQUIRED_COLUMNS[:3]), int(row["variant"])]
            for row in table
        ],
        {} if problems else digests,
    )
