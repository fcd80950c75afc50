"""Is a dataset what its manifest says: whole, consistent, and fair to those who test on it."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

from ...errors import FactoryError
from ...files import is_temporary
from ..format.layout import inside
from ..format.manifest import (
    INDEX_NAME,
    MANIFEST_NAME,
    Manifest,
    damage,
    load_manifest,
)
from ..format.schema import SPLITS
from ..read.isolated import IsolatedProcess
from .facts import SampleKey, ShardFacts, index_problems, shard_facts

_LIMIT_S = 60.0
# Slower than any disk: a shard that takes longer is not read but stuck.
_BYTES_PER_S = 1e6
_SHOWN = 3

Key = TypeVar("Key", bytes, tuple[bytes, ...])


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


def validate(directory: Path, deep: bool = False) -> Report:
    """Check a dataset: manifest, SHA-256, schema, counts, duplicates, leaks from train to test.

    deep: read every picture, too (NaN, value ranges, damaged chunks, equal pictures).
    Files are opened in an isolated process, which may crash or hang without harm.
    Raises FactoryError when there is no readable manifest.json.
    """
    with IsolatedProcess() as process:
        return validate_with(process, directory, deep)


def validate_with(process: IsolatedProcess, directory: Path, deep: bool) -> Report:
    """The same with a process that runs already: for many datasets, one after another."""
    if not directory.is_dir():
        raise FactoryError(f"{directory}: no such folder; give that of a dataset")
    manifest = load_manifest(directory)
    if manifest is None:
        raise FactoryError(f"{directory}: no {MANIFEST_NAME}; give the folder of a dataset")
    findings: list[Finding] = []
    facts: dict[str, ShardFacts] = {}
    for path in sorted(manifest.shards):
        found = _facts(process, directory, manifest, path, deep)
        facts[path] = found
        findings += [Finding("error", path, problem) for problem in found.problems]
        findings += [Finding("note", path, note) for note in found.notes]
    findings += _index_findings(process, directory, manifest)
    findings += _strays(directory, manifest)
    findings += _disagreements(manifest, facts)
    findings += _doubles(facts)
    findings += _leaks(facts)
    return Report(tuple(findings), manifest.samples(), len(manifest.shards))


def _facts(
    process: IsolatedProcess, directory: Path, manifest: Manifest, path: str, deep: bool
) -> ShardFacts:
    info = manifest.shards[path]
    if os.path.lexists(directory / path) and not inside(directory, directory / path):
        return ShardFacts(("no regular file, or leads out of the dataset's folder; not read",))
    wrong = damage(directory, info)
    if wrong:
        return ShardFacts((f"{wrong}; run the command that made the dataset again",))
    limit_s = _LIMIT_S + info.bytes / _BYTES_PER_S
    try:
        facts = process.call(shard_facts, directory / path, deep, limit_s=limit_s)
    except FactoryError as error:
        return ShardFacts((str(error),))
    problems = list(facts.problems)
    if not problems and len(facts.samples) != info.samples:
        problems.append(f"{len(facts.samples)} samples, the manifest says {info.samples}")
    if not problems and facts.split != info.split:
        problems.append(f"says that its split is {facts.split!r}")
    if not problems and facts.config_hash not in manifest.config_hashes:
        problems.append(f"is of another configuration ({facts.config_hash[:40]!r})")
    return replace(facts, problems=tuple(problems))


_INDEX_REMEDY = (
    "remove it and run the command that made the dataset again, which writes it anew and makes "
    "nothing else that is whole"
)


def _index_findings(
    process: IsolatedProcess, directory: Path, manifest: Manifest
) -> Iterator[Finding]:
    path = directory / INDEX_NAME
    if not os.path.lexists(path):
        yield Finding("note", INDEX_NAME, "absent; the command that made the dataset writes it")
        return
    if not inside(directory, path):
        yield Finding("error", INDEX_NAME, "no regular file inside the dataset's folder; not read")
        return
    expected = {
        split: [(p, s.samples) for p, s in sorted(manifest.shards.items()) if s.split == split]
        for split in SPLITS
    }
    try:
        problems = process.call(index_problems, path, expected, limit_s=_LIMIT_S)
    except FactoryError as error:
        problems = (str(error),)
    for problem in problems:
        yield Finding("error", INDEX_NAME, f"{problem}; {_INDEX_REMEDY}")


def _strays(directory: Path, manifest: Manifest) -> Iterator[Finding]:
    for split in SPLITS:
        folder = directory / split
        for entry in sorted(folder.iterdir()) if folder.is_dir() else []:
            relative = f"{split}/{entry.name}"
            if relative not in manifest.shards and not is_temporary(entry.name):
                yield Finding("note", relative, "not in the manifest, so no reader uses it")


def _disagreements(manifest: Manifest, facts: dict[str, ShardFacts]) -> Iterator[Finding]:
    forms = {path: found.form for path, found in facts.items() if found.form}
    first = next(iter(forms), None)
    for path, form in forms.items():
        if first is not None and form != forms[first]:
            yield Finding("error", path, f"has another form than {first}: {form[:300]}")


def _doubles(facts: dict[str, ShardFacts]) -> Iterator[Finding]:
    """Samples of the same name, and (when pictures were read) of the same noisy picture."""
    names: dict[SampleKey, str] = {}
    pictures: dict[bytes, str] = {}
    for path, found in facts.items():
        for row, key in enumerate(found.samples):
            if key in names:
                yield Finding(
                    "error", path, f"sample {row} is {_sample_name(key)} again, {names[key]}"
                )
            names.setdefault(key, f"as {path} sample {row}")
        for row, digest in enumerate(found.noisy):
            if digest in pictures:
                text = f"sample {row} has the same noisy picture {pictures[digest]}"
                yield Finding("error", path, text)
            pictures.setdefault(digest, f"as {path} sample {row}")


def _leaks(facts: dict[str, ShardFacts]) -> Iterator[Finding]:
    """What a test would know from training: scenes, and clean pictures; a location is a note."""
    sides: dict[str, list[ShardFacts]] = {split: [] for split in SPLITS}
    for path, found in facts.items():
        sides[path.split("/")[0]].append(found)
    train, test = (sides[split] for split in SPLITS)
    scenes = _shared([{key[:2] for one in side for key in one.samples} for side in (train, test)])
    shown = [b"/".join(scene).decode(errors="replace") for scene in scenes[:_SHOWN]]
    if scenes:
        text = f"{len(scenes)} scene(s) both train and test: {', '.join(shown)}"
        yield Finding("error", MANIFEST_NAME, text)
    clean = _shared([{digest for one in side for digest in one.clean} for side in (train, test)])
    if clean:
        text = f"{len(clean)} clean picture(s) are in train and in test"
        yield Finding("error", MANIFEST_NAME, text)
    places = _shared(
        [{key[0] for one in side for key in one.samples if key[0]} for side in (train, test)]
    )
    if places:
        names = ", ".join(place.decode(errors="replace") for place in places[:_SHOWN])
        text = f"location(s) with scenes on both sides, none of them the same: {names}"
        if not scenes:
            yield Finding("note", MANIFEST_NAME, text)


def _shared(sides: Sequence[set[Key]]) -> list[Key]:
    return sorted(sides[0] & sides[1])


def _sample_name(key: SampleKey) -> str:
    name = b"/".join(part for part in key[:3] if part).decode(errors="replace")
    return f"{name} variant {key[3]}"
