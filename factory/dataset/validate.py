"""Is a dataset what its manifest says: whole, consistent, and fair to those who test on it.

HDF5 is a large C library, and a damaged file can make it crash, hang or ask for all memory there
is.  `shard_facts` therefore runs in a process that may die of it, and index.h5 is not opened.
What a validator cannot see is listed in docs/trust.md.
"""

from __future__ import annotations

import hashlib
import os
import re
import unicodedata
from collections.abc import Hashable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
import numpy.typing as npt

from ..common.errors import MOST_LISTED, FactoryError
from ..common.files import is_temporary, sha256_of
from ..common.isolated import LASTING, LIMIT_S
from .folder import CARD_NAME, PREVIEW_NAME
from .layout import check_texts, config_of, image_axes, optional_layers
from .manifest import (
    CONFIG_NAME,
    FAILURES_NAME,
    INDEX_NAME,
    MANIFEST_NAME,
    Manifest,
    ShardInfo,
    damage,
    is_inside,
    load_manifest,
    totals_problem,
)
from .meaning import classes_of
from .reader import ImageStack, reading
from .schema import CHECKSUMS, REQUIRED_COLUMNS, SPLITS, Layer, config_hash, layers
from .storage import Store, url_of

# Slower than any disk: a shard that takes longer is not read but stuck.
_BYTES_PER_S = 1e6

# Written by every run.
_EXPECTED_NAMES = (INDEX_NAME, CONFIG_NAME, CARD_NAME)
_KNOWN_NAMES = frozenset({MANIFEST_NAME, PREVIEW_NAME, FAILURES_NAME, *_EXPECTED_NAMES})
# Files that come and go with runs.
_OF_RUNS = re.compile(r"\.(lock|origin|work).*|status(\.[\w-]+)?\.json")
_OUTCOME = re.compile(r"(train|test)/shard-\d+\.json")
# The location of every procedural scene: each scene is a place of its own.
_PROCEDURAL = "seabed"

Facts = dict[str, Any]
"""What a shard says of itself.

problems: what is wrong; with any, nothing else need be there.  config_hash, split.
form: what all shards share, as text.  samples: location, scene, frame and variant of each.
unchanged: rows whose noisy image is their clean image, by their checksums.
noisy, clean: digests of the images, in hexadecimal, when they were read.
"""


@dataclass(frozen=True)
class Report:
    """What validation found, and what it checked.

    findings: a line each that begins with error, warning or note and says where.
    """

    findings: tuple[str, ...]
    samples: int
    shards: int

    @property
    def errors(self) -> tuple[str, ...]:
        """The findings that make the dataset unfit."""
        return tuple(finding for finding in self.findings if finding.startswith("error: "))


def validate(directory: Path, deep: bool = False) -> Report:
    """Check a dataset: manifest, files, SHA-256, schema, counts, duplicates, leaks between splits.

    deep: read every image, too (NaN, value ranges, damaged chunks, equal images).
    Files are opened in an isolated process, which may crash or hang without harm.
    Raises FactoryError when there is no readable manifest.json.
    """
    if not directory.is_dir():
        raise FactoryError(f"{directory}: no such folder; give that of a dataset")
    manifest = load_manifest(directory)
    if manifest is None:
        raise FactoryError(f"{directory}: no {MANIFEST_NAME}; give the folder of a dataset")
    facts = {path: _facts_of(directory, manifest, path, deep) for path in sorted(manifest.shards)}
    findings = (
        *_shard_problems(facts),
        *_manifest_problems(directory, manifest),
        *_index_problems(directory, manifest),
        *_file_problems(directory, manifest),
        *_form_problems(facts),
        *_duplicates(facts),
        *_leaks(facts),
        *_unchanged_samples(facts),
    )
    return Report(findings, manifest.samples(), len(manifest.shards))


def _facts_of(directory: Path, manifest: Manifest, path: str, deep: bool) -> Facts:
    """What a shard says, read in another process, and what is wrong with it."""
    info = manifest.shards[path]
    if os.path.lexists(directory / path) and not is_inside(directory, directory / path):
        return {"problems": ["no regular file, or leads out of the dataset's folder; not read"]}
    if wrong := damage(directory, info):
        return {"problems": [f"{wrong}; run the command that made the dataset again"]}
    limit_s = LIMIT_S + info.bytes / _BYTES_PER_S
    try:
        facts: Facts = LASTING.call(shard_facts, directory / path, deep, limit_s=limit_s)
    except FactoryError as error:
        return {"problems": [str(error)]}
    if not facts["problems"]:
        facts["problems"] = list(_contradictions(facts, info, manifest.config_hashes))
    return facts


def _contradictions(facts: Facts, info: ShardInfo, hashes: frozenset[str]) -> Iterator[str]:
    """In what a sound shard is not the one that the manifest lists.

    hashes: of the configurations that its shards may state.
    """
    sample_count = len(facts["samples"])
    stated_hash = facts["config_hash"]
    if sample_count != info.samples:
        yield f"{sample_count} samples, the manifest says {info.samples}"
    if facts["split"] != info.split:
        yield f"says that its split is {facts['split']!r}"
    if stated_hash not in hashes:
        yield f"is of another configuration ({stated_hash[:40]!r})"
    elif info.config_hash not in ("", stated_hash):
        yield f"its config_hash is {stated_hash!r}, the manifest says {info.config_hash[:40]!r}"


# --- one kind of finding each


def _shard_problems(facts: Mapping[str, Facts]) -> Iterator[str]:
    for path, shard in facts.items():
        for problem in shard["problems"]:
            yield f"error: {path}: {problem}"


def _manifest_problems(directory: Path, manifest: Manifest) -> Iterator[str]:
    """Totals that are not those of the shards, and a manifest of nothing."""
    if problem := totals_problem(directory):
        yield f"error: {MANIFEST_NAME}: {problem}"
    if not manifest.samples():
        yield (
            f"error: {MANIFEST_NAME}: no samples; {FAILURES_NAME} says why frames gave none, if "
            "any were tried"
        )


def _index_problems(directory: Path, manifest: Manifest) -> Iterator[str]:
    """What is wrong with index.h5, one line at most."""
    path = directory / INDEX_NAME
    if not os.path.lexists(path):
        return
    if not is_inside(directory, path):
        yield f"error: {INDEX_NAME}: no regular file inside the dataset's folder; not read"
    elif not manifest.index_sha256:
        yield (
            f"error: {INDEX_NAME}: the manifest has no SHA-256 of it, so it may show anything; "
            "remove it, or run the command that made the dataset again"
        )
    elif manifest.index_sha256 != sha256_of(path):
        yield (
            f"error: {INDEX_NAME}: its SHA-256 is not that of the manifest; remove it and run the "
            "command that made the dataset again, which writes it anew and makes nothing else that "
            "is whole"
        )


def _file_problems(directory: Path, manifest: Manifest) -> Iterator[str]:
    """Files that the manifest does not know, and those that every dataset has but this one."""
    names = _file_names(directory)
    for name in _EXPECTED_NAMES:
        if name not in names:
            yield f"note: {name}: absent; the command that made the dataset writes it"
    known = _KNOWN_NAMES | manifest.shards.keys()
    strangers = [name for name in names if name not in known and not _OF_RUNS.fullmatch(name)]
    yield from map(_stranger, sorted(strangers, key=_is_shard, reverse=True)[:MOST_LISTED])
    if len(strangers) > MOST_LISTED:
        yield f"note: {len(strangers) - MOST_LISTED} more files that the manifest does not know"


def _is_shard(name: str) -> bool:
    return name.endswith(".h5") and name.partition("/")[0] in SPLITS


def _stranger(name: str) -> str:
    """What is wrong with a file that the manifest does not know."""
    # In one line that no terminal takes for a command.
    shown = "".join(letter if letter.isprintable() else "?" for letter in name)[:200]
    if _is_shard(name):
        return (
            f"error: {shown}: not listed in {MANIFEST_NAME}; remove it, or run the command that "
            "made the dataset again"
        )
    if _OUTCOME.fullmatch(name) or is_temporary(name.rpartition("/")[2]):
        return (
            f"note: {shown}: of a run that has not ended; run the command that made the dataset "
            "again"
        )
    return f"note: {shown}: not part of the dataset; not read"


def _file_names(directory: Path) -> list[str]:
    """Names of all files below a dataset's folder, or of the objects at the URL of a copy.

    A folder that is neither train nor test is named with a slash at its end, and not entered.
    """
    if url := url_of(directory):
        return sorted(Store(url).sizes())
    names = []
    for entry in directory.iterdir():
        if not entry.is_dir():
            names.append(entry.name)
        elif entry.name not in SPLITS or entry.is_symlink():
            names.append(f"{entry.name}/")
        else:
            names += [f"{entry.name}/{inner.name}" for inner in entry.iterdir()]
    return sorted(names)


def _form_problems(facts: Mapping[str, Facts]) -> Iterator[str]:
    forms = {path: shard["form"] for path, shard in facts.items() if "form" in shard}
    first = next(iter(forms), "")
    for path, form in forms.items():
        if form != forms[first]:
            yield f"error: {path}: has another form than {first}: {form[:300]}"


def _duplicates(facts: Mapping[str, Facts]) -> Iterator[str]:
    """Samples of one name, and of one noisy image."""
    owners: dict[Hashable, str] = {}
    for path, shard in facts.items():
        names = map(tuple, shard.get("samples", ()))
        for kind, keys in (("name", names), ("noisy image", shard.get("noisy", ()))):
            for row, key in enumerate(keys):
                sample = f"{path} sample {row}"
                owner = owners.setdefault(key, sample)
                if owner != sample:
                    yield f"error: {path}: sample {row} has the same {kind} as {owner}"


def _leaks(facts: Mapping[str, Facts]) -> Iterator[str]:
    """What a model that trained on the one split knows of the other.

    Scenes and clean images in both are errors.  Scenes of one location that are apart by name may
    still show the same ground: that is for people to judge.
    """
    train, test = (_content_of(split, facts) for split in SPLITS)
    if shared := sorted(train.scenes & test.scenes):
        yield (
            f"error: {MANIFEST_NAME}: {len(shared)} scene(s) both train and test: "
            f"{', '.join(shared[:MOST_LISTED])}"
        )
    if shared := sorted(train.clean & test.clean):
        yield f"error: {MANIFEST_NAME}: {len(shared)} clean image(s) are in train and in test"
    if shared := sorted((train.locations & test.locations) - {"", _PROCEDURAL}):
        yield (
            f"note: {MANIFEST_NAME}: scenes of {len(shared)} location(s) train and test: "
            f"{', '.join(shared[:MOST_LISTED])}; make sure that they do not show the same ground"
        )


class _Content(NamedTuple):
    """Names of locations and of scenes in a split, and digests of its clean images."""

    locations: set[str]
    scenes: set[str]
    clean: set[str]


def _content_of(split: str, facts: Mapping[str, Facts]) -> _Content:
    shards = [shard for path, shard in facts.items() if path.partition("/")[0] == split]
    names = [name for shard in shards for name in shard.get("samples", ())]
    return _Content(
        {_comparable(location) for location, *_ in names},
        {_comparable(f"{location}/{scene}") for location, scene, *_ in names},
        {digest for shard in shards for digest in shard.get("clean", ())},
    )


def _comparable(name: str) -> str:
    """One spelling for names that differ in case or composition of letters alone."""
    return unicodedata.normalize("NFC", name).casefold()


def _unchanged_samples(facts: Mapping[str, Facts]) -> Iterator[str]:
    samples = [
        f"{path} sample {row}"
        for path, shard in facts.items()
        for row in shard.get("unchanged", ())
    ]
    if samples:
        yield (
            f"warning: {MANIFEST_NAME}: noisy and clean are the same image in {len(samples)} "
            f"sample(s), the first of them {samples[0]}; was noise meant to be off?"
        )


# --- in the isolated process


def shard_facts(path: Path, deep: bool) -> Facts:
    """Check one shard; `deep` reads every image."""
    try:
        with reading(path) as file:
            check_texts(file)
            return _facts(file, deep)
    except FactoryError as error:
        return {"problems": [str(error).removeprefix(f"{path}: ")]}


def _facts(file: h5py.File, deep: bool) -> Facts:
    """What an opened shard says: see `shard_facts`."""
    noisy = file["noisy"]
    table = file["meta"][()]
    checksums = file[CHECKSUMS][()]
    config = config_of(file)
    known_layers = layers(str(noisy.dtype), optional_layers(file), classes_of(config))
    stated_hash = str(file.attrs["config_hash"])
    problems = _table_problems(table)
    if config_hash(config) != stated_hash:
        problems.append(
            f"its config does not give its config_hash {stated_hash[:40]!r}; generate it again"
        )
    digests: dict[str, list[str]] = {"noisy": [], "clean": []}
    if deep:
        problems += _image_problems(file, known_layers, digests)
    return {
        "problems": problems[:MOST_LISTED],
        "config_hash": stated_hash[:200],
        "split": str(file.attrs["split"]),
        "form": _form(file, known_layers, table.dtype.names),
        "samples": [
            [*(row[name].decode() for name in REQUIRED_COLUMNS[:3]), int(row["variant"])]
            for row in table
        ],
        "unchanged": np.flatnonzero(checksums["noisy"] == checksums["clean"]).tolist(),
        **({} if problems else digests),
    }


def _table_problems(table: npt.NDArray[np.void]) -> list[str]:
    if not len(table):
        return ["holds no sample; generate it again"]
    real_columns = [name for name in table.dtype.names or () if table.dtype[name].kind == "f"]
    return [
        f"/meta: column {name} has infinite values"
        for name in real_columns
        if np.isinf(table[name]).any()
    ]


def _image_problems(
    file: h5py.File, known_layers: tuple[Layer, ...], digests: dict[str, list[str]]
) -> list[str]:
    """What is wrong with the images of a shard; fills `digests` of the layers that it names."""
    problems: list[str] = []
    stacks = {layer: ImageStack(file[layer.name]) for layer in known_layers}
    for row in range(len(file["noisy"])):
        for layer, stack in stacks.items():
            try:
                image = stack[row]
            except FactoryError as error:
                problems.append(str(error))
                continue
            if problem := layer.value_problem(image):
                problems.append(f"sample {row}: /{layer.name} {problem}")
            if layer.name in digests:
                content = hashlib.blake2b(image.tobytes(), digest_size=16)
                digests[layer.name].append(content.hexdigest())
        if len(problems) >= MOST_LISTED:
            break
    return problems


def _form(file: h5py.File, known_layers: tuple[Layer, ...], columns: tuple[str, ...]) -> str:
    """What all shards of a dataset have in common: sizes, types, layers, axes, columns."""
    noisy = file["noisy"]
    camera_sizes = [
        f"{layer.name} {file[layer.name].shape[1:]}" for layer in known_layers if layer.of_camera
    ]
    shapes = " ".join((str(noisy.shape[1:]), *camera_sizes))
    names = ", ".join(layer.name for layer in known_layers)
    axes = [(axis.name, axis.units) for axis in image_axes(noisy)]
    form = f"{shapes} {noisy.dtype}, layers {names}, axes {axes}, columns {', '.join(columns)}"
    return form[:4000]
